"""Shapes: laws without a name, where the search of one has nothing to look at."""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.diagnosis.candidates import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site

POWERS = (1,)


def shapes(site: Site) -> Iterator[Candidate]:
    """Yield corrections, by powers of the state, to the law of a level or a flow.

    The evolution writes laws from what the sensors leave of an equation. Where a state hides,
    they leave nothing to be seen, and the first terms of a series stand for a law of another
    shape, such as an outflow that does not follow the square root of the level.
    """
    if site.position is not None:
        return
    s = site.state
    for power in POWERS:
        name = f"c{power}"
        yield Candidate(
            "unnamed",
            "unnamed",
            site.name,
            (ParameterSpec(name, site.per(*[s] * power)),),
            "The law of {site} has another shape than modelled; a power of the state corrects it.",
            terms=((s, f"+ {{{name}}}*{s}**{power}" if power > 1 else f"+ {{{name}}}*{s}"),),
            tried=len(POWERS),
            source="Taylor expansion about the modelled law",
        )
