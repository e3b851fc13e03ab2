"""Mechanisms with memory: lags, hysteresis, hidden resonators, drifts, overflows."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import AddedState, Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.motion import Motion
from jaxsr.diagnosis.mechanisms.presliding import presliding
from jaxsr.diagnosis.mechanisms.site import Site, compose, sites_of
from jaxsr.models import Model

RESOLVED, STEPS = 0.2, 4
"""Shortest lag in samples, and the steps between samples by which RK4 follows it: at 5/4 of a time
constant a step it leaves 0.290 of a decay instead of exp(-5/4) = 0.287."""
HARD = 100.0
"""Rate of an overflow per sample interval that stands for a hard edge."""
LONGEST = 400.0
"""Longest time constant in samples."""
LAGS = (1.0, 8.0)
"""First guesses of a lag in samples: one nearly absent, and one that is not."""
LOOP = 1.5
"""Largest abs(g)/b of a hysteresis. 1 is where a loop may bring energy in; estimates scatter."""
RESONANCES = (1.2, 2.0, 3.5, 6.0)
"""First guesses of a hidden resonance, in units of the dominant rate of the motion."""
DAMPING = 0.1
"""First guess of its damping ratio."""
FASTEST = 0.7
"""Fastest resonance, in radians per sample."""


def memory_candidates(
    model: Model, scale: Mapping[str, np.ndarray], step: float, motion: Motion | None = None
) -> list[Candidate]:
    """Return every mechanism with a memory.

    Parameters
    ----------
    model : Model
    scale : mapping
        Symbol to quantiles of its values, as `sites_of` takes it.
    step : float
        Sample interval in s: what is faster cannot be told.
    motion : Motion, optional
        Presliding is offered where its residual forces ask for it.
    """
    found = list(actuator_lags(model, step))
    for site in sites_of(model, scale, motion):
        if site.reverses:  # a loop and a resonance show in motion that returns
            found += [*hysteresis(site), *hidden_modes(site, step)]
            found += presliding(site) if motion is not None else []
        found += [*drifts(site), *overflows(site, step)]
    return [*found, *sensor_drifts(model)]


def actuator_lags(model: Model, step: float) -> Iterator[Candidate]:
    """Yield a first-order lag, uf' = (u - uf)/tau with uf in place of u, at every input."""
    # In a Python function an input is replaced where it enters linearly.
    inputs = model.inputs if model.vector_field is None else tuple(model.vector_field.inputs)
    for u, first in itertools.product(inputs, LAGS):
        yield Candidate(
            "actuator_lag",
            "memory",
            f"input:{u}",
            (
                ParameterSpec(
                    "tau",
                    "s",
                    low=RESOLVED * step,
                    high=LONGEST * step,
                    neutral=first * step,
                    coefficient=False,
                ),
            ),
            "The actuator follows {site} with a lag.",
            states=(AddedState("uf", f"({u} - {{uf}})/{{tau}}", model.units.get(u)),),
            replaced=((u, "{uf}"),),
            substeps=STEPS,
            source="Ljung, System Identification (1999), section 4.2",
        )


def hysteresis(site: Site) -> Iterator[Candidate]:
    """Yield Bouc-Wen hysteresis, z' = a*v - b*Abs(v)*z - g*v*Abs(z), force -kz*z.

    The scale of z is free, so a is kept at 1: z then has the unit of q, follows it at small
    motions and levels off at 1/(b + g). The power put in is

        kz*z*v = d/dt (kz*z**2/2) + kz*z**2*abs(v)*(b + g*sign(v*z)),

    and the last part, the loss, is never negative where kz >= 0 and b >= abs(g) (Erlicher & Point,
    C. R. Mecanique 332 (2004)). Dahl's friction is g = 0, an elastic spring in series with a dry
    friction the limit b = g.
    """
    q, v = site.position, site.state
    values = site.scale.get(q) if q is not None else None
    if q is None or values is None:
        return
    reach = 0.5 * float(values[-1] - values[0])
    if reach <= 0.0:
        return
    unit = site.model.units.get(q)
    per = compose("1", [unit]) if unit is not None else None
    start = 0.5 / (0.3 * reach)
    yield Candidate(
        "hysteresis",
        "memory",
        site.name,
        (
            ParameterSpec("kz", site.per(q), low=0.0),
            ParameterSpec("b", per, 0.0, 200.0 / reach, start, coefficient=False),
            ParameterSpec("g", per, -200.0 / reach, 200.0 / reach, 0.6 * start, coefficient=False),
            ParameterSpec("a", "1", neutral=1.0, coefficient=False, fixed=True),
        ),
        "A force along {site} remembers which way it came (hysteresis).",
        terms=((v, "- {kz}*{z}"),),
        states=(AddedState("z", f"{{a}}*{v} - {{b}}*Abs({v})*{{z}} - {{g}}*{v}*Abs({{z}})", unit),),
        physical=dissipates,
        source="Wen, J. Eng. Mech. Div. ASCE 102 (1976)",
    )


def dissipates(values: Mapping[str, float]) -> bool:
    """Tell whether a Bouc-Wen loop never gives more than it stores, within what estimates tell."""
    return abs(values["g"]) <= LOOP * values["b"]


