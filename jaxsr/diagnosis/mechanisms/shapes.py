"""Shapes: laws without a name, where the search of one has nothing to look at."""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site


def shapes(site: Site) -> Iterator[Candidate]:
    """Yield a correction, in proportion to the state, to the law of a level or a flow.

    The evolution writes laws from what the sensors leave of an equation. Where a state hides,
    they leave nothing to be seen, and the first term of a series stands for a law of another
    shape, such as an outflow that does not follow the square root of the level.
    """
    if site.position is not None:
        return
    yield Candidate(
        "unnamed",
        "unnamed",
        site.name,
        (ParameterSpec("c1", site.per(site.state)),),
        "The law of {site} has another shape than modelled; a linear term corrects it.",
        terms=((site.state, f"+ {{c1}}*{site.state}"),),
        source="Taylor expansion about the modelled law",
    )
