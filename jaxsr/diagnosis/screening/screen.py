"""Screening: sets of mechanisms chosen together with the parameters, in the weak view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from jaxsr.diagnosis.mechanisms.site import Threshold
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.screening.weak_system import WeakSystem

BLOCKS = 12
BEAM = 10
WEIGHINGS = 2
MAX_SET = 4
TOGETHER = 200  # sets solved at once: few enough for the cache
ENGAGED = (0.25, 4.0)  # share of a threshold's seeded effect that the data may ask for
COLLINEAR, BLIND = 0.02, 0.002
"""Share of a column that the free parameters leave, below which the weak view does not try it, and
below which free runs, which noise troubles less, do not either."""
TRIVIAL = 1e-8
"""Share of the residual's power, left by a constant that lets all forces and inertias vanish."""
SHRUNK = 0.01
"""Share of the given values, below which all free parameters of a set count as vanished."""
STEEPEST = 3.0
"""Largest ratio of breakaway to Coulomb friction."""
CONTAINED = (
    frozenset(
        {
            *("coulomb_friction", "stribeck_friction", "position_dependent_friction"),
            "load_dependent_friction",
        }
    ),
    frozenset({"coupling_damping", "coupled_friction"}),
    frozenset({"quadratic_drag", "power_law_drag"}),
    frozenset({"piecewise_stiffness", "end_stop"}),
)
"""Mechanisms of which one contains another, or that are one and the same at another strength."""


@dataclass(frozen=True)
class ScreenedSet:
    """A set of candidates with its held-back error in the weak view.

    Attributes
    ----------
    members : tuple of int
        Positions in the super-model's candidates, sorted.
    errors : ndarray, shape (blocks,)
        Mean squared weighted residual of each block, estimated without that block.
    values : ndarray, shape (parameters,)
        Estimate from all blocks.
    """

    members: tuple[int, ...]
    errors: np.ndarray
    values: np.ndarray

    @property
    def error(self) -> float:
        """Mean held-back error."""
        return float(np.mean(self.errors))


@dataclass(frozen=True)
class Screening:
    """Result of the screening: sets by error, and candidates that no data can tell apart."""

    sets: tuple[ScreenedSet, ...]
    blind: tuple[int, ...]

    @property
    def empty(self) -> ScreenedSet:
        """The set of no candidates: re-calibration alone."""
        return next(s for s in self.sets if not s.members)


def assign_blocks(system: WeakSystem, count: int = BLOCKS) -> np.ndarray:
    """Number consecutive blocks of equal duration over all recordings."""
    offset, spans = 0.0, np.empty_like(system.centre)
    for r in np.unique(system.recording):
        rows = system.recording == r
        spans[rows] = offset + system.centre[rows] - system.centre[rows].min()
        offset = spans[rows].max() + 1e-9
    return np.minimum((spans / max(offset, 1e-300) * count).astype(int), count - 1)


def screen(
    system: WeakSystem, super_model: SuperModel, stop: Callable[[], bool] = lambda: False
) -> Screening:
    """Search sets of candidates by beam search on held-back error.

    Every set is estimated jointly with the model's free parameters (never on frozen ones: the
    calibration has already absorbed a part of what is missing). Rows are weighted by the
    residual each equation keeps under the best set. Once time is over (`stop`), the sets are as
    large, and the weights as good, as they are then.
    """
    scale = np.ones(len(super_model.model.states))
    search = _Search(system, super_model, scale)
    sets = sorted(search.run(stop), key=lambda s: s.error)
    for _ in range(WEIGHINGS):
        if stop():
            break
        residual = system.at(sets[0].values)
        for state in np.unique(system.state):
            rows = system.state == state
            scale[state] = np.sqrt(np.mean(residual[rows] ** 2)) + 1e-300
        search = _Search(system, super_model, scale)
        sets = sorted(search.run(stop), key=lambda s: s.error)
    return Screening(tuple(sets), search.below(BLIND))


def redundant(super_model: SuperModel, members: Sequence[int]) -> bool:
    """Whether two members are variants of one mechanism, or one contains the other."""
    chosen = [super_model.candidates[i] for i in members]
    if len({c.label for c in chosen}) < len(chosen):
        return True
    for first, second in combinations(chosen, 2):
        pair = {first.mechanism, second.mechanism}
        if first.site == second.site and any(pair <= group for group in CONTAINED):
            return True
    return False


