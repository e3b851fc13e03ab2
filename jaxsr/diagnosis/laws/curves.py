"""Curves: a force as a free function of one state, and the law that the evolution reads off it.

Estimated in free run, a curve needs neither an equation that the sensors show nor a weak view
that noise leaves clear; the law is then sought along the curve instead of along the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.criteria import independent_residuals
from jaxsr.diagnosis.laws.naming import named
from jaxsr.diagnosis.laws.unnamed import (
    MAX_TERMS,
    UNNAMED,
    Law,
    ProposedForce,
    as_candidate,
    choices,
    estimable,
    has_a_name,
    law_of,
    length_of,
    sizes_of,
)
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.evolution import SearchConfig, propose
from jaxsr.evolution.config import SizeLimits
from jaxsr.expressions import parse

BUMPS = 8
"""Gaussian bumps of which a curve consists."""
WIDTH = 1.2
"""Width of a bump over the distance of two."""
GRID = 80
"""Places along a curve at which the evolution sees it."""
SECONDS, SHARE = 5.0, 0.25
"""Longest search along a curve, and its share of the time left."""
LAWS = 2
"""Laws read off a curve that are estimated in free run."""
SEEN = 1e-10
"""Eigenvalue, relative to the largest, from which a direction of a curve is told by the data."""


@dataclass(frozen=True)
class Curve:
    r"""A force in `unit` along `state` as a curve over `variable`, moving from `low` to `high`.

    .. math:: f(x) = \sum_k c_k \exp(-((x - x_k)/h)^2), \qquad h = 1.2 (x_2 - x_1)
    """

    state: str
    variable: str
    low: float
    high: float
    unit: str | None = None

    @property
    def centres(self) -> np.ndarray:
        """Places x_k of the bumps, half the distance of two beyond either end."""
        beyond = 0.5 * (self.high - self.low) / (BUMPS - 2)
        return np.linspace(self.low - beyond, self.high + beyond, BUMPS)

    @property
    def width(self) -> float:
        """Width h of the bumps."""
        return WIDTH * (self.high - self.low) / (BUMPS - 2)

    def basis(self, x: np.ndarray) -> np.ndarray:
        """Return every bump at the places `x`, shape (places, bumps)."""
        return np.exp(-(((x[:, None] - self.centres) / self.width) ** 2))

    def proposed(self) -> ProposedForce:
        """Return the curve as a candidate that begins at no force."""
        pieces = [
            f"{{c{k}}}*exp(-(({self.variable} - ({centre:.6g}))/{self.width:.6g})**2)"
            for k, centre in enumerate(self.centres, 1)
        ]
        template = "+ " + " + ".join(pieces)
        candidate = Candidate(
            mechanism=UNNAMED,
            family=UNNAMED,
            site=f"equation:{self.state}",
            parameters=tuple(ParameterSpec(f"c{k}", self.unit) for k in range(1, BUMPS + 1)),
            sentence="A force that matches no named mechanism acts along {site}, as a curve over "
            f"{self.variable}.",
            terms=((self.state, template),),
            tried=choices(parse(template.replace("{", "").replace("}", ""))),
            source="radial basis functions estimated in free run",
        )
        return candidate, np.zeros(BUMPS)


def curves_at(case: Case, entry: Entry, state: str) -> list[Curve]:
    """Return a curve over the position of an equation, and one over its rate."""
    model, path = case.simulator.model, entry.fit.path
    unit = next((s.force_unit for s in sites_of(model, {}) if s.state == state), None)
    found = []
    for name in (model.kinematic_parent(state), state):
        if name is None or path is None:
            continue
        values = path[model.states.index(name)]
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        if np.isfinite(high - low) and high > low:
            found.append(Curve(state, name, low, high, unit))
    return found


def laws_along(
    case: Case,
    arena: Arena,
    curve: Curve,
    entry: Entry,
    rng: np.random.Generator,
) -> list[Law]:
    """Return laws of at most `MAX_TERMS` terms that follow a curve as closely as it is known.

    `entry` holds its estimate as the last of its members. The coefficients c are known with the
    precision P, all other parameters and the starts estimated along. A law g counts by
    (c - c_g)' P (c - c_g), c_g the coefficients of the curve through g: what no data tell, such
    as a line beside a free spring, costs nothing.
    """
    seconds = min(SECONDS, SHARE * case.search.remaining)
    if not seconds > 0.0 or entry.fit.path is None:
        return []
    index, size = (
        case.simulator.model.states.index(curve.state),
        sizes_of(case.simulator.model, case.prepared)[curve.variable],
    )
    own = arena.super_model.index(entry.members[-1])
    visits = entry.fit.path[case.simulator.model.states.index(curve.variable)]
    grid, onto = _sight(curve, visits, _root_of_precision(entry, own))
    found = propose(
        rng,
        onto @ curve.basis(grid) @ entry.fit.theta[own],
        {curve.variable: grid / size},
        view=lambda columns: onto @ columns,
        config=SearchConfig(population=120, sizes=SizeLimits(terms=MAX_TERMS)),
        budget=seconds,
    )
    n = independent_residuals(entry)
    fit = [p for p in found if estimable(p) and not has_a_name(p)]
    fit.sort(key=lambda p: p.loss * len(onto) + length_of(p, n))
    site = next(s for s in sites_of(case.simulator.model, {}) if s.state == curve.state)
    signals = {s: x.ravel() for s, x in zip(site.model.states, entry.fit.path, strict=False)}
    return [
        named(site, law_of(p, {curve.variable: size}), signals)
        or (as_candidate(case.simulator.model, case.prepared, index, p),)
        for p in fit[:LAWS]
    ]


def _sight(curve: Curve, visits: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places along a curve, and what makes residuals of unit variance of values there.

    What no sum of bumps can follow is weighed by how often the motion comes by, as much on
    average as what they can.
    """
    edges = np.linspace(curve.low, curve.high, GRID + 1)
    grid = 0.5 * (edges[1:] + edges[:-1])
    share = np.histogram(visits[np.isfinite(visits)], edges)[0].astype(float)
    share /= share.sum()
    basis = curve.basis(grid)
    fitted = np.linalg.pinv(basis, rcond=1e-8)
    weight = np.sum(root**2) / np.sum(share[:, None] * basis**2)
    beside = np.sqrt(weight * share)[:, None] * (np.eye(GRID) - basis @ fitted)
    return grid, np.concatenate([root @ fitted, beside])


def _root_of_precision(entry: Entry, own: list[int]) -> np.ndarray:
    """Return R with R'R the precision of some parameters, all others estimated along."""
    hessian = entry.fit.normal_equations()[0].sum(0)
    mine = np.isin(entry.fit.active, own)
    cross = hessian[np.ix_(mine, ~mine)]
    other = np.linalg.pinv(hessian[np.ix_(~mine, ~mine)], rcond=1e-12, hermitian=True)
    precision = hessian[np.ix_(mine, mine)] - cross @ other @ cross.T
    precision *= independent_residuals(entry) / entry.fit.cost
    values, vectors = np.linalg.eigh(precision)
    seen = values > SEEN * values[-1]
    return np.sqrt(values[seen])[:, None] * vectors[:, seen].T


__all__ = ["Curve", "curves_at", "laws_along"]
