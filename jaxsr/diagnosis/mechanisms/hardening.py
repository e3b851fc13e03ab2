"""Springs of the model that harden, or pull harder one way: along what stretches them."""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site
from jaxsr.diagnosis.mechanisms.springs import Spring, force_of, reach_of, springs_of, unit_of
from jaxsr.expressions import parse, to_text
from jaxsr.expressions.normal_form import normal_form
from jaxsr.expressions.term import Term
from jaxsr.models.force_units import compose

_SOURCE = "Kerschen, Worden, Vakakis & Golinval, Mech. Syst. Signal Process. 20 (2006)"


def hardening(site: Site) -> Iterator[Candidate]:
    r"""Yield springs of higher order beside those that the model has.

    A spring -k u becomes

    .. math:: -k\,u - k_2\,u^2 \quad\text{or}\quad -k\,u - k_3\,u^3

    with its deflection u, in every equation in which it pulls and by the levers that it has there.
    One on a position alone is an elastic force about zero (`elastic`). A spring between two bodies
    is named at the last of their equations.
    """
    springs = springs_of(site.model)
    for deflection in dict.fromkeys(s.deflection for s in springs):
        mine = [s for s in springs if s.deflection == deflection]
        if deflection.is_variable or mine[-1].state != site.state:
            continue
        forces = [force_of(site.model, s) for s in mine]
        if None in forces or not site.reverses:
            continue
        levers = [_lever(str(force), str(forces[-1])) for force in forces]
        yield from _of_order(site, deflection, mine, levers)


def _of_order(
    site: Site, deflection: Term, springs: list[Spring], levers: list[str]
) -> Iterator[Candidate]:
    u, unit = f"({to_text(deflection)})", unit_of(site.model, deflection)
    told = f"The spring on {to_text(deflection)} in {{site}}"
    sentences = {
        "quadratic_stiffness": f"{told} is softer on one side than on the other.",
        "cubic_stiffness": f"{told} hardens or softens with the cube of what stretches it.",
    }
    for order, (name, sentence) in enumerate(sentences.items(), 2):
        if order == 3 and not reach_of(site, deflection) > 0.0:
            continue  # about no place that it passes
        force, own = site.force_unit, None
        if force is not None and unit is not None:
            own = compose(force, [unit] * order)
        yield Candidate(
            name,
            "elastic",
            site.name,
            (ParameterSpec(f"k{order}", own),),
            sentence,
            terms=tuple(
                (s.state, f"{lever}{{k{order}}}*{u}**{order}")
                for s, lever in zip(springs, levers, strict=True)
            ),
            source=_SOURCE,
        )


def _lever(force: str, named: str) -> str:
    """Return the sign of a spring's pull, and its lever in that where the spring is named."""
    named = named.removeprefix("-")
    lever = normal_form(parse(f"-({force})/({named})"))
    if lever.is_constant and abs(lever.value) == 1.0:
        return "- " if lever.value < 0.0 else "+ "
    return f"+ ({to_text(lever)})*"