class _Search:
    """Normal equations per block, solved for many sets."""

    def __init__(self, system: WeakSystem, super_model: SuperModel, scale: np.ndarray) -> None:
        self.system, self.super_model = system, super_model
        weight = 1.0 / scale[system.state]
        a = -system.jacobian * weight[:, None]
        b = system.residual * weight
        self.column = np.sqrt((a**2).mean(0)) + 1e-300
        a = a / self.column
        blocks = assign_blocks(system)
        count = blocks.max() + 1
        self.gram = np.stack([a[blocks == k].T @ a[blocks == k] for k in range(count)])
        self.moment = np.stack([a[blocks == k].T @ b[blocks == k] for k in range(count)])
        self.power = np.array([b[blocks == k] @ b[blocks == k] for k in range(count)])
        self.rows = np.array([(blocks == k).sum() for k in range(count)])
        keep = self.rows > 0
        self.gram, self.moment = self.gram[keep], self.moment[keep]
        self.power, self.rows = self.power[keep], self.rows[keep]
        self.total, self.pull = self.gram.sum(0), self.moment.sum(0)
        self.base = super_model.base_index()
        self.index = [
            super_model.index(i, coefficients_only=True) for i in range(len(super_model.candidates))
        ]
        order = list(super_model.model.parameters.values())
        self.low = np.array([p.bounds[0] if p.bounds else -np.inf for p in order])
        self.high = np.array([p.bounds[1] if p.bounds else np.inf for p in order])
        for i, candidate in enumerate(super_model.candidates):
            if candidate.fixed_parameter is not None:
                spec, at = candidate.parameters[0], self.index[i][0]
                self.low[at], self.high[at] = spec.low, spec.high
        self.seed = _seeds(super_model)
        self.open = False
        every = range(len(self.index))
        self.left = [0.0 if self._scales_all(i) else self._left_over(i) for i in every]

    def below(self, share: float) -> tuple[int, ...]:
        """Return candidates of which the free parameters leave less than a share."""
        return tuple(i for i, left in enumerate(self.left) if left < share)

    def _left_over(self, candidate: int) -> float:
        """Share of a candidate's columns that the free parameters cannot reproduce."""
        total, own, base = self.total, self.index[candidate], self.base
        norms = np.diag(total)[own]
        if not norms.max() > 1e-12:
            return 0.0
        if not base:
            return 1.0
        cross = total[np.ix_(base, own)]
        solved = np.linalg.lstsq(total[np.ix_(base, base)], cross, rcond=1e-12)[0]
        left = norms - np.einsum("ij,ij->j", cross, solved)
        there = norms > 0.0
        return float(np.sqrt(max(np.max(left[there] / norms[there]), 0.0)))

    def _scales_all(self, candidate: int) -> bool:
        """Whether a parameter, set free, lets every force and inertia shrink to nothing.

        A drive gain before the only input does: gain and inertias are known up to a common
        factor only, and the trivial solution would win every comparison.
        """
        if self.super_model.candidates[candidate].mechanism not in ("wrong_value", "input_gain"):
            return False
        active = [*self.base, *self.index[candidate]]
        total, right = self.total, self.pull
        solved = np.linalg.lstsq(total[np.ix_(active, active)], right[active], rcond=1e-12)[0]
        return self.power.sum() - right[active] @ solved < TRIVIAL * self.power.sum()

    def _trivial(self, base: np.ndarray, errors: np.ndarray) -> bool:
        """Whether every free parameter of the model has shrunk to nothing, and the error with them.

        Members together may leave the scale of all equations open that each alone holds. Where
        the free parameters do so by themselves, no set is the worse for it.
        """
        given = self.system.theta[self.base]
        large = np.mean(errors) > SHRUNK**2 * np.mean(self.power / self.rows)
        if self.open or not given.size or large:
            return False
        return bool(np.all(np.abs(base) < SHRUNK * np.abs(given)))

    def run(self, stop: Callable[[], bool]) -> list[ScreenedSet]:
        """Grow sets from the empty one; keep the best `BEAM` of each size.

        Those of one candidate are scored whatever `stop` says.
        """
        found: dict[tuple[int, ...], ScreenedSet] = {}
        empty = self.evaluate(())
        assert empty is not None
        found[()] = empty
        self.open = self._trivial(empty.values[self.base], empty.errors)
        beam = [empty]
        collinear = self.below(COLLINEAR)
        usable = [i for i in range(len(self.index)) if i not in collinear]
        for size in range(MAX_SET):
            if size and stop():
                break
            wanted = {tuple(sorted({*p.members, c})) for p in beam for c in usable}
            grown = self._scored([m for m in sorted(wanted) if self._fresh(m, found)])
            found |= grown
            beam = sorted(grown.values(), key=lambda s: s.error)[:BEAM]
            if not beam or beam[0].error > 0.999 * min(
                s.error for s in found.values() if len(s.members) < len(beam[0].members)
            ):
                break
        return list(found.values())

    def _fresh(self, members: tuple[int, ...], found: dict) -> bool:
        return (
            members not in found and len(members) > 0 and not redundant(self.super_model, members)
        )

    def _scored(self, sets: Sequence[tuple[int, ...]]) -> dict[tuple[int, ...], ScreenedSet]:
        """Score many sets, those with equally many constants side by side."""
        groups: dict[int, list[tuple[int, ...]]] = {}
        for members in sets:
            groups.setdefault(sum(len(self.index[i]) for i in members), []).append(members)
        scored: dict[tuple[int, ...], ScreenedSet] = {}
        for group in groups.values():
            for start in range(0, len(group), TOGETHER):
                part = group[start : start + TOGETHER]
                found = zip(part, self._evaluate(part), strict=True)
                scored |= {members: item for members, item in found if item is not None}
        return {members: scored[members] for members in sets if members in scored}

    def evaluate(self, members: tuple[int, ...]) -> ScreenedSet | None:
        """Score a set; None where it breaks a sign or cannot be solved."""
        return self._evaluate([members])[0]

    def _evaluate(self, sets: Sequence[tuple[int, ...]]) -> list[ScreenedSet | None]:
        """Score sets of equally many constants, all blocks of all sets in one solve."""
        active = np.array(
            [[*self.base, *(j for i in members for j in self.index[i])] for members in sets],
            dtype=int,
        )
        count, theta = active.shape[1], self.system.theta
        if not count:
            return [ScreenedSet(m, self.power / self.rows, theta.copy()) for m in sets]
        g = self.gram[:, active[:, :, None], active[:, None, :]].swapaxes(0, 1)
        m = self.moment[:, active].swapaxes(0, 1)
        total_g, total_m = g.sum(1), m.sum(1)
        ridge = 1e-11 * np.trace(total_g, axis1=1, axis2=2)[:, None, None, None] / count
        ridge = np.where(ridge > 0.0, ridge, 1.0)  # constants without any effect stay as they are
        systems = np.concatenate([total_g[:, None], total_g[:, None] - g], axis=1)
        rights = np.concatenate([total_m[:, None], total_m[:, None] - m], axis=1)
        try:
            solved = np.linalg.solve(systems + ridge * np.eye(count), rights[..., None])[..., 0]
        except np.linalg.LinAlgError:
            return [None] if len(sets) == 1 else [self.evaluate(members) for members in sets]
        held = solved[:, 1:]
        sse = self.power - 2 * np.einsum("sbi,sbi->sb", m, held)
        sse += np.einsum("sbi,sbi->sb", held, (g @ held[..., None])[..., 0])
        errors = np.maximum(sse, 0.0) / self.rows
        return [
            self._checked(*item) for item in zip(sets, active, solved[:, 0], errors, strict=True)
        ]

    def _checked(
        self, members: tuple[int, ...], active: np.ndarray, step: np.ndarray, errors: np.ndarray
    ) -> ScreenedSet | None:
        """Return the scored set, or None where a constant breaks its sign or nothing is left."""
        theta = self.system.theta.copy()
        value = theta[active] + step / self.column[active]
        if members and self._trivial(value[: len(self.base)], errors):
            return None
        added, new = active[len(self.base) :], value[len(self.base) :]
        for j, estimate in zip(added, new, strict=True):
            if j in self.seed:
                # How much of the effect at the seed the data ask for.
                share = (estimate - theta[j]) / (self.seed[j] - theta[j])
                if not ENGAGED[0] < share < ENGAGED[1]:
                    return None
        outside = (new < self.low[added]) | (new > self.high[added])
        if outside[[j not in self.seed for j in added]].any():
            return None
        theta[active] = value
        for j in added:
            theta[j] = self.seed.get(int(j), theta[j])
        return ScreenedSet(members, errors, theta)


def _seeds(super_model: SuperModel) -> dict[int, float]:
    """Return the seeds of all thresholds, by position among the parameters."""
    order = {name: i for i, name in enumerate(super_model.model.parameters)}
    return {
        order[names[spec.name]]: spec.seed
        for candidate, names in zip(super_model.candidates, super_model.names, strict=True)
        for spec in candidate.parameters
        if isinstance(spec, Threshold)
    }
