"""Modes and evidences by machine code are those of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import erfcx, log_ndtr

from jaxsr import _machine_code as machine_code
from jaxsr.diagnosis.likelihood import bounded_modes, evidence
from jaxsr.diagnosis.likelihood.evidence import Gram, Mode, Prior, compile_modes, modes

SAMPLES = 400


@pytest.fixture(autouse=True, scope="module")
def compiled() -> None:
    compile_modes()


def drawn(rng: np.random.Generator, size: int) -> tuple[list[Gram], Prior]:
    """Sizes of three noises beside columns far apart in strength; bounds that some modes are at."""
    rows = rng.normal(size=(SAMPLES, 1 + size)) * 10.0 ** rng.uniform(-2.0, 2.0, 1 + size)
    rows[:, 0] += rows[:, 1:] @ rng.normal(size=size)
    factors = rng.choice([1e-300, 1e3]), rng.choice([np.inf, 4e3])
    grams = [Gram(k * rows.T @ rows, -1.3 * k, SAMPLES, *factors) for k in (0.5, 1.0, 3.0)]
    deviation = 10.0 ** rng.uniform(-2.0, 2.0, size)
    mean = rng.normal(size=size) * deviation
    low = mean + rng.uniform(-3.0, 0.5, size) * deviation
    high = low + rng.uniform(0.0, 3.0, size) * deviation
    low[rng.random(size) < 0.3], high[rng.random(size) < 0.3] = -np.inf, np.inf
    return grams, Prior(mean, deviation, low, high)


def assert_alike(found: list[Mode], wanted: list[Mode], prior: Prior) -> None:
    for one, other in zip(found, wanted, strict=True):
        scale = 1.0 + abs(other.log_evidence)
        assert one.log_evidence == pytest.approx(other.log_evidence, abs=1e-8 * scale)
        assert one.noise == pytest.approx(other.noise, rel=1e-6)
        np.testing.assert_allclose(one.deviation, other.deviation, rtol=1e-6)
        away = np.abs(one.change - other.change) / other.deviation
        assert (away < 1e-5).all()


def test_machine_code_has_what_arrays_have() -> None:
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(200):
        size = int(rng.integers(0, 12))
        grams, prior = drawn(rng, size)
        found = modes(grams, range(size), prior)
        wanted = [gram.evidence(range(size), prior) for gram in grams]
        assert_alike(found, wanted, prior)
        held += any((m.change == prior.low).any() or (m.change == prior.high).any() for m in found)
    assert held > 50


def test_it_is_compiled_once_however_a_belief_lies() -> None:
    grams, prior = drawn(np.random.default_rng(2), 4)
    parts = (prior.mean, prior.deviation, prior.low, prior.high)
    strided = Prior(*(np.repeat(part, 2)[::2] for part in parts))
    assert_alike(modes(grams, range(4), strided), modes(grams, range(4), prior), prior)
    machine: Any = machine_code.compiled(bounded_modes.fill_modes)
    assert len(machine.signatures) == 1


def test_some_columns_are_weighed_without_the_others() -> None:
    rng = np.random.default_rng(1)
    grams, prior = drawn(rng, 6)
    chosen = [4, 0, 3]
    found = modes(grams, chosen, prior.of(chosen))
    assert_alike(found, [g.evidence(chosen, prior.of(chosen)) for g in grams], prior)


def test_combinations_have_the_prior_and_the_bounds() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        grams, prior = drawn(rng, 3)
        mixing = np.eye(3)
        mixing[2, 0] = 1.0
        found = modes(grams, range(3), prior, mixing)
        assert_alike(found, [g.mode(mixing, prior) for g in grams], prior)


def test_what_rounding_made_indefinite_is_left_to_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    wide = 1e7 * rng.normal(size=(40, 2)) @ rng.normal(size=(2, 6))  # of rank two
    rows = np.column_stack([rng.normal(size=40), wide])
    products = rows.T @ rows
    products[1:, 1:] -= np.eye(6) * 1e-15 * np.trace(products)
    gram = Gram(products, 0.0, 40)
    prior = Prior(np.zeros(6), np.ones(6), np.full(6, -np.inf), np.full(6, np.inf))
    asked: list[Gram] = []
    arrays = Gram.evidence
    monkeypatch.setattr(Gram, "evidence", lambda g, *a: (asked.append(g), arrays(g, *a))[1])
    found = modes([gram], range(6), prior)[0]
    assert len(asked) == 1
    assert found.log_evidence == arrays(gram, range(6), prior).log_evidence


def test_products_that_are_no_numbers_are_no_evidence() -> None:
    """LAPACK may find that they have no factor, or hand them on."""
    products = np.full((3, 3), np.nan)
    prior = Prior(np.zeros(2), np.ones(2), np.full(2, -np.inf), np.full(2, np.inf))
    try:
        found = modes([Gram(products, 0.0, 40)], range(2), prior)
    except np.linalg.LinAlgError:
        return
    assert not np.isfinite(found[0].log_evidence)


def test_without_machine_code_arrays_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    grams, prior = drawn(rng, 4)
    found = modes(grams, range(4), prior)
    monkeypatch.setattr(evidence, "kept", lambda *_: None)
    assert_alike(found, modes(grams, range(4), prior), prior)


def test_tails_are_those_of_the_normal_distribution() -> None:
    for x in (0.0, 1e-3, 0.7, 5.0, 24.9, 25.1, 300.0, 1e5):
        assert bounded_modes.erfcx(x) == pytest.approx(float(erfcx(x)), rel=1e-12)
    rng = np.random.default_rng(5)
    for _ in range(200):
        low = float(rng.normal() * 10.0 ** rng.uniform(-1.0, 1.5))
        high = low + 10.0 ** rng.uniform(-3.0, 1.5)
        near, far = (-high, -low) if high < -low else (low, high)
        wanted = log_ndtr(-near) + np.log1p(-np.exp(log_ndtr(-far) - log_ndtr(-near)))
        assert bounded_modes.log_share(low, high) == pytest.approx(float(wanted), abs=1e-6)
    for near in (0.0, 0.3, 2.0, 40.0, 1e4):
        there = bounded_modes.fall(near)
        left = log_ndtr(-near - there) - log_ndtr(-near)
        assert left == pytest.approx(np.log(0.05), rel=1e-6 if near < 100.0 else 1e-3)
