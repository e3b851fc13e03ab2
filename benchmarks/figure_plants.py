"""Ten plants whose figures of a report have closed forms, and what the report says of them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.optimize

from benchmarks.figure_parts import (
    COUNT,
    NEEDED,
    NOISE,
    STEP,
    TIME,
    Drive,
    Parts,
    Row,
    cart,
    integral,
    some,
    white,
)
from jaxsr.diagnosis.explaining.acting import where_acting
from jaxsr.diagnosis.explaining.detectable import detectable_rows
from jaxsr.diagnosis.explaining.evidence import noise_floor
from jaxsr.diagnosis.explaining.explain import Weight, confusable_rows
from jaxsr.diagnosis.explaining.member_costs import costs_of_sets
from jaxsr.diagnosis.explaining.value_findings import weight_of_value
from jaxsr.diagnosis.explaining.wrong_values import frozen
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.external import push
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.shooting.arena import neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.scoring import free_run
from jaxsr.diagnosis.shooting.uncertainty import sensitivities
from jaxsr.models import Model, Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording


def _ramp(horizon: float, begin: int, count: int) -> float:
    """NRMSE of a constant that is fitted to the first `begin` of `count` samples of a ramp."""
    samples = round(horizon / STEP)
    error = (np.arange(COUNT) % samples - 0.5 * (begin - 1)) if samples < count else None
    error = np.arange(count) - 0.5 * (begin - 1) if error is None else error
    return float(np.sqrt(np.mean(error**2)) / np.std(np.arange(count)))


def free_runs(_: int) -> Iterator[Row]:
    """A constant against a ramp: the start of every run is the mean of its first samples."""
    model = parse_model(
        '[model]\nstates = ["x"]\noutputs = ["y"]\n[equations]\nx = "0*x"\n[readings]\ny = "x"\n'
    )

    def score(horizon: float | None, *recordings: Recording) -> float:
        prepared = [Prepared.build(model, r) for r in recordings]
        return free_run(Simulator(model), Stepping("rk4", 1), prepared, np.zeros(0), horizon).nrmse

    ramp = Recording("a.csv", TIME, {"y": TIME})
    yield Row("horizon 0.2 s, 3 samples", score(0.2, ramp), _ramp(0.2, 3, COUNT), 1e-6)
    yield Row("horizon 2 s, 5 % are 10", score(2.0, ramp), _ramp(2.0, 10, COUNT), 1e-6)
    yield Row("whole, at least 50", score(None, ramp), _ramp(10.0, 50, COUNT), 1e-6)
    short = Recording("b.csv", TIME[:400], {"y": TIME[:400]})
    both = 0.5 * (_ramp(10.0, 50, COUNT) + _ramp(4.0, 50, 400))
    yield Row("mean over recordings", score(None, ramp, short), both, 1e-6)
    holes = TIME.copy()
    holes[600::2] = np.nan
    kept = np.isfinite(holes)
    error = (np.arange(COUNT) - 24.5)[kept] * STEP
    exact = float(np.sqrt(np.mean(error**2)) / np.std(TIME[kept]))
    yield Row(
        "missing samples skipped", score(None, replace(ramp, channels={"y": holes})), exact, 1e-6
    )


def failing_outputs(_: int) -> Iterator[Row]:
    """One of two outputs diverges; an output is held until its delay has passed."""
    model = parse_model(
        '[model]\nstates = ["x", "z"]\noutputs = ["y", "w"]\n[equations]\nx = "1 + 0*x"\n'
        'z = "z**3"\n[readings]\ny = "x"\nw = "z"\n[initial]\nx = 0.0\nz = 1.0\n'
    )
    channels = {"y": 2.0 * TIME, "w": np.sin(TIME)}
    item = Prepared.build(model, Recording("a.csv", TIME, channels))
    found = free_run(Simulator(model), Stepping("rk4", 4), [item], np.zeros(0), None).nrmse
    first = np.mean(TIME**2) / np.var(2.0 * TIME)
    yield Row("a diverged output is 10", found, float(np.sqrt(0.5 * (first + 100.0))), 1e-6)
    late = parse_model(
        '[model]\nstates = ["x"]\noutputs = ["y"]\n[equations]\nx = "1 + 0*x"\n[readings]\n'
        'y = "x"\n[initial]\nx = 0.0\n[delays]\ny = 0.5\n'
    )
    item = Prepared.build(late, Recording("a.csv", TIME, {"y": TIME - 0.5}))
    found = free_run(Simulator(late), Stepping("rk4", 1), [item], np.zeros(0), None).nrmse
    error = np.minimum(TIME - 0.5, 0.0)
    exact = float(np.sqrt(np.mean(error**2)) / np.std(TIME))
    yield Row("held until the delay has passed", found, exact, 1e-3)


def _left(target: np.ndarray, *columns: np.ndarray) -> float:
    """Sum of squares that the best sum of columns leaves."""
    if not columns:
        return float(target @ target)
    matrix = np.stack(columns, axis=1)
    rest = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
    return float(rest @ rest)


def _weight(found: Parts, number: int, given: float) -> Weight:
    """What one member of the chosen set matters."""
    costs = costs_of_sets(found.parts, found.chosen)
    rest = frozenset(found.chosen.members) - {number}
    return Weight.of(given, costs[rest], found.chosen.fit.cost)


def shares(seed: int) -> Iterator[Row]:
    """A gain b that re-calibration finds in part, and forces beside it: a linear regression."""
    model = cart("b*u", "b = { value = 1.0, bounds = [-50, 50] }", "0.0")
    u = np.cos(2.0 * TIME)
    ramp, slow = TIME.copy(), integral(np.sin)
    driven = integral(lambda t: np.cos(2.0 * t))
    y = 1.4 * driven + 0.02 * ramp - 0.04 * slow + white(seed + 1)
    force = some(model, {"u": u, "q": y, "v": y}, "constant_force@equation:v")[0]
    wave = replace(
        force, mechanism="drift", terms=(("v", "+ {F0}*sin(t)"),), sentence="A slow wave."
    )
    recording = Recording("a.csv", TIME, {"u": u, "y": y})
    parts = Parts.of(model, [recording], [force, wave], (0, 1))
    given = enter(frozen(parts.arena), (), neutral_values(parts.arena.super_model)).fit.cost
    g = _left(y - driven)
    e = _left(y, driven, ramp, slow)
    for number, rest in ((0, slow), (1, ramp)):
        w = _left(y, driven, rest)
        weight = _weight(parts, number, given)
        name = parts.arena.super_model.candidates[number].mechanism
        yield Row(f"share of {name}", weight.share, (w - e) / (g - e), 1e-3)
        yield Row(f"times without {name}", weight.times, w / e, 1e-3)
    alone = Parts.of(model, [recording], [force], (0,))
    r, e = _left(y, driven), _left(y, driven, ramp)
    weight = _weight(alone, 0, given)
    yield Row("share of the one finding", weight.share, (r - e) / (g - e), 1e-3)
    said = f"{round(100 * (r - e) / (g - e))} % of the given model's mismatch would come back"
    yield Row("said in words", said if said in weight.in_words() else weight.in_words(), said)


def wrong_values(seed: int) -> Iterator[Row]:
    """Two gains of which one is wrong: the other cannot make it good."""
    bounds = "{ value = 1.0, bounds = [-50, 50] }"
    model = cart("b*u + c*t", f"b = {bounds}\nc = {bounds}", "0.0")
    u = np.cos(2.0 * TIME)
    driven, ramp = integral(lambda t: np.cos(2.0 * t)), 0.5 * TIME**2
    y = 1.5 * driven + 1.01 * ramp + white(seed + 2)
    parts = Parts.of(model, [Recording("a.csv", TIME, {"u": u, "y": y})], [])
    g, e = _left(y - driven - ramp), _left(y, driven, ramp)
    for name, own, other in (("b", driven, ramp), ("c", ramp, driven)):
        weight = weight_of_value(parts.parts, name, g / NOISE**2)
        yield Row(f"share of {name}", weight.share, (_left(y - own, other) - e) / (g - e), 1e-3)


def _seen(column: np.ndarray, *known: np.ndarray) -> float:
    """Length of a column beside a constant and others."""
    return float(np.sqrt(_left(column, np.ones(COUNT), *known)))


def _detected(model: Model, drive: Drive, recording: Recording, *labels: str) -> dict[str, Any]:
    parts = Parts.of(model, [recording], some(model, drive.signals, *labels))
    return detectable_rows(parts.parts, sensitivities(parts.arena, parts.null.fit))


def detectable(seed: int) -> Iterator[Row]:
    """Forces on a cart whose speed is read: their effects are integrals."""
    drive = Drive.drawn(seed)
    effects = {
        "viscous_damping@equation:v": integral(drive.speed),
        "coulomb_friction@equation:v": integral(lambda t: np.sign(drive.speed(t))),
        "constant_force@equation:v": TIME,
        "quadratic_drag@equation:v": integral(lambda t: drive.speed(t) * np.abs(drive.speed(t))),
        "input_gain@input:u": drive.speed(TIME),
    }
    rows = _detected(cart(), drive, drive.recording(white(seed + 3)), *effects)
    for label, column in effects.items():
        found = rows.get(label, {}).get("value")
        # The noise is white, of which 1000 samples show a correlation of up to 0.1 (3 sigma).
        yield Row(label, found, NEEDED * NOISE / _seen(column), 0.1)


def thresholds(seed: int) -> Iterator[Row]:
    """A limit and a dead zone have no tangent where they do nothing: they are followed."""
    drive, level = Drive.drawn(seed), NEEDED * NOISE
    limit, zone = "input_saturation@input:u", "input_deadzone@input:u"
    rows = _detected(cart(), drive, drive.recording(white(seed + 4)), limit, zone)
    top = float(np.abs(drive.command(TIME)).max())

    def lost(us: float) -> float:
        return (
            _seen(integral(lambda t: drive.command(t) - np.clip(drive.command(t), -us, us))) - level
        )

    def dead(ud: float) -> float:
        return _seen(integral(lambda t: np.clip(drive.command(t), -ud, ud))) - level

    us: Any = scipy.optimize.brentq(lost, 0.1 * top, 0.999999 * top)
    ud: Any = scipy.optimize.brentq(dead, 1e-6 * top, 0.9 * top)
    yield Row("limit us", rows.get(limit, {}).get("value"), float(us), 0.01)
    yield Row("dead zone ud", rows.get(zone, {}).get("value"), float(ud), 0.1)


def untold(seed: int) -> Iterator[Row]:
    """What the free parameters take, and what only an absurd size would show, is left out."""
    drive = Drive.drawn(seed)
    gain, limit = "input_gain@input:u", "input_saturation@input:u"
    friction, drag = "coulomb_friction@equation:v", "quadratic_drag@equation:v"
    mass = cart("u/m", "m = { value = 1.0, bounds = [0.1, 10] }")
    force = cart("u + f", "f = { value = 0.0, bounds = [-5, 5] }")
    forward = replace(drive, offset=2.0)
    for name, model, motion, share, label in (
        ("gain beside a free mass", mass, drive, 1.0, gain),
        ("friction that never reverses beside a free force", force, forward, 1.0, friction),
        ("drag where hardly anything moves", cart(), drive, 1e-4, drag),
        ("a limit on commands below the noise", cart(), drive, 1e-3, limit),
    ):
        rows = _detected(model, motion, motion.recording(white(seed + 5), share), label)
        yield Row(name, rows.get(label, {}).get("value"), None)


def _where(candidate: Candidate, drive: Drive, **values: float) -> dict[str, Any]:
    parts = Parts.of(cart(), [drive.recording()], [candidate])
    theta = neutral_values(parts.arena.super_model)
    order = list(parts.arena.super_model.model.parameters)
    for own, full in parts.arena.super_model.names[0].items():
        theta[order.index(full)] = values[own]
    entry = replace(parts.null, members=(0,), fit=replace(parts.null.fit, theta=theta))
    return where_acting(candidate, replace(parts, chosen=entry).estimate(), 0)


def regions(seed: int) -> Iterator[Row]:
    """Terms act where they are more than a twentieth of their largest."""
    drive, model = Drive.drawn(seed), cart()
    signals = drive.signals

    def region(label: str, **values: float) -> list[dict[str, Any]]:
        return _where(some(model, signals, label)[0], drive, **values)["region"]

    (row,) = region("coulomb_friction@equation:v", Fc=0.4)
    yield Row("friction acts everywhere, from", row["from"], float(signals["v"].min()), 1e-3)
    yield Row("friction acts everywhere, to", row["to"], float(signals["v"].max()), 1e-3)
    edge = float(np.sqrt(0.05) * np.abs(signals["v"]).max())
    low, high = region("quadratic_drag@equation:v", kd=0.4)
    yield Row("drag, backwards up to", low["to"], -edge, 0.1)
    yield Row("drag, forwards from", high["from"], edge, 0.1)
    top = float(signals["q"].max())
    (row,) = region("piecewise_stiffness@equation:v", ks=5.0, qs=0.6 * top)
    yield Row("a second spring from", row["from"], 0.6 * top + 0.05 * 0.4 * top, 0.02)
    most = drive.frequency
    low, high = region("input_saturation@input:u", us=0.5 * most)
    command = signals["u"]
    edge = 0.95 * 0.5 * most + 0.05 * float(np.abs(command).max())
    yield Row("a limit, below", low["to"], float(command[command < -edge].max()), 0.01)
    yield Row("a limit, above", high["from"], float(command[command > edge].min()), 0.01)
    pulse = push(sites_of(model, {})[0], 4.0, 0.5, (), 1, np.inf)
    ((begin, end),) = _where(pulse, drive, J=1.0, t0=4.0, dt=0.5)["times"]
    reach = 0.5 * float(np.sqrt(np.log(20.0)))
    yield Row("a push, from", begin, 4.0 - reach, 0.01)
    yield Row("a push, to", end, 4.0 + reach, 0.01)


def angles(seed: int) -> Iterator[Row]:
    """Angles between effects are those of their integrals beside a constant."""
    drive, model = Drive.drawn(seed), cart()
    columns = {
        "viscous_damping": integral(drive.speed),
        "coulomb_friction": integral(lambda t: np.sign(drive.speed(t))),
        "constant_force": TIME,
    }
    candidates = some(model, drive.signals, *(f"{name}@equation:v" for name in columns))
    parts = Parts.of(model, [drive.recording(white(seed + 9))], candidates)
    found = confusable_rows(parts.parts, sensitivities(parts.arena, parts.null.fit))
    rows = {frozenset(pair): angle for *pair, angle in found}
    for one, other in itertools.combinations(columns, 2):
        a, b = (columns[n] - columns[n].mean() for n in (one, other))
        angle = float(np.degrees(np.arccos(abs(a @ b) / np.sqrt((a @ a) * (b @ b)))))
        if abs(angle - 30.0) > 1.0:  # where the list ends
            exact = angle if angle < 30.0 else None
            yield Row(f"{one}, {other}", rows.get(frozenset((one, other))), exact, 0.02)


def floors(seed: int) -> Iterator[Row]:
    """What noise alone makes of the free-run error: stated, or read off neighbouring samples."""
    recording = Drive.drawn(seed).recording(white(seed + 10))
    deviation = float(np.std(recording.channels["y"]))
    stated = replace(cart(), noise={"y": 0.02})
    yield Row("stated noise", noise_floor(stated, [recording]), 0.02 / deviation, 1e-9)
    yield Row("estimated noise", noise_floor(cart(), [recording]), NOISE / deviation, 0.15)


PLANTS: dict[str, Callable[[int], Iterator[Row]]] = {
    "free runs": free_runs,
    "failing outputs": failing_outputs,
    "shares": shares,
    "wrong values": wrong_values,
    "smallest detectable": detectable,
    "thresholds": thresholds,
    "not identifiable": untold,
    "where": regions,
    "confusable": angles,
    "noise floor": floors,
}
