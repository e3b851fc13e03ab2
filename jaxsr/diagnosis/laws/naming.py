"""Naming: the mechanism of the library whose force has the course of a law that was written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from jaxsr.diagnosis.laws.unnamed import ProposedForce
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.site import Site
from jaxsr.expressions import evaluate, parse

SAME = 1e-9
"""Squared sine of the angle between two courses below which they are one."""


def named(
    site: Site, force: np.ndarray, variables: Mapping[str, np.ndarray]
) -> ProposedForce | None:
    """Return the mechanism with one coefficient whose force is f(t) at an equation of motion.

    Also one that the screening left out, but none that the recorded motion cannot tell: the site
    knows its scale. None where nothing has this course, or only with a sign that is not physical.

    Parameters
    ----------
    site : Site
    force : ndarray, shape (samples,)
        f.
    variables : mapping of str to ndarray, shape (samples,)
        States at the same moments.
    """
    for candidate in _along(site, variables):
        (spec,), ((_, text),) = candidate.parameters, candidate.terms
        unit = evaluate(parse(text.format(**{spec.name: spec.name})), {**variables, spec.name: 1.0})
        course = np.broadcast_to(np.asarray(unit, dtype=float), force.shape)
        size, along = float(course @ course), float(course @ force)
        if along**2 < (1.0 - SAME) * size * float(force @ force) or not size > 0.0:
            continue
        if spec.low <= along / size <= spec.high:
            return candidate, np.array([along / size])
    return None


def _along(site: Site, variables: Mapping[str, np.ndarray]) -> Iterator[Candidate]:
    """Yield the plain forces of the library along one equation: one coefficient times states."""
    for candidate in force_candidates(site.model, site.scale):
        plain = [s.coefficient for s in candidate.parameters] == [True]
        if candidate.site != site.name or not plain or candidate.fixed_parameter is not None:
            continue
        if candidate.states or candidate.replaced or candidate.inertia:
            continue
        if [s for s, _ in candidate.terms] != [site.state]:
            continue
        ((_, text),) = candidate.terms
        own = {s.name: s.name for s in candidate.parameters}
        if parse(text.format(**own)).variables <= {*variables, *own}:
            yield candidate


__all__ = ["named"]
