"""Laws inside laws."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from diagnosis_systems import STIFF

from jaxsr.diagnosis.judging.nesting import INSIDE
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.models import Model, Simulator, apply_edit, parse_model

SCALE = {"q": np.linspace(-2.0, 2.0, 21), "v": np.linspace(-2.0, 2.0, 21)}
MASS = parse_model(STIFF)


def force(model: Model, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    simulator = Simulator(model)
    with jax.enable_x64(True):
        return np.asarray(simulator.forces(0.7, (q, v), (u,), simulator.values())[1])


@pytest.mark.parametrize("richer", sorted(INSIDE))
def test_a_richer_law_is_the_simpler_one_at_the_constants_it_starts_from(richer: str) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-2.0, 2.0, (3, 200))
    offered = force_candidates(MASS, SCALE)
    simpler, starts = INSIDE[richer]
    inner = next(c for c in offered if c.mechanism == simpler)
    variants = [c for c in offered if c.mechanism == richer]
    assert variants
    for candidate in variants:
        size = rng.uniform(0.1, 5.0)
        own = {p.name: p.neutral for p in candidate.parameters}
        own |= {n: size if isinstance(at, str) else at for n, at in starts.items()}
        (name,) = (p.name for p in inner.parameters)
        both = [
            apply_edit(MASS, c.edit(MASS, {n: n for n in values}, values))
            for c, values in ((candidate, own), (inner, {name: size}))
        ]
        one, other = (force(model, *points) for model in both)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)
