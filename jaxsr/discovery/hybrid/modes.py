"""Modes of a system: found where one law leaves more than noise, and kept if they pay.

A first look needs no law: where linear fits on both sides of a guard leave far less than one, and
the place of the guard is sharp, submodels are searched at once, for a law that does not exist is
the longest search of all. Otherwise modes are looked for after the search for one law, where that
leaves more than noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxsr._deadline import OutOfTime
from jaxsr._progress import Budget
from jaxsr.discovery.equation import Equation
from jaxsr.discovery.experiments import Experiments
from jaxsr.discovery.find import Task, find_equation
from jaxsr.discovery.hybrid.assemble import Hybrid, assembled, merged, pointwise
from jaxsr.discovery.hybrid.grow import Grower, HybridConfig
from jaxsr.discovery.hybrid.memory import FunctionMemory, front_terms, harmonics, usual_terms
from jaxsr.discovery.hybrid.rare import RareMode
from jaxsr.discovery.hybrid.tree import Node
from jaxsr.discovery.recognise import recognised
from jaxsr.discovery.samples import Roles, Samples
from jaxsr.expressions.term import Term

_NOISE = 2.0  # mean square over the noise's up to which one law is enough
_KINKS = frozenset({"abs", "sign", "max", "min", "heaviside"})


@dataclass(frozen=True, eq=False)
class Looked:
    """What a first look found: a tree, and the laws of one mode that it is compared with.

    Attributes
    ----------
    root : Node or None
        None where nothing speaks for modes.
    laws : dict of str to Equation
        From short searches.
    sure : bool
        Whether the modes explain everything and one law does not: no longer search is needed.
    """

    root: Node | None
    laws: Mapping[str, Equation]
    sure: bool


@dataclass(frozen=True, eq=False)
class ModeFinder:
    """The search for modes of one discovery.

    Attributes
    ----------
    rng : Generator
    tasks : mapping of str to Task
        Of every state.
    experiments : Experiments
    count : int or None
        Number of modes, where it is given.
    config : HybridConfig
    """

    rng: np.random.Generator
    tasks: Mapping[str, Task]
    experiments: Experiments
    count: int | None = None
    config: HybridConfig = field(default_factory=HybridConfig)

    def look(self, budget: Budget) -> Looked:
        """Search modes before any law, where linear fits speak for them.

        States seen in the weak view for noise wait for their law: their derivatives at single
        samples are noise, which linear fits take for switches. Nothing is found where the budget
        ends before.
        """
        try:
            return self._look(budget)
        except OutOfTime:
            return Looked(None, {}, False)

    def _look(self, budget: Budget) -> Looked:
        part = self.experiments.roles
        rates = rates_of(part, self.experiments.rows)
        kinds = kinds_of(part, rates)
        open_ = [s for s in part.states if s not in rates and s not in self.experiments.rows.weak]
        if not open_:
            return Looked(None, {}, False)
        grower = self._grower(open_, kinds, budget, ())
        sharp = [s for s in open_ if self._is_sharp(grower, s)]
        if not sharp:
            return Looked(None, {}, False)
        laws = {s: self._short(s, grower, budget) for s in sharp}
        if self.count is None and all(e.exact and not has_threshold(e) for e in laws.values()):
            return Looked(None, laws, False)
        grower = self._grower(sharp, kinds, budget, list(laws.values()))
        root = replace(grower, timed=False).grown(laws)
        leaves = list(root.leaves())
        if len(leaves) < 2:
            return Looked(None, laws, False)
        rows = pointwise(self.experiments.rows)
        if len(merged(leaves, self.tasks, rows, list(root.laws))) < 2:
            return Looked(None, laws, False)
        every = all(leaf.explained for leaf in leaves)
        sure = every and (self.count is not None or self._pays(root, laws))
        return Looked(root, laws, sure)

    def modes(self, looked: Looked, equations: Sequence[Equation]) -> Hybrid | None:
        """Return the modes that a first look is sure of."""
        if looked.root is None or not looked.sure:
            return None
        return self._assembled(looked.root, equations)

    def find(
        self, looked: Looked, equations: Sequence[Equation], budget: Budget
    ) -> Hybrid | RareMode | None:
        """Return the modes of a system, or None where one law is enough.

        A mode hardly visited is told as such, where its law cannot be told. One law stays where
        the budget ends before modes are found.

        Parameters
        ----------
        looked : Looked
            What the first look found.
        equations : sequence of Equation
            One law for each state, as a discovery of one mode found it.
        budget : Budget
        """
        try:
            return self._find(looked, equations, budget)
        except OutOfTime:
            return None

    def _find(
        self, looked: Looked, equations: Sequence[Equation], budget: Budget
    ) -> Hybrid | RareMode | None:
        laws = {e.state: e for e in equations}
        root, auto = looked.root, self.count is None
        open_ = [e.state for e in equations if is_open(e)]
        if root is None and not open_ and not auto:
            open_ = [e.state for e in equations if e.front]
        if root is None and not open_:
            return None
        kinds = kinds_of(self.experiments.roles, rates_in(equations))
        grower = self._grower(open_, kinds, budget, [laws[s] for s in open_])
        if root is None and (not auto or grower.is_sharp()):
            root = grower.grown({s: laws[s] for s in open_})
        if (
            root is not None
            and len(list(root.leaves())) > 1
            and (not auto or self._pays(root, laws))
        ):
            return self._assembled(root, equations)
        return self._rare(grower, laws, equations) if auto and open_ else None

    def _rare(
        self, grower: Grower, laws: Mapping[str, Equation], equations: Sequence[Equation]
    ) -> Hybrid | RareMode | None:
        """Return the modes where few samples at an end follow another law, or where they lie."""
        guard = grower.rare()
        if guard is None:
            return None
        root = grower.parted(guard, {s: laws[s] for s in grower.tasks})
        if root is not None and self._pays(root, laws):
            found = self._assembled(root, equations)
            if found is not None:
                return found
        rows = self.experiments.rows
        return RareMode(guard, int(np.count_nonzero(guard.holds(rows.variables))), len(rows))

    def _assembled(self, root: Node, equations: Sequence[Equation]) -> Hybrid | None:
        laws = {e.state: e for e in equations}
        kinds = kinds_of(self.experiments.roles, rates_in(equations))
        choices = [self.experiments.roles.states, *kinds]
        return assembled(root, laws, self.tasks, self.experiments, list(root.laws), choices)

    def _grower(
        self, states: Sequence[str], kinds: Sequence[Sequence[str]], budget: Budget,
        equations: Sequence[Equation],
    ) -> Grower:  # fmt: skip
        part, memory = self.experiments.roles, FunctionMemory()
        memory.add(usual_terms(part.states, part.inputs, kinds))
        remembered = front_terms(equations)
        memory.add(harmonics(remembered, part.time))
        memory.add(remembered)
        train, judge = pointwise(self.experiments.train), pointwise(self.experiments.judge)
        tasks = {s: replace(self.tasks[s], limit=budget, strict=True) for s in states}
        return Grower(
            self.rng, tasks, part, kinds, memory, train, judge, budget, self.config, self.count
        )

    def _is_sharp(self, grower: Grower, state: str) -> bool:
        """Tell whether a state's law breaks at some guard; time enters by its main frequencies."""
        task, part = grower.tasks[state], self.experiments.roles
        alone = replace(grower, tasks={state: task}, timed=False)
        if not part.autonomous:
            problem = task.problem(grower.train)
            usable = [t for t in grower.memory if problem.index([t])[0] >= 0]
            found = problem.frequencies(usable, part.time, 2)
            t = Term.variable(part.time)
            angles = [Term.apply("mul", Term.constant(w), t) for w in found]
            grower.memory.add(
                Term.apply(wave, angle) for angle in angles for wave in ("sin", "cos")
            )
        return alone.is_sharp()

    def _short(self, state: str, grower: Grower, budget: Budget) -> Equation:
        """Return one law from a short search."""
        task = grower.tasks[state]
        short = replace(task, config=self.config.limits.of(task.config), checkpoint=None)
        rows = grower.train
        return find_equation(self.rng, short, rows, grower.judge, rows, budget=budget)

    def _pays(self, root: Node, laws: Mapping[str, Equation]) -> bool:
        """Tell whether modes lower the error on samples held back by enough.

        Where one law is exact too, but only by way of a threshold of its own (``Abs(x - 1)``),
        it is modes written as one.
        """
        judge, leaves = pointwise(self.experiments.judge), list(root.leaves())
        every = all(leaf.explained for leaf in leaves)
        if every and all(laws[s].exact and has_threshold(laws[s]) for s in root.laws):
            return True
        fall = [
            np.log(mean_square(laws[s].predict(judge), judge, s))
            - np.log(mean_square(root.predict(s, judge), judge, s))
            for s in root.laws
        ]
        least = self.config.better if every else self.config.much_better
        return float(np.mean(fall)) >= np.log(least)


