"""Elastic mechanisms: forces that depend on position."""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.diagnosis.candidates import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site

_SOURCE = "Kerschen, Worden, Vakakis & Golinval, Mech. Syst. Signal Process. 20 (2006)"


def _returns(site: Site) -> bool:
    """Whether the motion goes both ways for at least a twentieth of the time.

    In a motion that never returns, position and velocity tell the same story, and a spring
    cannot be told from a resistance.
    """
    speeds = site.scale.get(site.state)
    return speeds is None or bool(speeds[1] < 0.0 < speeds[-2])


def elastic(site: Site) -> Iterator[Candidate]:
    """Yield springs at an equation of motion."""
    q, v = site.position, site.state
    if q is None or not _returns(site):
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
    yield make(
        "cubic_stiffness",
        f"- {{k3}}*{q}**3",
        ParameterSpec("k3", site.per(q, q, q)),
        sentence="The spring along {site} hardens or softens with the cube of displacement.",
    )
    values = site.scale.get(q)
    if values is None:
        return
    for level in (12, 15, 18):
        edge = float(values[level])
        unit = site.model.units.get(q)
        spread = float(values[-1] - values[0])
        yield make(
            "piecewise_stiffness",
            f"- {{ks}}*Max({q} - {{qs}}, 0)",
            ParameterSpec("ks", site.per(q)),
            ParameterSpec(
                "qs",
                unit,
                low=float(values[0]),
                high=float(values[-1]) + 0.1 * spread,
                neutral=edge,
                coefficient=False,
            ),
            sentence="A second spring engages along {site} beyond a certain position.",
        )
