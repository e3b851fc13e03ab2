"""Naming: the mechanisms of the library that a law which was written is, alone or as a sum.

A law is read in its normal form first, which shows the plain forces in it and where the constants
of others may be found; then named forces are fitted to its course over the recorded motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from jaxsr.diagnosis.laws.landmarks import Landmarks
from jaxsr.diagnosis.laws.matching import Sum, sums
from jaxsr.diagnosis.laws.unnamed import Law
from jaxsr.diagnosis.laws.vocabulary import OWN, NamedForce, Signals, vocabulary
from jaxsr.diagnosis.mechanisms.site import Site
from jaxsr.expressions import Term, evaluate
from jaxsr.expressions.description import estimated_length, estimates
from jaxsr.expressions.normal_form import normal_form, summands

SAME = 1e-6
"""Rms of a difference, relative to the force, below which two courses are one."""
ALIKE = 3e-3
"""The same below which they are one where nothing else tells: a search leaves constants inexact."""
SAMPLES = 400
"""Samples over which courses are compared."""

Loss = Callable[[np.ndarray], float]
"""What the log likelihood loses, in nats, where a force differs by f(t), shape (samples,)."""


def named(
    site: Site, law: Term, signals: Mapping[str, np.ndarray | float], loss: Loss | None = None
) -> Law:
    """Return the mechanisms whose sum a law at an equation of motion is, with their constants.

    Also those that the screening left out, but none that the recorded motion cannot tell: the site
    knows its scale. Nothing where no sum of named forces is the law, or only with a sign that is
    not physical.

    Parameters
    ----------
    site : Site
    law : Term
        Over the signals' own names, its constants as numbers.
    signals : mapping of str to ndarray or float
        States, time, inputs and parameters, arrays of one shape (samples,).
    loss : callable, optional
        Where a sum of named forces takes fewer bits than the law by more than the likelihood
        loses, it stands for the law. By default, and at any rate, where it takes fewer and differs
        by less than `ALIKE`.
    """
    with np.errstate(all="ignore"):
        force = np.asarray(evaluate(law, signals), dtype=float)
    shape = np.broadcast_shapes(force.shape, *(np.shape(x) for x in signals.values()))
    every = {n: np.broadcast_to(np.asarray(x, dtype=float), shape) for n, x in signals.items()}
    force = np.broadcast_to(force, shape)
    good = np.flatnonzero(np.isfinite(force))
    if not good.size > 0.5 * force.size:
        return ()
    few = good[:: -(-good.size // SAMPLES)]
    seen = {n: x[few] for n, x in every.items()}
    forces = vocabulary(site, seen, Landmarks.of(law))
    length = min(estimated_length(form, good.size) for form in (law, normal_form(law)))
    most = estimates(law)

    def stands(found: Sum) -> bool:
        left = float(np.linalg.norm(found.difference) / np.linalg.norm(force[few]))
        if left < SAME:
            return True
        saved = length - _length(found, len(forces), good.size)
        if saved < 0.0 or found.constants > most:  # what is but alike must not be the richer one
            return False
        if left < ALIKE or loss is None:
            return left < ALIKE
        apart = force - course(found, every)
        return loss(np.where(np.isfinite(apart), apart, 0.0)) < saved * np.log(2.0)

    found = _read_off(law, forces, seen) or _fitted(force[few], forces, seen, stands)
    if found is None:
        return ()
    return tuple((f.candidate, v) for f, v in zip(found.forces, found.values, strict=True))


def course(found: Sum, signals: Signals) -> np.ndarray:
    """Return a sum of named forces over signals, shape (samples,)."""
    total = np.zeros(next(iter(signals.values())).shape)
    for force, values in zip(found.forces, found.values, strict=True):
        own = {s.name: x for s, x in zip(force.candidate.parameters, values, strict=True)}
        columns = force.columns(tuple(own[s.name] for s in force.inner), signals)
        total += columns @ np.array([1.0, *(own[s.name] for s in force.linear)])
    return total


def _read_off(law: Term, forces: Sequence[NamedForce], signals: Signals) -> Sum | None:
    """Return the plain forces that the products of a law's normal form are, one after another."""
    known: dict[Term, tuple[NamedForce, float]] = {}
    for force in forces:
        if force.inner or len(force.linear) != 1:
            continue
        unit = {f"{force.linear[0].name}{OWN}": Term.constant(1.0)}
        parts = summands(force.term.substitute(unit))
        if len(parts) == 1:
            ((part, coefficient),) = parts.items()
            known.setdefault(part, (force, coefficient))
    parts = summands(law)
    if not parts or not parts.keys() <= known.keys():
        return None
    chosen = [known[part][0] for part in parts]
    values = [np.array([c / known[part][1]]) for part, c in parts.items()]
    if not all(f.allows(v, ()) for f, v in zip(chosen, values, strict=True)):
        return None
    return Sum(tuple(chosen), tuple(values), np.zeros(next(iter(signals.values())).shape))


def _fitted(
    force: np.ndarray,
    forces: Sequence[NamedForce],
    signals: Signals,
    stands: Callable[[Sum], bool],
) -> Sum | None:
    """Return the sum of named forces that stands for a course: an exact one, else the shortest."""
    size, best = float(np.linalg.norm(force)), None
    for found in sums(force, forces, signals):
        if not stands(found):
            continue
        if np.linalg.norm(found.difference) < SAME * size:
            return found
        if best is None or _price(found) < _price(best):
            best = found
    return best


def _price(found: Sum) -> tuple[int, int, float]:
    return found.constants, len(found.forces), float(np.linalg.norm(found.difference))


def _length(found: Sum, names: int, rows: int) -> float:
    """Bits of a sum of named forces: a name each, and their constants."""
    return len(found.forces) * np.log2(names) + found.constants * 0.5 * np.log2(rows)


__all__ = ["Loss", "course", "named"]
