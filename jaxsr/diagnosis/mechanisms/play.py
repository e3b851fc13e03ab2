"""Play in a spring that the model has: between its ends the spring does not pull."""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.site import Site, Threshold
from jaxsr.diagnosis.mechanisms.springs import force_of, reach_of, springs_of, unit_of
from jaxsr.expressions import to_text

SHARES = (0.05, 0.25)
"""Half of the play that estimation starts from, in units of the deflection's 95 % quantile."""


def play(site: Site) -> Iterator[Candidate]:
    r"""Yield play in the springs of an equation of motion.

    A spring -k u with the deflection u becomes

    .. math:: -k\,(\max(u - b, 0) + \min(u + b, 0)) = -k\,u + k \max(\min(u, b), -b),

    in every equation in which u pulls. A spring between two bodies is play at the last of their
    equations.
    """
    springs = springs_of(site.model)
    for deflection in dict.fromkeys(s.deflection for s in springs):
        mine = [s for s in springs if s.deflection == deflection]
        reach = reach_of(site, deflection)
        if mine[-1].state != site.state or not reach > 0.0:
            continue
        u = to_text(deflection)
        unit = unit_of(site.model, deflection)
        forces = [force_of(site.model, s) for s in mine]
        if None in forces:
            continue
        terms = tuple(
            (s.state, f"+ ({force})*Max(Min({u}, {{b}}), -{{b}})")
            for s, force in zip(mine, forces, strict=True)
        )
        for share in SHARES:
            yield Candidate(
                "backlash",
                "elastic",
                site.name,
                (Threshold("b", unit, low=0.0, high=2.0 * reach, seed=share * reach),),
                f"The spring on {u} in {{site}} has play before it engages.",
                terms=terms,
                borrowed=(("kb", str(forces[0]).removeprefix("-")),),
                source="Nordin & Gutman, Automatica 38 (2002)",
            )
