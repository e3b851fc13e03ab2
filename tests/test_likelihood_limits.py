"""Sensors at their limits: readings that tell that the motion goes on, and no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from scipy.stats import norm

from benchmarks.saturated_machines import HELD_OUT, SEEN
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis, hypothesis
from jaxsr.diagnosis.likelihood.limits import Censored, at_limits, blind, limits_of
from jaxsr.diagnosis.likelihood.posterior import Posterior, posterior
from jaxsr.diagnosis.likelihood.table import tabled
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.limits import APART, BOTTOM, MIRRORED, TOP, clipping
from jaxsr.diagnosis.mechanisms.site import Threshold
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models import Simulator, parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

TIME, K, C = np.arange(400) * 0.05, 4.0, 0.5
MODEL = f"""
[model]
states = ["x", "v"]
inputs = ["u"]
outputs = ["y"]
input_hold = "linear"
[equations]
x = "v"
v = "u - k*x - c*v"
[readings]
y = "x"
[parameters]
k = {{ value = {K}, bounds = [1.0, 9.0] }}
c = {{ value = {C}, bounds = [0.0, 3.0] }}
"""


def motion(rng: np.random.Generator, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """A push and what a sensor without limits reads of the position that it leads to."""
    phases = rng.uniform(0.0, 6.0, (3, 1))
    u = np.sin(rng.uniform(0.3, 2.0, (3, 1)) * TIME + phases).sum(axis=0)
    x = lsim(([[0.0, 1.0], [-K, -C]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]), u, TIME)[1]
    return u, x + noise * np.std(x) * rng.standard_normal(TIME.size)


def cut(rng: np.random.Generator, y: np.ndarray, ends: str) -> tuple[np.ndarray, float, float]:
    """Readings between limits that some share of them lies beyond, and these."""
    low = float(np.quantile(y, rng.uniform(0.05, 0.2))) if ends != "top" else -np.inf
    high = float(np.quantile(y, rng.uniform(0.8, 0.95))) if ends != "bottom" else np.inf
    return np.clip(y, low, high), low, high


def workspace(u: np.ndarray, y: np.ndarray, limited: bool) -> Workspace:
    model = Simulator(parse_model(MODEL)).model
    rows = (Prepared.build(model, Recording("a", TIME, {"u": u, "y": y})),)
    sensors = [*clipping("y", None, y)] if limited else []
    return Workspace.build(SuperModel.build(model, sensors), rows, 0.5)


def estimated(work: Workspace, members: tuple[int, ...]) -> Hypothesis:
    table = tabled(work, work.theta, work.narrow.segments.course)
    found = hypothesis(work, table, members)
    assert found is not None
    return found


@pytest.mark.parametrize("ends", ["top", "bottom", "both"])
def test_what_is_offered_cuts_readings_off_where_the_sensor_does(ends: str) -> None:
    """Both ends are seen in nine of ten: one that is reached once and briefly may be none."""
    rng, alike, draws = np.random.default_rng(0), 0, 60
    for _ in range(draws):
        y = rng.uniform(-2.0, 2.0) + motion(rng, 10.0 ** rng.uniform(-4.0, -1.5))[1]
        seen, low, high = cut(rng, y, ends)
        for candidate in clipping("y", None, seen):
            known = {spec.name: spec.seed for spec in candidate.parameters}
            assert known.get("ymax", high) in (high, -low) and known.get("ymin", low) == low
            ((_, reading),) = candidate.readings
            assert reading in (TOP, BOTTOM, MIRRORED, APART)
            text = reading.format(old="y", **known)
            read = eval(text, {"Min": np.minimum, "Max": np.maximum, "y": y})
            alike += np.array_equal(read, seen)
    assert alike >= 0.9 * draws


def test_noise_is_no_limit() -> None:
    """By chance alone limits are offered in less than one in ten of recordings, however noisy."""
    rng = np.random.default_rng(1)
    draws = (motion(rng, 10.0 ** rng.uniform(-4.0, -1.0))[1] for _ in range(400))
    assert sum(1 for y in draws for _ in clipping("y", None, y)) < 40


@pytest.mark.parametrize("ends", ["top", "bottom", "both"])
def test_the_evidence_is_that_of_the_other_samples_and_of_readings_that_are_followed(
    ends: str,
) -> None:
    """Limits have no constants to estimate: the rest is the model beside lost samples."""
    rng = np.random.default_rng(2)
    u, y = motion(rng, 0.01)
    seen, low, high = cut(rng, y, ends)
    work = workspace(u, seen, limited=True)
    found = estimated(work, (0,))
    limits = limits_of(work.super_model, (0,))
    hidden = at_limits(work, limits)
    assert np.count_nonzero(hidden) >= np.count_nonzero((seen == low) | (seen == high))
    columns = [limit.column for limit in limits]
    args = limits, work.narrow, found.theta, columns, found.path
    told = Censored.along(work, *args)
    bare = workspace(u, seen, limited=False)
    lost = replace(bare, narrow=blind(bare.narrow, told.samples))
    other = estimated(replace(lost, prepared=without(lost, told.samples)), ())
    # A reading at the limit along whose path the motion is just before it is read either way.
    assert abs(found.log_evidence - told.log_density - other.log_evidence) < 1.0
    for name in ("k", "c"):
        apart = found.constants[name][0] - other.constants[name][0]
        assert abs(apart) < 0.2 * other.constants[name][1]


def without(work: Workspace, samples: np.ndarray) -> tuple[Prepared, ...]:
    """Recordings in which samples of the pieces are lost."""
    (item,) = work.prepared
    outputs = item.outputs.copy()
    for piece, (_, start, stop) in enumerate(work.rows):
        outputs[start:stop, 0][samples[0, : stop - start, piece]] = np.nan
    return (replace(item, outputs=outputs),)


def beyond(work: Workspace) -> Censored:
    """What a path tells that is well beyond the limits."""
    limits = limits_of(work.super_model, (0,))
    path = work.narrow.segments.course.copy()
    path[0] *= 2.0
    columns = [limit.column for limit in limits]
    return Censored.along(work, limits, work.narrow, work.theta, columns, path)


def test_readings_exactly_at_a_limit_are_certain_to_a_step_of_what_is_read() -> None:
    rng, step = np.random.default_rng(3), 1e-4
    u, y = motion(rng, 0.01)
    seen, low, high = cut(rng, y, "both")
    told = beyond(workspace(u, step * np.round(seen / step), limited=True))
    counts = [np.count_nonzero(np.abs(seen - end) < 0.5 * step) for end in (high, low)]
    reach = np.ptp(step * np.round(seen / step))
    wanted = -sum(counts) * np.log(step) + sum(np.log(step / np.sqrt(n) / reach) for n in counts)
    assert told.log_density == pytest.approx(wanted, rel=1e-6)
    assert told.deviation == pytest.approx(step / np.sqrt(counts))


def test_noise_that_follows_a_limit_is_normal_about_it() -> None:
    rng, seen = np.random.default_rng(6), 0
    for _ in range(20):
        u, y = motion(rng, 0.0)
        cleanly, _, high = cut(rng, y, "top")
        read = cleanly + 0.01 * np.std(y) * rng.standard_normal(y.size)
        work = workspace(u, read, limited=True)
        if not work.super_model.candidates:  # reached once, or not for long
            continue
        seen += 1
        (limit,), told = limits_of(work.super_model, (0,)), beyond(work)
        deviation = float(np.sqrt(work.scales.told[0]))
        assert abs(limit.value - high) < 2.0 * deviation
        readings = work.narrow.segments.outputs[told.samples]
        readings = np.abs(readings) if limit.mirrored else readings
        density = norm.logpdf(readings, limit.value, deviation).sum()
        width = np.sqrt(2.0 * np.pi / readings.size) * deviation
        assert told.log_density == pytest.approx(density + np.log(width / np.ptp(read)), rel=1e-9)
    assert seen >= 5


def test_a_path_before_the_limit_is_pulled_by_its_readings() -> None:
    rng = np.random.default_rng(4)
    u, y = motion(rng, 0.01)
    work = workspace(u, cut(rng, y, "top")[0], limited=True)
    limits = limits_of(work.super_model, (0,))
    path = 0.5 * work.narrow.segments.course
    args = limits, work.narrow, work.theta, [limit.column for limit in limits], path
    assert at_limits(work, limits).any() and not Censored.along(work, *args).samples.any()


def searched(name: str, lacking: bool) -> Posterior:
    case = {**SEEN, **HELD_OUT}[name]
    recordings = case.recordings(np.random.default_rng(5), lacking)
    model = Simulator(case.machine.model).model.pinned()
    found = posterior(model, [Prepared.build(model, r) for r in recordings])
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("oven", {"quadratic_drag@equation:C": 0.03}),
        pytest.param("tanks", {"linear_stiffness@equation:h2": 0.18}, marks=pytest.mark.long),
        pytest.param("pendulum", {"coulomb_friction@equation:w": 0.8}, marks=pytest.mark.long),
    ],
)
def test_a_law_is_found_beside_a_sensor_at_its_limit(name: str, law: dict[str, float]) -> None:
    found = searched(name, lacking=True)
    labels = {found.candidates[i].label: i for i in found.leader.members}
    case = {**SEEN, **HELD_OUT}[name]
    assert labels.keys() == law.keys() | {f"clipping@output:{case.output}"}
    for label, value in law.items():
        own = found.leader.names[labels[label]]
        estimate, deviation = found.leader.constants[next(iter(own.values()))]
        assert abs(estimate - value) < 4.0 * deviation
    ends = found.candidates[labels[f"clipping@output:{case.output}"]].parameters
    assert all(isinstance(end, Threshold) for end in ends)
