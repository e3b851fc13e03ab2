"""Coupling mechanisms: springs and dampers between two axes, action equal to reaction."""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site

_SOURCE = "Ewins, Modal Testing: Theory, Practice and Application (2000)"


def coupling(site: Site) -> Iterator[Candidate]:
    """Yield springs and dampers to the axes that come later in the model."""
    q, v, model = site.position, site.state, site.model
    for other in site.others:
        if q is None or other.position is None:
            continue
        if model.states.index(other.state) < model.states.index(v):
            continue
        qj, vj = other.position, other.state
        if model.units.get(q) != model.units.get(qj):
            continue
        yield Candidate(
            "coupling_stiffness",
            "coupling",
            site.name,
            (ParameterSpec("kc", site.per(q)),),
            f"A spring connects {{site}} with equation:{vj}.",
            terms=((v, f"- {{kc}}*({q} - {qj})"), (vj, f"+ {{kc}}*({q} - {qj})")),
            source=_SOURCE,
        )
        yield Candidate(
            "coupling_damping",
            "coupling",
            site.name,
            (ParameterSpec("cc", site.per(v), low=0.0),),
            f"A damper connects {{site}} with equation:{vj}.",
            terms=((v, f"- {{cc}}*({v} - {vj})"), (vj, f"+ {{cc}}*({v} - {vj})")),
            source=_SOURCE,
        )
