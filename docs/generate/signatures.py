r"""What each mechanism does along one reference motion, as forces and as pictures.

The motion is prescribed, so that nothing is simulated: q(t) is a sum of sines, and the force that
it takes follows from the reference model, J*a + Fv*v + k*q. A mechanism's *signature* is the force
that it adds, or, of a sensor, the error of the reading. Two mechanisms are compared as forces with
the free parameters J, Fv and k projected out, as an estimate of these would do:

.. math:: \angle(f, g) = \arccos \frac{|Pf \cdot Pg|}{|Pf|\,|Pg|}.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.mechanisms import Candidate, Threshold, force_candidates, sensor_candidates
from jaxsr.diagnosis.mechanisms.memory import memory_candidates
from jaxsr.diagnosis.mechanisms.presliding import presliding
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.expressions import evaluate, parse
from jaxsr.models import parse_model

JOINTS = """
[model]
states = ["q", "qj", "v", "vj"]
inputs = ["u", "uj"]
outputs = ["y", "yj"]
[equations]
q = "v"
qj = "vj"
v = "u - Fv*v - k*q"
vj = "uj - Fv*vj - k*qj"
[inertia]
v = { v = "J" }
vj = { vj = "J" }
[readings]
y = "c*q"
yj = "c*qj"
[parameters]
J = { value = 1.0, unit = "kg*m^2", bounds = [0.1, 10.0] }
Fv = { value = 0.5, unit = "N*m*s/rad", bounds = [0.0, 10.0] }
k = { value = 4.0, unit = "N*m/rad", bounds = [0.0, 50.0] }
c = { value = 1.0 }
[units]
q = "rad"
qj = "rad"
v = "rad/s"
vj = "rad/s"
u = "N*m"
uj = "N*m"
y = "rad"
yj = "rad"
"""
LEVELS = """
[model]
states = ["h", "hj"]
inputs = ["u"]
outputs = ["y"]
[equations]
h = "ki*u - ko*h"
hj = "ko*h - ko*hj"
[readings]
y = "hj"
[parameters]
ki = { value = 1.0, bounds = [0.1, 10.0] }
ko = { value = 1.0, bounds = [0.1, 10.0] }
"""
SECONDS, SAMPLES = 20.0, 2001
SHOWN = 10.0
"""Seconds of the motion in a picture."""
TIME = np.linspace(0.0, SECONDS, SAMPLES)
# Amplitude, frequency in Hz and phase: incommensurate, none in a mechanism's first guesses.
WAVES = ((1.0, 0.3, 0.0), (0.5, 0.71, 1.0), (0.2, 1.3, 2.0))
OTHER = ((0.8, 0.41, 2.0), (0.4, 0.93, 0.3))


@dataclass(frozen=True, eq=False)
class Signature:
    """The force of a mechanism along the reference motion, and what a picture shows.

    Attributes
    ----------
    force : ndarray, shape (samples,)
        Equivalent force on q.
    shown : ndarray, shape (samples,)
        The force, or the error of a reading.
    over, label : str
        Symbol of the horizontal axis, and what the vertical one is.
    """

    force: np.ndarray
    shown: np.ndarray
    over: str
    label: str


def waves(parts: tuple[tuple[float, float, float], ...], time: np.ndarray, order: int = 0):
    """Return a sum of sines or its derivative of an order."""
    turn = 0.5 * np.pi * order
    return sum(
        a * (2 * np.pi * f) ** order * np.sin(2 * np.pi * f * time + p + turn) for a, f, p in parts
    )


def driving(parts: tuple[tuple[float, float, float], ...], time: np.ndarray) -> np.ndarray:
    """Return the force that the reference model takes to follow a motion."""
    q, v, a = (waves(parts, time, order) for order in range(3))
    return a + 0.5 * v + 4.0 * q


def environment(time: np.ndarray) -> dict[str, np.ndarray]:
    """Return every symbol of the reference models along the motion."""
    found = {"t": time, "q": waves(WAVES, time), "v": waves(WAVES, time, 1)}
    found |= {"qj": waves(OTHER, time), "vj": waves(OTHER, time, 1)}
    found |= {"u": driving(WAVES, time), "uj": driving(OTHER, time)}
    found |= {"h": 1.5 + 0.5 * found["q"], "hj": 1.5 + 0.5 * found["qj"]}
    return found | {n: np.full_like(time, v) for n, v in (("J", 1.0), ("Fv", 0.5), ("k", 4.0))}


def offered() -> dict[str, list[Candidate]]:
    """Return the candidates of every mechanism at the first place that offers it."""
    at = environment(TIME)
    found: dict[str, list[Candidate]] = {}
    for text in (JOINTS, LEVELS):
        model = parse_model(text)
        scale = {s: np.quantile(at[s], np.linspace(0.0, 1.0, 21)) for s in model.states}
        step = SECONDS / (SAMPLES - 1)
        candidates = [
            *force_candidates(model, scale),
            *memory_candidates(model, scale, step),
            *(c for site in sites_of(model, scale) for c in presliding(site)),
            *sensor_candidates(model),
            *timing_candidates(model, step, SECONDS),
        ]
        new: dict[str, list[Candidate]] = {}
        for candidate in candidates:
            new.setdefault(candidate.mechanism, []).append(candidate)
        found |= {name: many for name, many in new.items() if name not in found}
    return {name: [c for c in many if c.site == many[0].site] for name, many in found.items()}


def values_of(candidate: Candidate) -> dict[str, float]:
    """Return values at which a mechanism acts visibly."""
    own = {"tau": 0.1, "s": 0.01, "wh": 12.0, "ymax": 0.8, "kt": 0.05, "Fs": 2.0, "vs": 0.6}
    own |= {"us": 12.0, "ud": 4.0, "n": 6.0, "w": 4.0, "b": 0.4}
    own |= {"qs": 1.0, "ks": 4.0} if candidate.mechanism == "end_stop" else {}
    own |= {"t0": 4.0} if candidate.family == "external" else {}
    own |= {"b": 1.2, "g": 0.7} if candidate.mechanism == "hysteresis" else {}
    own |= {"gc": 0.1, "g1": 0.3} if candidate.family == "actuator" else {}
    found = {}
    for spec in candidate.parameters:
        start = spec.seed if isinstance(spec, Threshold) else spec.neutral + spec.coefficient
        found[spec.name] = own.get(spec.name, start)
    if candidate.fixed_parameter is not None:
        found = {candidate.fixed_parameter: 1.2}
    return found


def signature(candidate: Candidate) -> Signature:
    """Return what a candidate does along the reference motion."""
    at, values = environment(TIME), values_of(candidate)
    names = {**{n: n for n in values}, **{s.name: s.name for s in candidate.states}}
    at |= {name: np.full_like(TIME, value) for name, value in values.items()}
    at |= {name: at[p] for name, p in candidate.borrowed if p in at}
    at |= _driven(candidate, names, at)
    error = _reading(candidate, names, at)
    if error is not None:
        rate = np.gradient(error, TIME)
        force = np.gradient(rate, TIME) + 0.5 * rate + 4.0 * error
        return Signature(force, error, "t", "error of the reading")
    force = np.zeros_like(TIME)
    place = candidate.terms[0][0] if candidate.terms else "v"
    for state, template in candidate.terms:
        if state == place:
            force = force + _value(template.format(**names).removeprefix("+ "), at)
    for _, _, template in candidate.inertia:
        force = force - _value(template.format(**names), at) * waves(WAVES, TIME, 2)
    for _, template in candidate.replaced:
        force = force + at[template.strip("{}")] - at["u"]
    for _ in candidate.delays:
        force = force + driving(WAVES, TIME - values["tau"]) - at["u"]
    return Signature(force, force, _axis(candidate, place), "force")


def _axis(candidate: Candidate, place: str) -> str:
    if candidate.mechanism == "overflow":
        return "h"
    if candidate.family == "dissipative":
        return "v"
    if candidate.family == "elastic" or candidate.mechanism in ("gravity", "hysteresis"):
        return "q"
    if candidate.mechanism.startswith("input_") and not candidate.delays:
        return "u"
    return "q" if candidate.mechanism in ("position_ripple", "constant_force") else "t"


def _value(text: str, at: Mapping[str, np.ndarray]) -> np.ndarray:
    return evaluate(parse(text, at.keys()), at) + np.zeros_like(TIME)


def _driven(
    candidate: Candidate, names: Mapping[str, str], at: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Integrate the states of a mechanism along the motion, by Heun's rule."""
    own = [s.name for s in candidate.states]
    if not own:
        return {}
    rates = [parse(s.equation.format(**names), (*at, *own)) for s in candidate.states]
    used = {n: at[n] for r in rates for n in r.variables if n in at}
    step, path = TIME[1] - TIME[0], np.zeros((SAMPLES, len(own)))

    def rate(k: int, x: np.ndarray) -> np.ndarray:
        here = {n: values[k] for n, values in used.items()} | dict(zip(own, x, strict=True))
        return np.array([float(evaluate(r, here)) for r in rates])

    for k in range(SAMPLES - 1):
        first = rate(k, path[k])
        path[k + 1] = path[k] + 0.5 * step * (first + rate(k + 1, path[k] + step * first))
    return dict(zip(own, path.T, strict=True))


