"""Inertial mechanisms: masses, weights, and products of velocities."""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site

_RIGID = "Featherstone, Rigid Body Dynamics Algorithms (2008)"


def inertial(site: Site) -> Iterator[Candidate]:
    """Yield added mass, gravity, a constant force and centrifugal coupling."""
    q, v, f = site.position, site.state, site.force_unit
    mass = _added(site)
    if mass is not None:
        unit = site.per(v)
        yield Candidate(
            "added_mass",
            "inertial",
            site.name,
            (ParameterSpec("ma", f"{unit}*s" if unit else None),),
            "The moving mass along {site} is larger than modelled.",
            inertia=((v, v, mass),),
            source="Newman, Marine Hydrodynamics (1977); Brennen, A Review of Added Mass and Fluid "
            "Inertial Forces (1982), for bodies in a fluid",
        )
    yield Candidate(
        "constant_force",
        "inertial",
        site.name,
        (ParameterSpec("F0", f),),
        "A constant force or offset acts along {site}.",
        terms=((v, "+ {F0}"),),
        source="Janot, Gautier & Brunot, Data Set and Reference Models of EMPS (2019), the offset",
    )
    if site.may_turn:
        yield Candidate(
            "gravity",
            "inertial",
            site.name,
            (ParameterSpec("mg", f),),
            "A weight hangs on {site}.",
            terms=((v, f"- {{mg}}*sin({q})"),),
            source=_RIGID,
        )
    for other in site.others:
        if other.position is None or q is None:
            continue
        yield Candidate(
            "centrifugal_coupling",
            "inertial",
            site.name,
            (ParameterSpec("h", site.per(other.state, other.state)),),
            "A product of velocities couples {site} to another axis.",
            terms=((v, f"+ {{h}}*{other.state}**2"),),
            source=_RIGID,
        )


def _added(site: Site) -> str | None:
    """Return what an added mass adds to the inertia of a site; None where nothing tells its mass.

    Of v' = F/m that is ma/m, beside the 1 of a rate: v' (1 + ma/m) = F/m is v' = F/(m + ma).
    """
    model, v = site.model, site.state
    if v in model.inertia:
        return "{ma}" if v in model.inertia[v] else None
    rows = dict(model.entries(v)) if model.vector_field is None and site.position else {}
    if rows.keys() != {v} or not rows[v].startswith("1.0/"):  # a gain is no inverse of a mass
        return None
    over = rows[v].removeprefix("1.0/")
    return f"{{ma}}/{over}" if over.isidentifier() else f"{{ma}}*({rows[v]})"
