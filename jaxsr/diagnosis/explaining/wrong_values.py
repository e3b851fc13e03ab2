"""Which values are wrong: the fewest that explain what re-calibration does."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.judging.criteria import independent_residuals
from jaxsr.diagnosis.judging.refine import Estimate, named_super_model
from jaxsr.diagnosis.likelihood.posterior import ODDS
from jaxsr.diagnosis.mechanisms.measurement import wrong_values
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena, neutral_values, parameter_bounds
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.models.shooting import linearise_fit


@dataclass(frozen=True, eq=False)
class Wrong:
    """Some values are wrong and all others as given.

    Attributes
    ----------
    names : tuple of str
        Of the parameters, free or fixed in the model file.
    entry : Entry
        Estimated with these alone.
    arena : Arena
        In which nothing else is free.
    log : float
        Evidence, up to a constant that all have in common.
    """

    names: tuple[str, ...]
    entry: Entry
    arena: Arena
    log: float


def frozen(arena: Arena, names: Collection[str] | None = None) -> Arena:
    """An arena in which some parameters are not estimated; by default nothing but the starts is."""
    given = replace(
        arena.super_model.given,
        parameters={
            n: replace(p, bounds=None) if names is None or n in names else p
            for n, p in arena.super_model.given.parameters.items()
        },
    )
    return replace(arena, super_model=replace(arena.super_model, given=given))


def fewest(
    arena: Arena,
    null: Entry,
    moved: Sequence[str],
    stop: Callable[[], bool] = lambda: False,
) -> list[Wrong]:
    r"""Return sets of wrong values by falling evidence, `moved` among them.

    A set S of n values among N is as probable as

    .. math:: -\tfrac{r}{2} \log q_S - n \left( \tfrac12 \log r + \log N + \lambda \right),

    q the squared error of r independent residuals with all other values as given (Schwarz,
    Ann. Statist. 6 (1978)), and \lambda the prior log odds against one wrong value. Single values
    first; others are added to the best set as long as that gains. A factor that values have in
    common, such as that of all forces and of a mass that the file fixes, is so told by the least
    number of values. Empty where time is over before, and where all free values together are more
    probable than any such set.

    Parameters
    ----------
    null : Entry
        Re-calibration, from whose path estimates begin.
    moved : sequence of str
        Values that re-calibration asks for.
    stop : callable
        Whether time is over.
    """
    arena = _with_fixed(arena)
    fixed = _fixed(arena.super_model)
    every = [*arena.super_model.given.free_parameters, *fixed]
    rows = independent_residuals(null)
    price = 0.5 * np.log(max(rows, 2.0)) + np.log(len(every)) + ODDS
    given, known = neutral_values(arena.super_model), dict[frozenset[str], Wrong]()

    def asked(names: Sequence[str]) -> Wrong | None:
        if stop():
            return None
        key = frozenset(names)
        if key not in known:
            rest = set(arena.super_model.given.free_parameters) - key
            own = frozen(arena, rest)
            members = tuple(sorted(fixed[n] for n in names if n in fixed))
            entry = enter(own, members, given, null.fit.path, stop, near=True)
            log = -0.5 * rows * np.log(entry.fit.cost + 1e-300) - len(key) * price
            known[key] = Wrong(tuple(n for n in every if n in key), entry, own, float(log))
        return known[key]

    asked(moved)
    best: tuple[str, ...] = ()
    while len(best) < max(len(moved) - 1, 1):
        grown = [asked((*best, n)) for n in every if n not in best]
        found = [w for w in grown if w is not None]
        if len(found) < len(grown):
            return []
        leader = max(found, key=lambda w: w.log)
        if best and leader.log <= known[frozenset(best)].log:
            break
        best = leader.names
    found = sorted(known.values(), key=lambda w: -w.log)
    free = len(arena.super_model.given.free_parameters)
    everything = -0.5 * rows * np.log(null.fit.cost + 1e-300) - free * price
    return found if found[0].log >= everything else []


def shares(found: Sequence[Wrong]) -> np.ndarray:
    """Return the probabilities of sets of values."""
    log = np.array([w.log for w in found])
    share = np.exp(log - log.max())
    return share / share.sum()


def without(found: Wrong, name: str, null: Entry) -> float:
    """Return the squared error with one of the values as given, the others of the set estimated."""
    model = found.arena.super_model
    arena = frozen(found.arena, (name,))
    members = tuple(i for i in found.entry.members if model.candidates[i].fixed_parameter != name)
    return enter(arena, members, neutral_values(model), null.fit.path, near=True).fit.cost


def completed(found: Wrong, estimate: Estimate, arena: Arena) -> Estimate:
    """Return the estimate of a set as one of all parameters, the others as given."""
    candidates = [found.arena.super_model.candidates[i] for i in found.entry.members]
    named = named_super_model(arena.super_model.given, candidates)
    return replace(estimate, named=named)


def angle(first: Wrong, second: Wrong) -> float:
    """Return the smallest angle in degrees between the effects of two sets in the sensors.

    That of subspaces, starts projected out (Bjorck & Golub, Math. Comp. 27 (1973)).
    """
    order = list(first.arena.super_model.model.parameters)
    index = [order.index(n) for n in (*first.names, *second.names)]
    active = np.array(list(dict.fromkeys(index)))
    told = linearise_fit(first.arena.problem, first.entry.fit, active)
    total = told.normal_equations()[0].sum(0)
    if not np.isfinite(total).all():  # beside such values nothing is alike
        return 90.0
    at = [list(active).index(i) for i in index]
    one, other = at[: len(first.names)], at[len(first.names) :]

    def whitened(of: list[int]) -> np.ndarray:
        values, vectors = np.linalg.eigh(total[np.ix_(of, of)])
        seen = values > 1e-12 * values.max(initial=0.0)
        return vectors[:, seen] / np.sqrt(values[seen])

    cosines = whitened(one).T @ total[np.ix_(one, other)] @ whitened(other)
    largest = float(np.linalg.norm(cosines, 2)) if cosines.size else 0.0
    return float(np.degrees(np.arccos(min(largest, 1.0))))


def _with_fixed(arena: Arena) -> Arena:
    """Return the arena with all fixed values among its candidates."""
    old = arena.super_model
    known = {c.label for c in old.candidates}
    missing = [c for c in wrong_values(old.given) if c.label not in known]
    if not missing:
        return arena
    super_model = SuperModel.build(old.given, [*old.candidates, *missing])
    return replace(arena, super_model=super_model, bounds=parameter_bounds(super_model))


def _fixed(super_model: SuperModel) -> dict[str, int]:
    """Fixed parameters that may be wrong, and their candidates."""
    every = enumerate(super_model.candidates)
    return {c.fixed_parameter: i for i, c in every if c.fixed_parameter is not None}
