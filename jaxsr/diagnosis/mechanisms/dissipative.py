"""Dissipative mechanisms: forces that take energy out of a motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site, inverse_unit
from jaxsr.diagnosis.mechanisms.springs import compared_to
from jaxsr.expressions import evaluate, to_text
from jaxsr.expressions.term import Term
from jaxsr.models.units import dimension

_FRICTION = "Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994)"
_VARIES = "Dry friction along {site} depends on the position."


def dissipative(site: Site) -> Iterator[Candidate]:
    """Yield friction and drag at an equation of motion."""
    v = site.state
    if site.position is None and site.others and not is_speed(site):
        return

    yield Candidate(
        "viscous_damping",
        "dissipative",
        site.name,
        (ParameterSpec("Fv", site.per(v), low=0.0),),
        "A resistance in proportion to velocity acts along {site}.",
        terms=((v, f"- {{Fv}}*{v}"),),
        source=_FRICTION,
    )
    yield from _along(site, v)
    for other in moved_past(site):
        yield from _along(site, f"({v} - {to_text(other)})", other)
    yield from position_dependent(site)


def moved_past(site: Site) -> list[Term]:
    """Return what the model takes the speed relative to: a belt, wind or a current, c*(v - b).

    What a store is compared to are its `surroundings`.
    """
    if site.position is None and not is_speed(site):
        return []
    return compared_to(site.model, site.state)


def _along(site: Site, w: str, other: Term | None = None) -> Iterator[Candidate]:
    """Yield friction and drag that oppose a speed w: that of a site, or relative to another."""
    v, f, past = site.state, site.force_unit, "" if other is None else f" past {to_text(other)}"

    def make(name: str, term: str, *specs: ParameterSpec, sentence: str, source: str = _FRICTION):
        return Candidate(
            name, "dissipative", site.name, specs, sentence, terms=((v, term),), source=source
        )

    yield make(
        "coulomb_friction",
        f"- {{Fc}}*sign({w})",
        ParameterSpec("Fc", f, low=0.0),
        sentence=f"Dry friction of constant size opposes the motion along {{site}}{past}.",
    )
    if other is None and site.reverses:
        yield make(
            "asymmetric_friction",
            f"- {{Fa}}*Abs({w})",
            ParameterSpec("Fa", site.per(v)),
            sentence="The viscous resistance along {site} differs between the two directions.",
        )
    yield make(
        "quadratic_drag",
        f"- {{kd}}*{w}*Abs({w})",
        ParameterSpec("kd", site.per(v, v), low=0.0),
        sentence=f"A drag that grows with the square of velocity acts along {{site}}{past}.",
        source="Batchelor, An Introduction to Fluid Dynamics (1967), section 5.11",
    )
    speeds = site.scale.get(v)
    if speeds is None:
        return
    top = max(abs(speeds[0]), abs(speeds[-1])) + (0.0 if other is None else _most(site, other))
    vs_unit = site.model.units.get(v)
    # The Gaussian peak first; the exponential one (n = 1) has a sharper tip and longer tails.
    for power, shares in (("**2", (0.02, 0.06, 0.2)), ("", (0.05, 0.15))):
        for share in shares:
            yield make(
                "stribeck_friction",
                f"- ({{Fc}} + ({{Fs}} - {{Fc}})*exp(-(Abs({w})/{{vs}}){power}))*sign({w})",
                ParameterSpec("Fc", f, low=0.0),
                ParameterSpec("Fs", f, low=0.0, floor="Fc"),
                ParameterSpec("vs", vs_unit, 1e-3 * top, top, share * top, False),
                sentence=f"Dry friction along {{site}}{past} is higher near standstill (Stribeck "
                "effect).",
            )
    for power in (0.5, 1.5, 3.0):
        yield make(
            "power_law_drag",
            f"- {{kd}}*sign({w})*Abs({w})**{{p}}",
            # kd is the force at |v| = 1 in the model's unit, whatever p becomes.
            ParameterSpec("kd", f, low=0.0),
            ParameterSpec("p", "1", 0.2, 5.0, power, False),
            sentence=f"A drag that grows with a power of velocity acts along {{site}}{past}.",
            source="Nayfeh & Mook, Nonlinear Oscillations (1979), section 3.3",
        )


def _most(site: Site, speed: Term) -> float:
    """Return the largest size of a speed that is a number, a parameter or an input."""
    parameters = {n: p.value for n, p in site.model.parameters.items()}
    inputs = {u: site.scale.get(u, np.zeros(1)) for u in site.model.inputs}
    ends = [{u: float(values[k]) for u, values in inputs.items()} for k in (0, -1)]
    return max(abs(float(evaluate(speed, {**parameters, **end}))) for end in ends)


def is_speed(site: Site) -> bool:
    """Whether a state without a position is a speed: by its unit, else if it changes its sign.

    A motor whose angle nobody needs is written so. A current changes its sign too, and has a
    unit of its own; levels and temperatures do not. Nor does a car's speed: there the model tells,
    where its own equation multiplies by the sign or the size of that state. (What only keeps a root
    real, ``sqrt(Abs(h))``, does not.)
    """
    unit = site.model.units.get(site.state)
    if unit is not None:
        return dimension(unit) in (dimension("m/s"), dimension("rad/s"))
    factors = [
        factor
        for node in site.model.equation_terms[site.state].distinct()
        if node.op == "mul"
        for factor in (arg.args[0] if arg.op == "neg" else arg for arg in node.args)
    ]
    signed = any(
        factor.op in ("sign", "abs") and factor.args[0].variables == {site.state}
        for factor in factors
    )
    return signed or (site.scale.get(site.state) is not None and site.reverses)


def position_dependent(site: Site) -> Iterator[Candidate]:
    """Yield dry friction whose size varies along the path, nowhere on it below zero.

    Fc is the friction at the origin of the position, or in the middle of a path that leaves it
    out.
    """
    q, v, f = site.position, site.state, site.force_unit
    if q is None or not covered(site):
        return
    values = site.scale.get(q)
    if values is None:
        return
    low, middle, high = (
        float(f"{x:.3g}") for x in (values[1], (values[1] + values[-2]) / 2, values[-2])
    )

    def make(shape: str, *specs: ParameterSpec) -> Candidate:
        return Candidate(
            "position_dependent_friction",
            "dissipative",
            site.name,
            (ParameterSpec("Fc", f, low=0.0), *specs),
            _VARIES,
            terms=((v, f"- ({{Fc}} + {shape})*sign({v})"),),
            source=_FRICTION,
        )

    origin = 0.0 if low < 0.0 < high else middle

    def never_drives(own: Mapping[str, float]) -> bool:
        return all(own["Fc"] + own["g1"] * (end - origin) >= 0.0 for end in (low, high))

    distance = f"({q} - ({middle}))" if origin else q
    linear = make(f"{{g1}}*{distance}", ParameterSpec("g1", site.per(q)))
    yield replace(linear, physical=never_drives)
    yield make(f"{{g2}}*({q} - ({middle}))**2", ParameterSpec("g2", site.per(q, q), low=0.0))
    for number, phase in _friction_ripples(site):
        yield friction_ripple(site, number, phase)


def friction_ripple(site: Site, number: float, phase: float) -> Candidate:
    """Return dry friction whose size repeats along the path."""
    q, v, f = site.position, site.state, site.force_unit
    return Candidate(
        "position_dependent_friction",
        "dissipative",
        site.name,
        (
            ParameterSpec("Fc", f, low=0.0),
            ParameterSpec("gn", f, low=0.0),
            ParameterSpec(
                "n",
                inverse_unit(site.model.units.get(q or "")),
                0.5 * number,
                2 * number,
                number,
                False,
            ),
            ParameterSpec("phi", "rad", -10.0, 10.0, phase, False),
        ),
        _VARIES,
        terms=((v, f"- ({{Fc}} + {{gn}}*(1 + sin({{n}}*{q} + {{phi}})))*sign({v})"),),
        source=_FRICTION,
    )


def covered(site: Site) -> bool:
    """Whether every quarter of the recorded path is run through both ways.

    Friction that varies along the path is seen as half the difference between the two ways;
    where only one way was recorded, a spring does the same.
    """
    path, speed = site.signal(site.position), site.signal(site.state)
    if path is None or speed is None:
        return site.reverses
    low, high = np.quantile(path, [0.02, 0.98])
    edges = np.linspace(low, high, 5)
    quarter = np.digitize(path, edges[1:-1])
    least = 0.01 * path.size
    return all(
        ((quarter == k) & (way * speed > 0)).sum() >= least for k in range(4) for way in (-1, 1)
    )


def _friction_ripples(site: Site) -> list[tuple[float, float]]:
    """Wave numbers and phases at which sign(v)*sin(n*q) removes a line of the residual."""
    path, speed = site.signal(site.position), site.signal(site.state)
    if site.motion is None or path is None or speed is None or not site.turning:
        return []
    way = np.sign(speed)

    def pair(n: float) -> np.ndarray:
        return np.stack([way * np.sin(n * path), way * np.cos(n * path)], axis=1)

    grid = wave_numbers(site)
    # The friction is minus this: half a turn on.
    return [
        (x.value, (x.phase + 2 * np.pi) % (2 * np.pi) - np.pi)
        for x in site.motion.lines(site.state, pair, grid, 1)
    ]


def wave_numbers(site: Site) -> np.ndarray:
    """Wave numbers from 1.5 periods on the recorded path up to what the weak view resolves."""
    path, speed = site.signal(site.position), site.signal(site.state)
    if site.motion is None or path is None or speed is None:
        return np.zeros(0)
    span = float(np.ptp(path))
    typical = float(np.sqrt(np.mean(speed**2)))
    if not (span > 0.0 and typical > 0.0):
        return np.zeros(0)
    # A test function of half-width 4 * spacing passes phases up to about 2 pi within it.
    low, high = 3.0 * np.pi / span, 4.0 * np.pi / (4.0 * site.motion.spacing * typical)
    if not high > low:
        return np.zeros(0)
    return np.linspace(low, high, int(np.clip(4.0 * (high - low) * span / np.pi, 24, 200)))