def is_open(equation: Equation) -> bool:
    """Tell whether a law leaves more than noise, or switches at a threshold of its own."""
    if not equation.front:
        return False
    if equation.exact:
        return has_threshold(equation)
    return equation.train_mse > _NOISE * equation.noise_mse


def has_threshold(equation: Equation) -> bool:
    """Tell whether a law bends or jumps away from zero: ``Abs(x - 1)`` does, ``Abs(x)`` not."""
    for part in equation.terms:
        for node in part.term.walk():
            if node.op in _KINKS and any(a.op in ("add", "sub") for a in node.args):
                constants = [c for a in node.args for c in a.args if c.is_constant]
                if any(c.value != 0.0 for c in constants):
                    return True
    return False


def rates_of(part: Roles, rows: Samples) -> dict[str, str]:
    """Return states whose rate is another state, by definition or by what they show."""
    rates = dict(part.rate_of)
    for state in part.states:
        if state not in rates:
            other = recognised(rows, state, part.states)
            if other is not None:
                rates[state] = other
    return rates


def rates_in(equations: Sequence[Equation]) -> dict[str, str]:
    """Return states whose equation is that their rate is another state."""
    out = {}
    for equation in equations:
        terms = equation.terms
        if len(terms) == 1 and terms[0].coefficient == 1.0 and terms[0].term.is_variable:
            out[equation.state] = terms[0].term.name
    return out


def kinds_of(part: Roles, rates: Mapping[str, str]) -> list[tuple[str, ...]]:
    """Return the states by kind: displacements, velocities, others."""
    displacements = tuple(s for s in part.states if s in rates and s not in rates.values())
    velocities = tuple(rates[s] for s in displacements if rates[s] in part.states)
    others = tuple(s for s in part.states if s not in (*displacements, *velocities))
    return [kind for kind in (displacements, velocities, others) if kind]


def mean_square(predicted: np.ndarray, samples: Samples, state: str) -> float:
    """Return the mean square error of a rate, relative; large where it is not finite."""
    y = samples.targets[state]
    error = np.nan_to_num(y - predicted, nan=1e3 * float(np.std(y)), posinf=1e30, neginf=-1e30)
    return float(np.mean(error**2)) / (float(np.mean(y**2)) or 1.0) + 1e-30