def _reading(
    candidate: Candidate, names: Mapping[str, str], at: Mapping[str, np.ndarray]
) -> np.ndarray | None:
    """Return the error of a reading, where the mechanism is one of the sensor."""
    if candidate.readings:
        return _value(candidate.readings[0][1].format(old="q", **names), at) - at["q"]
    if candidate.site.startswith("output:") and candidate.delays:
        return waves(WAVES, TIME - at["tau"]) - at["q"]
    if candidate.clock:
        return waves(WAVES, (1.0 + at["s"]) * TIME) - at["q"]
    return at["q"] * 0.2 if candidate.fixed_parameter is not None else None


def nearest(found: Mapping[str, Signature], name: str, count: int = 3) -> list[tuple[str, float]]:
    """Return the mechanisms of the smallest angles to one, in degrees, and the free parameters.

    A mechanism that the free parameters reproduce to within a degree is told from none.
    """
    free = np.stack([waves(WAVES, TIME, order) for order in range(3)], axis=1)
    basis = np.linalg.qr(free)[0]

    def left(force: np.ndarray) -> np.ndarray:
        return force - basis @ (basis.T @ force)

    own = left(found[name].force)
    if np.linalg.norm(own) < np.sin(np.deg2rad(1.0)) * np.linalg.norm(found[name].force):
        return [("free parameters", 0.0)]
    angles = []
    for other, column in found.items():
        if column.over == "h" or found[name].over == "h":  # levels are another plant
            continue
        rest = left(column.force)
        size = np.linalg.norm(rest)
        if other == name or size < np.sin(np.deg2rad(1.0)) * np.linalg.norm(column.force):
            continue
        cosine = min(abs(own @ rest) / (np.linalg.norm(own) * size), 1.0)
        angles.append((other, float(np.rad2deg(np.arccos(cosine)))))
    return sorted(angles, key=lambda item: item[1])[:count]


