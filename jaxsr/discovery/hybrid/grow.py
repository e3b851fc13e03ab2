"""Grow a tree of modes: split where one law fails, find a submodel on either side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxsr._progress import Budget
from jaxsr.discovery.equation import Equation
from jaxsr.discovery.find import Task
from jaxsr.discovery.hybrid.clusters import choose_coordinates
from jaxsr.discovery.hybrid.guards import Guard, guard_values, guard_variables, inside, plain
from jaxsr.discovery.hybrid.memory import (
    FunctionMemory,
    independent_columns,
    scanned_terms,
    usual_terms,
)
from jaxsr.discovery.hybrid.rare import rare_tail
from jaxsr.discovery.hybrid.scan import Split, best_splits
from jaxsr.discovery.hybrid.submodels import Limits, find_submodel, from_memory
from jaxsr.discovery.hybrid.tree import Node, clear_of, meeting_point, refined_threshold
from jaxsr.discovery.hybrid.unfold import unfolded
from jaxsr.discovery.samples import Roles, Samples, thinned
from jaxsr.expressions.editing import ONE
from jaxsr.expressions.term import Term

_SCANNED = 3000  # samples on which thresholds are tried
_CLUSTERED = 3000  # samples among which neighbours are sought
_SOFT = 1e-4  # error relative to the rms below which samples count alike when scanned
_TERMS = 40  # columns of a scan
_SIDE = 0.3  # share of the samples that a side must have to be looked at for a second guard
_JUDGED = 8  # samples to judge by; with fewer, those learnt from serve
_TIED = 0.05  # of a log mean square: guards that do equally well


@dataclass(frozen=True, slots=True)
class HybridConfig:
    """Settings of the discovery of modes.

    Attributes
    ----------
    most : int
        Most modes.
    least : int
        Fewest samples of a mode.
    gain : float
        Factor by which a split must lower the mean square of linear fits to be looked into.
    sharp : float
        Rise of the log mean square where a guard is moved by a twentieth of the samples, below
        which the law may be smooth.
    better : float
        Factor by which modes must lower the mean square on samples held back.
    much_better : float
        The same, where a submodel leaves more than noise.
    limits : Limits
        Of the searches for submodels.
    """

    most: int = 4
    least: int = 12
    gain: float = 4.0
    sharp: float = 1.0
    better: float = 4.0
    much_better: float = 100.0
    limits: Limits = field(default_factory=Limits)


@dataclass(frozen=True, eq=False)
class Grower:
    """What growing a tree needs.

    Attributes
    ----------
    rng : Generator
    tasks : mapping of str to Task
        Of the states whose law switches.
    part : Roles
    kinds : sequence of sequence of str
        States of one unit.
    memory : FunctionMemory
    train, judge : Samples
    budget : Budget
    config : HybridConfig
    count : int or None
        Number of modes where it is given.
    timed : bool
        Whether time may be a guard: where a force is not known yet, a short while fits better
        than a long one.
    """

    rng: np.random.Generator
    tasks: Mapping[str, Task]
    part: Roles
    kinds: Sequence[Sequence[str]]
    memory: FunctionMemory
    train: Samples
    judge: Samples
    budget: Budget
    config: HybridConfig
    count: int | None = None
    timed: bool = True

    def grown(self, laws: Mapping[str, Equation]) -> Node:
        """Return the tree; a single leaf where no split is worth it."""
        root = Node((), laws, False, rows=len(self.train))
        while not self.budget.exhausted:
            leaves = list(root.leaves())
            if len(leaves) >= (self.count or self.config.most):
                break
            open_ = [leaf for leaf in leaves if not leaf.explained]
            tried = [(self._split(leaf), leaf) for leaf in open_]
            found = [(s, leaf) for s, leaf in tried if s is not None]
            if not found:
                break
            (guard, _), leaf = max(found, key=lambda item: item[0][1] * item[1].rows)
            node = self._parted(leaf, guard)
            if node is None:
                break
            root = _exchanged(root, leaf, node)
        if root.guard is None or self.count is not None:
            return root
        return unfolded(root, self.train, self.judge, self._remembered, self.config.least)

    def _remembered(self, part: Samples, judge: Samples) -> tuple[dict[str, Equation], bool]:
        """Return laws out of the memory alone."""
        judge = judge if len(judge) >= _JUDGED else part
        found = {s: from_memory(t, self.memory, part, judge) for s, t in self.tasks.items()}
        return {s: law for s, (law, _) in found.items()}, all(e for _, e in found.values())

    def _rows(self, samples: Samples, region: Sequence[Guard]) -> Samples:
        return samples.take(np.flatnonzero(inside(tuple(region), samples.variables)))

    def _split(self, leaf: Node) -> tuple[Guard, float] | None:
        """Return the guard that divides a leaf best and its gain, if it is worth it."""
        found = self.scanned(leaf.region)
        if found is None:
            return None
        variable, split = found
        return Guard(variable, split.threshold), split.gain

    def scanned(self, region: Sequence[Guard]) -> tuple[Term, Split] | None:
        """Return the guard variable and threshold that divide a region best."""
        rows = self._rows(self.train, region)
        rows = rows.take(thinned(np.arange(len(rows)), _SCANNED))
        variables = guard_variables(self.part, self.kinds, rows.variables, timed=self.timed)
        values = [guard_values(term, rows.variables) for term in variables]
        targets = np.column_stack([self._target(state, rows) for state in self.tasks])
        best: tuple[float, Split] | None = None
        for terms in (self._terms(), [ONE, *map(Term.variable, self._names())]):
            kept, columns = independent_columns(terms, rows.variables, _TERMS)
            if not kept:
                continue
            scaled = columns * self._weights(rows)[:, None]
            least = max(self.config.least, 2 * len(kept))
            for split in best_splits(scaled, targets, values, least, self._expired):
                if split.gain < np.log(self.config.gain) and self.count is None:
                    continue
                price = 2.0 * len(kept) * np.log(len(rows)) / len(rows)
                level = split.level + price + _TIED * min(1.0, 0.2 * variables[split.guard].size)
                if best is None or level < best[0]:
                    best = level, split
        if best is None:
            return None
        return variables[best[1].guard], best[1]

    def is_sharp(self) -> bool:
        """Tell whether laws break at a guard, or at a second one on a side of a first.

        A smooth law may be fitted much better in two parts than in one, but it does not matter
        much where they meet; a guard that is missed by a few samples spoils both sides.
        """
        first = self.scanned(())
        if first is None:
            return False
        if first[1].sharpness >= self.config.sharp:
            return True
        guard = Guard(first[0], first[1].threshold)
        for side in (guard.other, guard):
            if inside((side,), self.train.variables).mean() < _SIDE:
                continue
            second = self.scanned((side,))
            if second is not None and second[1].sharpness >= self.config.sharp:
                return True
        return False

    def rare(self) -> Guard | None:
        """Return the guard of a few samples at one end of a variable that spoil the others' law."""
        rows = self.train.take(thinned(np.arange(len(self.train)), _SCANNED))
        variables = guard_variables(self.part, self.kinds, rows.variables, timed=False)
        values = [guard_values(term, rows.variables) for term in variables]
        targets = np.column_stack([self._target(state, rows) for state in self.tasks])
        kept, columns = independent_columns(self._terms(), rows.variables, _TERMS)
        if not kept:
            return None
        weighed = columns * self._weights(rows)[:, None]
        tail = rare_tail(weighed, targets, values, self._expired)
        return None if tail is None else Guard(variables[tail.guard], tail.threshold, tail.above)

    def parted(self, guard: Guard, laws: Mapping[str, Equation]) -> Node | None:
        """Return two leaves on either side of a guard; None where one has hardly a sample."""
        return self._parted(Node((), laws, False, rows=len(self.train)), replace(guard, above=True))

    def _expired(self) -> bool:
        return self.budget.exhausted

    def _names(self) -> tuple[str, ...]:
        return (*self.part.states, *self.part.inputs)

    def _terms(self) -> list[Term]:
        usual = usual_terms(self.part.states, self.part.inputs, self.kinds)
        return [*usual, *scanned_terms(self.memory, self.part.states, self.part.time)]

    def _weights(self, rows: Samples) -> np.ndarray:
        """Return weights of samples: those with large errors of the derivative count less."""
        errors = np.zeros(len(rows))
        for state in self.tasks:
            scale = float(np.sqrt(np.mean(rows.targets[state] ** 2))) or 1.0
            own = rows.errors.get(state)
            errors += (own / scale) ** 2 if own is not None else 0.0
        weights = 1.0 / np.sqrt(errors + _SOFT**2)
        return weights / np.sqrt(np.mean(weights**2))

    def _target(self, state: str, rows: Samples) -> np.ndarray:
        return self._weights(rows) * self.tasks[state].remainder(rows)

    def _parted(self, leaf: Node, guard: Guard) -> Node | None:
        """Return the leaf with a guard and submodels on either side."""
        whole = self._rows(self.train, leaf.region)
        held = self._rows(self.judge, leaf.region)
        sides = []
        for rows, seen, own in zip(
            clear_of(guard, whole), clear_of(guard, held), (guard.other, guard), strict=True
        ):
            part, judge = whole.take(rows), held.take(seen)
            if len(part) < self.config.least // 2:
                return None
            laws, explained = self._laws(part, judge)
            region = plain((*leaf.region, own))
            sides.append(Node(region, laws, explained, rows=len(part)))
        threshold = self._threshold(guard, whole, sides)
        guard = replace(guard, threshold=threshold)
        below, above = (
            replace(side, region=plain((*leaf.region, own)))
            for side, own in zip(sides, (guard.other, guard), strict=True)
        )
        return replace(leaf, guard=guard, below=below, above=above)

    def _laws(self, part: Samples, judge: Samples) -> tuple[dict[str, Equation], bool]:
        laws, every = {}, True
        for state, task in self.tasks.items():
            if len(judge) < _JUDGED:
                judge = part
            pure = self._pure(state, part)
            laws[state], explained = find_submodel(
                self.rng, task, self.memory, part, judge, pure, self.config.limits, self.budget
            )
            every = every and explained
        return laws, every

    def _pure(self, state: str, part: Samples) -> list[np.ndarray]:
        """Return clusters of a region to search in, those with the most motion first.

        Coordinates are those in which local fits leave least. Clusters in which every state that
        changes sign in the region keeps it come first: laws of sizes and signs are plainest there.
        """
        few = thinned(np.arange(len(part)), _CLUSTERED)
        whole, part = part, part.take(few)
        count = int(np.clip(len(part) // 4, 30, 150))
        if count >= len(part):
            return [np.arange(len(whole))]
        _, columns = independent_columns(self._terms(), part.variables, min(15, count // 4))
        target = self._target(state, part)[:, None]
        clusters, _errors = choose_coordinates(
            part.variables, part.group, self.choices(), count, (columns, target)
        )
        spread = np.std(part.targets[state][clusters.members], axis=1)
        names = [n for n in self.part.states if np.min(part.variables[n]) < 0.0]
        signed = np.zeros(len(clusters))
        for name in names:
            v = part.variables[name][clusters.members]
            signed += np.all(v > 0.0, axis=1) | np.all(v < 0.0, axis=1)
        order = np.lexsort((-spread, -signed))
        chosen: list[np.ndarray] = []
        for k in order.tolist():
            rows = few[np.sort(clusters.members[k])]
            if all(len(np.intersect1d(rows, old)) < 0.5 * count for old in chosen):
                chosen.append(rows)
            if len(chosen) == self.config.limits.clusters:
                break
        return chosen

    def choices(self) -> list[tuple[str, ...]]:
        """Return the data-driven coordinates to choose from."""
        return [self.part.states, *(tuple(kind) for kind in self.kinds)]

    def _threshold(self, guard: Guard, whole: Samples, sides: Sequence[Node]) -> float:
        values = guard_values(guard.variable, whole.variables)
        errors = np.zeros((2, len(whole)))
        for state in self.tasks:
            scale = float(np.mean(whole.targets[state] ** 2)) or 1.0
            for k, side in enumerate(sides):
                left = whole.targets[state] - side.laws[state].predict(whole)
                errors[k] += left**2 / scale
        below, above = np.sqrt(errors)
        weights = self._weights(whole)
        reach = max(5, len(whole) // 10)
        found = refined_threshold(values, weights * below, weights * above, guard.threshold, reach)
        apart = {}
        for state in self.tasks:
            one, other = (side.laws[state].predict(whole) for side in sides)
            apart[state] = (one - other) / (float(np.std(whole.targets[state])) or 1.0)
        leader = max(apart, key=lambda s: float(np.nanmean(np.abs(apart[s]))))
        place = meeting_point(values, apart[leader], found)
        if place == found and guard.variable.op == "abs":
            # the difference of resistances has the sign of the motion
            inner = guard_values(guard.variable.args[0], whole.variables)
            place = meeting_point(values, apart[leader] * np.sign(inner), found)
        return place


def _exchanged(root: Node, old: Node, new: Node) -> Node:
    """Return the tree with one node in place of another."""
    if root is old:
        return new
    if root.below is None or root.above is None:
        return root
    return replace(
        root, below=_exchanged(root.below, old, new), above=_exchanged(root.above, old, new)
    )
