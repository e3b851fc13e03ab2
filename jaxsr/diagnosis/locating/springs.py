"""Springs that engage at a place, located in free run: where one would lower the cost most."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.criteria import independent_residuals
from jaxsr.diagnosis.locating.responses import Responses, surely
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site
from jaxsr.expressions import evaluate, parse

PLACED = frozenset({"piecewise_stiffness", "backlash"})
"""Mechanisms whose force is linear in a stiffness beside one place."""
SHARES = np.linspace(0.02, 0.98, 25)
"""Quantiles of the position that are looked at."""
BETTER = 1.2
"""Gain, relative to that from the places that are tried already, from which another is added."""


def spring_candidates(
    arena: Arena, entry: Entry, responses: Responses, stop: Callable[[], bool] = lambda: False
) -> list[Candidate]:
    """Propose second springs and play from where one linearisation says that they engage.

    From a place that is hardly reached the law may look useless, whatever it does elsewhere.
    """
    choices = SHARES.size * len(responses.sites)
    least = surely(entry.fit.cost, independent_residuals(entry), choices)
    found = []
    for j, site in enumerate(responses.sites):
        for laws in _laws(arena, site):
            if stop():
                return found
            places = _grid(responses, site, _parts(laws[0])[1])
            tried = np.array([_parts(law)[1].neutral for law in laws])
            gains = _gains(responses, j, laws[0], np.concatenate([places, tried]))
            new, old = gains[: places.size], gains[places.size :]
            best = int(np.argmax(new)) if new.size else 0
            if new.size and new[best] > max(least, BETTER * old.max()):
                found.append(_moved(laws[0], float(places[best])))
    return found


def _laws(arena: Arena, site: Site) -> Iterable[list[Candidate]]:
    """Return the starts of every law with a place that acts along one equation."""
    forms: dict[tuple, list[Candidate]] = {}
    for candidate in arena.super_model.candidates:
        own = candidate.site == site.name and [s for s, _ in candidate.terms] == [site.state]
        linear = candidate.mechanism in PLACED and len(candidate.parameters) == 2
        if own and linear and site.position is not None:
            forms.setdefault(candidate.terms, []).append(candidate)
    return forms.values()


def _parts(law: Candidate) -> tuple[ParameterSpec, ParameterSpec]:
    """Return a law's stiffness and its place."""
    stiffness, place = sorted(law.parameters, key=lambda p: not p.coefficient)
    return stiffness, place


def _moved(law: Candidate, place: float) -> Candidate:
    """Return a law that starts from another place."""
    parameters = (p if p.coefficient else replace(p, neutral=place) for p in law.parameters)
    return replace(law, parameters=tuple(parameters))


def _grid(responses: Responses, site: Site, place: ParameterSpec) -> np.ndarray:
    """Return places along the path, those alone that the law admits."""
    places = np.quantile(responses.course(site.position or site.state), SHARES)
    return places[(places > place.low) & (places < place.high)]


def _gains(responses: Responses, site: int, law: Candidate, places: np.ndarray) -> np.ndarray:
    """Return how much the cost falls with a law at each of several places."""
    ((_, text),), (stiffness, place) = law.terms, _parts(law)
    term = parse(text.format(**{stiffness.name: "1", place.name: "place"}))
    names = list(responses.sites[site].model.states)

    def shapes(s: int) -> np.ndarray:
        path = responses.path[: len(names), : int(responses.segments.count[s]), s]
        middle = 0.5 * (path[:, 1:] + path[:, :-1])[..., None]
        return np.asarray(
            evaluate(term, {**dict(zip(names, middle, strict=True)), "place": places})
        )

    gains, values = responses.gains(site, shapes, 1)
    inside = (values[:, 0] > stiffness.low) & (values[:, 0] < stiffness.high)
    return np.where(inside, gains, 0.0)
