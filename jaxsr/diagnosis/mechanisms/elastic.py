"""Elastic mechanisms: forces that depend on position."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site

_SOURCE = "Kerschen, Worden, Vakakis & Golinval, Mech. Syst. Signal Process. 20 (2006)"

SHARP = 3.0
"""Deceleration at a stop over the rms acceleration."""
RARE = 0.05
"""Share of the path, from its end, in which a spring engages that is hardly reached."""


def _rests(site: Site) -> bool:
    """Whether zero position, about which a cubic spring is odd, lies inside the recorded path."""
    values = site.scale.get(site.position or "")
    return values is None or bool(values[0] < 0.0 < values[-1])


def elastic(site: Site) -> Iterator[Candidate]:
    """Yield springs at an equation of motion."""
    q, v = site.position, site.state
    if q is None:
        yield from _paths_of_level(site)
        return
    if not site.reverses:
        return

    def make(name: str, term: str, *specs: ParameterSpec, sentence: str) -> Candidate:
        return Candidate(
            name, "elastic", site.name, specs, sentence, terms=((v, term),), source=_SOURCE
        )

    yield make(
        "linear_stiffness",
        f"- {{k1}}*{q}",
        ParameterSpec("k1", site.per(q)),
        sentence="A linear spring pulls {site} towards zero position.",
    )
    yield make(
        "quadratic_stiffness",
        f"- {{k2}}*{q}**2",
        ParameterSpec("k2", site.per(q, q)),
        sentence="The spring along {site} is softer on one side than on the other.",
    )
    if _rests(site):
        yield make(
            "cubic_stiffness",
            f"- {{k3}}*{q}**3",
            ParameterSpec("k3", site.per(q, q, q)),
            sentence="The spring along {site} hardens or softens with the cube of displacement.",
        )
    values = site.scale.get(q)
    if values is None:
        return
    unit = site.model.units.get(q)
    low, high = float(values[0]), float(values[-1])
    spread = high - low

    def place(name: str, value: float) -> ParameterSpec:
        return ParameterSpec(name, unit, low - 0.1 * spread, high + 0.1 * spread, value, False)

    # The last place is one that is hardly reached, as a soft stop in one recording.
    for term, levels, last, side in (
        (f"- {{ks}}*Max({q} - {{qs}}, 0)", (12, 15, 18), high - RARE * spread, "beyond"),
        (f"- {{ks}}*Min({q} - {{qs}}, 0)", (8, 5, 2), low + RARE * spread, "below"),
    ):
        for at in (*(float(values[level]) for level in levels), last):
            yield make(
                "piecewise_stiffness",
                term,
                ParameterSpec("ks", site.per(q)),
                place("qs", at),
                sentence=f"A second spring engages along {{site}} {side} a certain position.",
            )
    yield from _end_stops(site, q, make, place)
    if low < 0.0 < high:
        for share in (0.1, 0.3, 0.6):
            yield make(
                "backlash",
                f"- {{kb}}*(Max({q} - {{b}}, 0) + Min({q} + {{b}}, 0))",
                ParameterSpec("kb", site.per(q), low=0.0),
                ParameterSpec("b", unit, 0.0, max(high, -low), share * min(high, -low), False),
                sentence="The spring along {site} has play before it engages.",
            )


def _paths_of_level(site: Site) -> Iterator[Candidate]:
    """Yield a flow in proportion to how far a level is below a place, in models of levels.

    Above a place the same is an overflow. Where a level hides, the two imitate each other.
    """
    x, values = site.state, site.scale.get(site.state)
    levels = all(site.model.kinematic_parent(s) is None for s in site.model.dynamic_states)
    if not levels or values is None or not values[-1] > values[0] or site.motion is None:
        return
    unit, spread = site.model.units.get(x), float(values[-1] - values[0])
    low, high = float(values[0]) - 0.1 * spread, float(values[-1]) + 0.1 * spread
    for at in (8, 5, 2):
        yield Candidate(
            "piecewise_stiffness",
            "elastic",
            site.name,
            (
                ParameterSpec("ks", site.per(x)),
                ParameterSpec("qs", unit, low, high, float(values[at]), False),
            ),
            "{site} flows otherwise below a certain level.",
            terms=((x, f"- {{ks}}*Min({x} - {{qs}}, 0)"),),
            source=_SOURCE,
        )


def _end_stops(
    site: Site,
    q: str,
    make: Callable[..., Candidate],
    place: Callable[[str, float], ParameterSpec],
) -> Iterator[Candidate]:
    """Yield stiff stops at the ends of the recorded path at which the motion turns sharply."""
    v, values = site.state, site.scale[q]
    spread = float(values[-1] - values[0])
    for side, end, ramp in ((1.0, float(values[-1]), "Max"), (-1.0, float(values[0]), "Min")):
        if not turned_back(site, side):
            continue
        for share in (0.01, 0.03, 0.1):
            at = place("qs", end - side * share * spread)
            gap = f"{ramp}({q} - {{qs}}, 0)"
            ks = ParameterSpec("ks", site.per(q), low=0.0)
            sentence = "The motion along {site} runs against a stop."
            yield make("end_stop", f"- {{ks}}*{gap}", ks, at, sentence=sentence)
            # A stop that also takes energy out (Hunt & Crossley, J. Appl. Mech. 42 (1975)).
            cs = ParameterSpec("cs", site.per(q, v), low=0.0)
            sign = "+" if ramp == "Max" else "-"  # cs*v opposes the motion at either stop
            loss = f"- ({{ks}} {sign} {{cs}}*{v})*{gap}"
            yield make("end_stop", loss, ks, cs, at, sentence=sentence)


def turned_back(site: Site, side: float) -> bool:
    """Whether the motion turns at one end of the path, always at the same place, and sharply.

    Any steady oscillation turns at the same place; a stop also slows it down harder than
    is usual: `SHARP` times the rms acceleration (a sine reaches 1.4).
    """
    path, speed, time = (site.signal(s) for s in (site.position, site.state, "t"))
    if path is None or speed is None or time is None:
        return site.motion is None
    end = side * np.max(side * path)
    near = np.abs(path - end) < 0.03 * np.ptp(path)
    visits = int(np.count_nonzero(np.diff(near.astype(int)) == 1))
    rate = np.gradient(speed) / np.maximum(np.abs(np.gradient(time)), 1e-12)
    typical = float(np.sqrt(np.mean(rate**2)))
    return visits >= 2 and float(np.quantile(-side * rate[near], 0.9)) > SHARP * typical
