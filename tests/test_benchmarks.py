"""The judges of the benchmarks: they accept the truth in other words, and nothing else."""

from __future__ import annotations

import importlib
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import sympy

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.judging import form, is_rational, judge, relative_error
from benchmarks.systems import (
    FORCE,
    TWO_MASS,
    TWO_MASS_DRIVEN,
    CrankSlider,
    chain,
    noisy,
    two_mass,
    two_mass_unseen,
    variables,
    with_force,
)

ROOT = Path(__file__).resolve().parents[1]
OPTIONAL = {"mujoco"}
"""What an extra installs and scripts import as they are read."""
SCRIPTS = [p for p in sorted((ROOT / "benchmarks").rglob("*.py")) if p.stem[:2] != "__"]


@pytest.fixture(scope="module")
def data() -> dict[str, np.ndarray]:
    return variables(two_mass_unseen(200))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_every_script_finds_what_it_imports(script: Path) -> None:
    try:
        importlib.import_module(".".join(script.relative_to(ROOT).with_suffix("").parts))
    except ModuleNotFoundError as missing:
        if missing.name not in OPTIONAL:
            raise
        pytest.skip(f"{missing.name} is not installed")


@pytest.mark.parametrize("state", TWO_MASS)
def test_the_truth_is_exact(state: str, data: dict[str, np.ndarray]) -> None:
    mark = judge(TWO_MASS[state], TWO_MASS[state], data)
    assert mark.exact and mark.error == 0.0
    assert mark.terms == (3 if state in ("z3", "z4") else 1)


@pytest.mark.parametrize(
    "words",
    [
        "30*z2 - 50*z1 + 20*cos(2*t - pi/2)",
        "-50*(z1 - 3*z2/5) - 20*sin(-2*t)",
        "30*z2 - 50*z1 + 20*sin(t + t)",
        "30*z2 - 50*z1 + 12*sin(2*t + 0.3) + a",
        "30*z2 - 50*z1 - 20*sin(2*t + pi)",
    ],
)
def test_other_words_for_the_truth(words: str, data: dict[str, np.ndarray]) -> None:
    # "a" completes 12 sin(2t + 0.3) to 20 sin(2t): two sines of one frequency are one wave
    a = f"({20.0 - 12.0 * math.cos(0.3)!r}*sin(2*t) - {12.0 * math.sin(0.3)!r}*cos(2*t))"
    mark = judge(words.replace("+ a", f"+ {a}"), TWO_MASS["z3"], data)
    assert mark.exact and mark.terms == 3
    assert mark.error < 1e-9


def test_a_cosine_stands_for_a_shifted_sine(data: dict[str, np.ndarray]) -> None:
    mark = judge("60*z1 - 100*z2 + 20*cos(5*t - pi/6)", TWO_MASS["z4"], data)
    assert mark.exact and mark.error < 1e-12


@pytest.mark.parametrize(
    "extra", ["0.01*z3", "0.001", "z1*z2", "sin(3*t)", "sin(z1)", "exp(-t)", "z1*sin(2*t)"]
)
def test_a_spurious_term_is_seen(extra: str, data: dict[str, np.ndarray]) -> None:
    mark = judge(f"{TWO_MASS['z3']} + {extra}", TWO_MASS["z3"], data)
    assert not mark.exact and np.isnan(mark.error) and mark.terms == 4


def test_clutter_is_forgiven_below_its_size_only(data: dict[str, np.ndarray]) -> None:
    faint, strong = f"{TWO_MASS['z3']} + 1e-4*z3", f"{TWO_MASS['z3']} + z3"
    assert judge(faint, TWO_MASS["z3"], data, clutter=1e-3).exact
    assert not judge(strong, TWO_MASS["z3"], data, clutter=1e-3).exact