def picture(found: Signature) -> str:
    """Return a signature as a small SVG: grey axes, one line."""
    at = environment(TIME)
    keep = slice(0, int(SHOWN / SECONDS * (SAMPLES - 1)) + 1, 3)
    x, y = at[found.over][keep], found.shown[keep]
    order = np.argsort(x, kind="stable")
    if np.abs(np.diff(y[order])).sum() < np.abs(np.diff(y)).sum():  # a function of x alone
        x, y = x[order], y[order]
    span = max(float(np.ptp(x)), 1e-12)
    top = max(float(np.max(np.abs(y))), 1e-12)
    across = np.rint(12 + 196 * (x - x.min()) / span).astype(int)
    down = np.rint(58 - 48 * y / top).astype(int)
    points = " ".join(f"{a},{b}" for a, b in zip(across, down, strict=True))
    zero = round(12 + 196 * (0.0 - float(x.min())) / span)
    upright = f'<path d="M{zero} 8V108" stroke="#bbb"/>' if x.min() < 0.0 < x.max() else ""
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 220 124" width="220" height="124" '
        'font-family="sans-serif" font-size="10" fill="#777">'
        f'<path d="M12 58H208" stroke="#bbb"/>{upright}'
        f'<polyline points="{points}" fill="none" stroke="#0072b2" stroke-width="1.5"/>'
        f'<text x="208" y="120" text-anchor="end">{found.over}</text>'
        f'<text x="12" y="120">{found.label}</text></svg>\n'
    )