def hidden_modes(site: Site, step: float) -> Iterator[Candidate]:
    """Yield hidden resonators of a few first frequencies about the pace of the motion."""
    q, v = site.position, site.state
    if q is None or q not in site.scale or v not in site.scale:
        return
    spread = {s: float(np.std(site.scale[s])) for s in (q, v)}
    if not spread[q] > 0.0 or not spread[v] > 0.0:
        return
    dominant, top = spread[v] / spread[q], FASTEST / step
    bounds = min(0.1 * dominant, 0.1 * top), top
    for factor in RESONANCES:
        yield hidden_mode(site, min(factor * dominant, 0.5 * top), DAMPING, bounds)


def hidden_mode(
    site: Site, pace: float, damping: float, bounds: tuple[float, float], tried: int = 1
) -> Candidate:
    """Return a mass mh on a spring and a damper that the model does not know.

    qh'' = wh**2*(q - qh) + 2*zh*wh*(v - vh), and the reaction -mh*qh'' acts on the axis. The
    mass starts from zero: then it follows and does nothing.

    Parameters
    ----------
    pace, damping : float
        First guesses of wh in 1/s and of zh.
    bounds : tuple of float
        Of wh.
    tried : int
        First guesses among which this one was picked.
    """
    q, v, units = str(site.position), site.state, site.model.units
    pull = f"{{wh}}**2*({q} - {{qh}}) + 2*{{zh}}*{{wh}}*({v} - {{vh}})"
    unit = site.per(v)
    return Candidate(
        "hidden_mode",
        "memory",
        site.name,
        (
            ParameterSpec("mh", compose(f"{unit}*s", []) if unit else None, low=0.0),
            ParameterSpec("wh", "1/s", *bounds, pace, coefficient=False),
            ParameterSpec("zh", "1", 0.0, 2.0, damping, coefficient=False),
        ),
        "A mass that no sensor sees swings along with {site} (a hidden resonance).",
        terms=((v, f"- {{mh}}*({pull})"),),
        states=(AddedState("qh", "{vh}", units.get(q)), AddedState("vh", pull, units.get(v))),
        tried=tried,
        source="Den Hartog, Mechanical Vibrations (1956), section 3.2",
    )


def drifts(site: Site) -> Iterator[Candidate]:
    """Yield a force that grows with time."""
    if site.position is None and any(o.position is not None for o in site.others):
        return
    unit = compose(site.force_unit, ["s"]) if site.force_unit else None
    yield Candidate(
        "drift",
        "memory",
        site.name,
        (ParameterSpec("kt", unit),),
        "A force along {site} grows steadily with time.",
        terms=((site.state, f"+ {{kt}}*{site.model.time}"),),
        source="Ljung, System Identification (1999), section 14.1",
    )


def overflows(site: Site, step: float) -> Iterator[Candidate]:
    """Yield the loss of what a level holds above an edge, -ko*Max(x - xo, 0), in models of levels.

    The excess is lost, or a part or all of it runs into a level that this one drains into.
    """
    model, x = site.model, site.state
    levels = [s for s in model.dynamic_states if model.kinematic_parent(s) is None]
    values = site.scale.get(x)
    if len(levels) < len(model.dynamic_states) or values is None or not values[-1] > values[0]:
        return
    spread, hardest = float(values[-1] - values[0]), HARD * abs(site.mass) / step
    lost = f"{{ko}}*Max({x} - {{xo}}, 0)"
    others = [
        s
        for s in levels  # those it drains into
        if s != x
        and model.units.get(s) == model.units.get(x)
        and x in model.equation_terms[s].variables
    ]
    # A level that is limited stays just above the edge.
    near = [float(values[-1]) - share * spread for share in (0.03, 0.008)]
    edges = (float(values[17]), float(values[19]), *near)
    some = [(None, ""), *((s, "{part}*") for s in others)]
    ways = [*itertools.product(edges, some), *((e, (s, "")) for e in edges for s in others)]
    part = ParameterSpec("part", "1", 0.0, 3.0, 0.5, coefficient=False)
    for edge, (target, share) in ways:
        terms = ((x, f"- {lost}"),)
        if target is not None:
            terms = (*terms, (target, f"+ {share}{lost}"))
        yield Candidate(
            "overflow",
            "memory",
            site.name,
            (
                ParameterSpec("ko", site.per(x), low=0.0, high=hardest, hard=True),
                ParameterSpec(
                    "xo",
                    model.units.get(x),
                    float(values[0]),
                    float(values[-1]) + spread,
                    edge,
                    coefficient=False,
                ),
                *([part] if share else []),
            ),
            "What {site} holds beyond an edge is lost"
            + (
                f"{', a part of it' if share else ''} to {target} (overflow)."
                if target
                else " (overflow)."
            ),
            terms=terms,
            stiff=True,
            source="Schoukens & Noel, Three benchmarks (2017), cascaded tanks",
        )


def sensor_drifts(model: Model) -> Iterator[Candidate]:
    """Yield a reading that drifts steadily with time."""
    for output in model.outputs:
        unit = model.units.get(output)
        yield Candidate(
            "drift",
            "memory",
            f"output:{output}",
            (ParameterSpec("kt", compose(unit, ["s"]) if unit else None),),
            "The reading of {site} drifts steadily with time.",
            readings=((output, f"{{old}} + {{kt}}*{model.time}"),),
            source="Ljung, System Identification (1999), section 14.1",
        )