@pytest.mark.parametrize("words", ["30*z2 - 50*z1", "30*z2 + 20*sin(2*t)", "0*z1"])
def test_a_missing_term_is_seen(words: str, data: dict[str, np.ndarray]) -> None:
    assert not judge(words, TWO_MASS["z3"], data).exact
    assert not judge(words, TWO_MASS["z3"], data, clutter=1.0).exact


def test_a_wrong_frequency_is_another_term(data: dict[str, np.ndarray]) -> None:
    mark = judge("30*z2 - 50*z1 + 20*sin(3*t)", TWO_MASS["z3"], data)
    assert not mark.exact
    near = judge("30*z2 - 50*z1 + 20*sin(2.01*t)", TWO_MASS["z3"], data)
    assert near.exact and near.error == pytest.approx(0.005)


def test_the_error_is_the_largest_of_all_constants(data: dict[str, np.ndarray]) -> None:
    assert judge("33*z2 - 50*z1 + 20*sin(2*t)", TWO_MASS["z3"], data).error == pytest.approx(0.1)
    shifted = judge("30*z2 - 50*z1 + 20*sin(2*t + 0.2)", TWO_MASS["z3"], data)
    assert shifted.error == pytest.approx(0.2)


def test_an_endless_expression_is_not_expanded(data: dict[str, np.ndarray]) -> None:
    z1 = sympy.Symbol("z1", real=True)
    endless = sympy.Add(*(sympy.sin((k + 0.5) * z1) for k in range(300)))
    assert form(endless) is None
    assert not judge(endless, TWO_MASS["z3"], data).exact


def test_recordings_obey_their_laws() -> None:
    for recording in two_mass(600):
        values = variables(with_force(recording))
        for state, law in TWO_MASS.items():
            assert relative_error(law, values, values[f"d{state}"]) < 1e-14
            assert relative_error(TWO_MASS_DRIVEN[state], values, values[f"d{state}"]) < 1e-14
        assert relative_error(FORCE, values, values["u1"]) < 1e-14
        rate = np.gradient(values["z1"], recording.time, edge_order=2)
        assert np.max(np.abs(rate - values["z3"])) < 0.1 * np.max(np.abs(values["z3"]))


def test_noise_has_the_stated_level() -> None:
    clean = two_mass_unseen(2000)
    rough = noisy(np.random.default_rng(0), clean, 20.0)
    for name, x in clean.channels.items():
        ratio = np.std(rough.channels[name] - x) / np.sqrt(np.mean(x**2))
        # 2000 draws: the standard deviation is known to 1.6 %
        assert ratio == pytest.approx(0.1, rel=0.08)


def test_crank_slider_forms() -> None:
    system = CrankSlider()
    values = variables(system.record(np.linspace(0.0, 1.0, 1500)))
    through_z1 = "-20*z1*sin(20*t)/(z1 - cos(20*t))"
    # Eq. 27, exact: sin cos = sin(2 w t)/2 and L2^2 - sin^2 = (2 L2^2 - 1 + cos(2 w t))/2
    paper = "-20*sin(20*t) - 20/sqrt(2)*sin(40*t)/sqrt(3.5 + cos(40*t))"
    assert is_rational(system.law) and is_rational(through_z1) and is_rational(paper)
    assert not is_rational("sin(20*t)/3 + z1**2")
    rate = np.gradient(values["z1"], values["t"], edge_order=2)
    assert np.max(np.abs(rate - values["dz1"])) < 0.05
    for words in (system.law, through_z1, paper):
        assert relative_error(words, values, values["dz1"]) < 1e-12
    assert relative_error("-20*sin(20*t)", values, values["dz1"]) > 1e-3


def test_chain_has_its_terms() -> None:
    system = chain(3)
    recording = system.record([0.0] * 6, np.linspace(0.0, 1.0, 50), "chain")
    values = variables(recording)
    terms = [judge(law, law, values).terms for law in system.laws.values()]
    assert terms == [1, 1, 1, 3, 4, 3]
    for state, law in system.laws.items():
        assert relative_error(law, values, values[f"d{state}"]) < 1e-12
