"""Terms that tell less than they cost leave a law; those of the law stay."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr._progress import as_budget
from jaxsr.discovery.pruning import pruned
from jaxsr.discovery.rollout import cut
from jaxsr.discovery.samples import roles, samples
from jaxsr.discovery.trial import Trial, moved
from jaxsr.expressions import parse, to_text
from jaxsr.recordings import Recording


def _trial(seed: int, budget: float | None = None) -> Trial:
    """x' = v, v' = -4 x - 0.3 v - 0.4 x^3, 2 % noise."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 12.0, 400)
    way = solve_ivp(
        lambda _, s: [s[1], -4.0 * s[0] - 0.3 * s[1] - 0.4 * s[0] ** 3],
        (0.0, 12.0), [1.5, 0.0], t_eval=t, rtol=1e-9, atol=1e-11,
    ).y  # fmt: skip
    x, v = way + 0.02 * np.std(way, axis=1, keepdims=True) * rng.normal(size=way.shape)
    data = samples([Recording("run", t, {"x": x, "v": v})], roles(["x", "v"], None, 1, [], None))
    return Trial(cut(data.traces, 51, 32), "t", {}, as_budget(budget), substeps=1)


def _fitted(trial: Trial, extra: str) -> dict[str, set[str]]:
    terms = {"x": ["v", "x/(t + 3.5)"], "v": ["x", "v", "x**3", *extra.split()]}
    weights = {"x": [1.0, 0.0], "v": [-4.0, -0.3, -0.4, *(0.0 for _ in extra.split())]}
    result = trial.fit({s: [parse(p) for p in own] for s, own in terms.items()}, weights)
    assert result is not None
    return {s: {to_text(t) for t in own} for s, own in moved(pruned(result, trial))[0].items()}


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_what_noise_alone_pays_for_leaves_both_laws(seed: int) -> None:
    law = _fitted(_trial(seed), "x**2 t v*x**2")
    assert law == {"x": {"v"}, "v": {"x", "v", "x**3"}}


def test_without_time_everything_stays() -> None:
    trial = _trial(0)
    out_of_time = Trial(trial.segments, "t", {}, as_budget(1e-9))
    result = trial.fit({"x": [parse("v")], "v": [parse("x"), parse("t")]}, {"x": [1], "v": [-4, 0]})
    assert result is not None and pruned(result, out_of_time) is result
