"""Settings of a search, by role."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from jaxsr._result import InputError
from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.regression.threshold import HardThreshold

DEFAULT_FUNCTIONS = (
    *("add", "mul", "div", "pow", "sin", "cos", "sqrt", "abs", "exp", "log", "sign"),
)
"""What a search uses unless told otherwise."""
PAPER_FUNCTIONS = (*DEFAULT_FUNCTIONS, "asin", "tanh", "heaviside", "integral")
"""The function set of the paper's Eqs. 5 and 6; see :meth:`SearchConfig.suited`."""
# Conditions and their joints take truth values, which random terms do not keep apart.
_UNFIT = frozenset({"and", "or", "piecewise"})


def _require(holds: bool, what: str, where: str) -> None:
    if not holds:
        raise InputError(what, where)


@dataclass(frozen=True, slots=True)
class PrimitiveSet:
    """What terms are made of (paper Eqs. 4 and 5), beside the problem's variables and 1.

    Attributes
    ----------
    functions : tuple of str
        Names of primitives, those of :func:`jaxsr.expressions.define_primitive` included.
    constants : tuple of float
        Range of constants at birth.
    exponents : tuple of float
        Range of the exponents of ``pow`` at birth.
    real_exponents : float
        Share of exponents at birth that are real numbers; the others are whole. A real power of
        a variable that takes both signs is not finite and drops out.
    """

    functions: tuple[str, ...] = DEFAULT_FUNCTIONS
    constants: tuple[float, float] = (-10.0, 10.0)
    exponents: tuple[float, float] = (2.0, 3.0)
    real_exponents: float = 0.0

    def __post_init__(self) -> None:
        where = "PrimitiveSet"
        _require(
            not isinstance(self.functions, str),
            f"functions must be a tuple of names, got {self.functions!r}",
            where,
        )
        unknown = sorted(str(f) for f in self.functions if f not in PRIMITIVES or f in _UNFIT)
        _require(not unknown, f"unknown functions {unknown}", "PrimitiveSet.functions")
        for name in ("constants", "exponents"):
            _require_range(getattr(self, name), f"{where}.{name}")
        low, high = self.exponents
        _require(
            0.0 <= self.real_exponents <= 1.0,
            f"real_exponents must lie in [0, 1], got {self.real_exponents}",
            where,
        )
        _require(
            self.real_exponents == 1.0 or bool(whole_between(low, high)),
            f"no whole exponent but 0 and 1 lies in {self.exponents}",
            where,
        )


def whole_between(low: float, high: float) -> list[int]:
    """Return the whole exponents in a range that make a power: not 0, not 1."""
    return [k for k in range(math.ceil(low), math.floor(high) + 1) if k not in (0, 1)]


def _require_range(pair: tuple[float, float], where: str) -> None:
    fits = len(pair) == 2 and all(math.isfinite(v) for v in pair) and pair[0] < pair[1]
    _require(fits, f"a range must be (low, high) with low < high, got {pair}", where)


@dataclass(frozen=True, slots=True)
class SizeLimits:
    """Nodes of a term at birth and later; terms of an individual."""

    at_birth: int = 5
    later: int = 15
    terms: int = 10

    def __post_init__(self) -> None:
        for name in ("at_birth", "later", "terms"):
            value = getattr(self, name)
            whole = isinstance(value, int) and not isinstance(value, bool)
            _require(
                whole and value >= 1,
                f"{name} must be a whole number >= 1, got {value!r}",
                f"SizeLimits.{name}",
            )
        _require(self.at_birth <= self.later, "need at_birth <= later", "SizeLimits")


@dataclass(frozen=True, slots=True)
class MutationWeights:
    """How often each way of making a child is taken; relative, not summing to one.

    Attributes
    ----------
    crossover : float
        Exchange subtrees of two individuals.
    subtree, constant : float
        Replace a subtree by a new one; move a constant by Eq. 7 or take one of the best set's.
    add, drop : float
        Add a new term; remove one.
    greedy : float
        Replace or add a term by one that explains most of the residual.
    """

    crossover: float = 4.0
    subtree: float = 2.0
    constant: float = 1.0
    add: float = 1.0
    drop: float = 0.5
    greedy: float = 1.5

    def __post_init__(self) -> None:
        weights = self.as_tuple()
        _require(
            all(map(math.isfinite, weights)) and min(weights) >= 0.0 < sum(weights),
            f"weights must not be negative and not all be zero, got {weights}",
            "MutationWeights",
        )

    def as_tuple(self) -> tuple[float, ...]:
        """Return the weights in the order of the attributes."""
        return (self.crossover, self.subtree, self.constant, self.add, self.drop, self.greedy)


@dataclass(frozen=True, slots=True)
class FitnessRule:
    r"""What individuals are ranked by.

    Attributes
    ----------
    measure : str
        "adaptive" (Eq. 9), "aic" (Eq. 10) or "bic" (Eq. 11).
    data : str
        "training", or "validation": coefficients from the training rows, the residual from the
        problem's validation rows (``judge``), for few data.
    generations : int
        :math:`N_{threshold}`: parsimony is off before it.
    error : float
        :math:`E_{threshold}`, relative to the target's sum of squares: below it alpha grows.
    increment, highest : float
        Growth of alpha in a generation, halved after an abrupt rise of the residual; its limit.
    tau : float
        Power of the mean number of operators, in (0, 0.1].
    """

    measure: Literal["adaptive", "aic", "bic"] = "adaptive"
    data: Literal["training", "validation"] = "training"
    generations: int = 2
    error: float = 1e-2
    increment: float = 0.1
    highest: float = 2.0
    tau: float = 0.1

    def __post_init__(self) -> None:
        _require(
            self.measure in ("adaptive", "aic", "bic"),
            f"measure must be 'adaptive', 'aic' or 'bic', got {self.measure!r}",
            "FitnessRule",
        )
        _require(
            self.data in ("training", "validation"),
            f"data must be 'training' or 'validation', got {self.data!r}",
            "FitnessRule",
        )
        _require(0.0 <= self.tau <= 0.1, f"tau must lie in [0, 0.1], got {self.tau}", "FitnessRule")
        _require(self.increment >= 0.0, "increment must not be negative", "FitnessRule")


@dataclass(frozen=True, slots=True)
class SearchConfig:
    """Settings of the evolutionary search.

    Attributes
    ----------
    population, generations : int
        Individuals; the most generations run.
    elite, reproduction : float
        Shares of the population: the best set G_b, and survivors chosen by tournament.
    refined : int
        Individuals whose constants are refined in a generation; 0 leaves constants to mutation.
    patience : int
        Generations without a better description after which the search has converged.
    restarts : int
        Fresh populations in a row that may lead nowhere before the search has converged.
    target : float
        Loss, relative to the target's sum of squares, at which the fit is exact.
    vartheta : float
        Reach of the constant mutation, Eq. 7.
    threshold : HardThreshold
        Rule that removes negligible terms, Eq. 12; a problem is built with it.
    """

    population: int = 200
    generations: int = 500
    elite: float = 0.1
    reproduction: float = 0.1
    refined: int = 12
    patience: int = 8
    restarts: int = 2
    target: float = 1e-20
    vartheta: float = 5.0
    primitives: PrimitiveSet = field(default_factory=PrimitiveSet)
    sizes: SizeLimits = field(default_factory=SizeLimits)
    weights: MutationWeights = field(default_factory=MutationWeights)
    fitness: FitnessRule = field(default_factory=FitnessRule)
    threshold: HardThreshold = field(default_factory=HardThreshold)

    def __post_init__(self) -> None:
        _require(self.population >= 10, "population must be at least 10", "SearchConfig")
        _require(self.generations >= 1, "generations must be at least 1", "SearchConfig")
        shares = (self.elite, self.reproduction)
        _require(
            min(shares) > 0.0 and sum(shares) < 1.0,
            f"elite and reproduction must be positive and sum to less than 1, got {shares}",
            "SearchConfig",
        )

    @classmethod
    def paper(cls, population: int = 600) -> SearchConfig:
        r"""Return the settings of the paper's section 6.

        600 individuals (800 for the crank-slider), 100 generations, N_threshold 50, E_threshold
        1e-3 of the target's sum of squares, vartheta 5, constants in [-100, 100], sizes 5, 15 and
        20, 10 % best set and 10 % reproduction, sigma 1e-4, alpha from 1 to 2, the functions of
        Eqs. 5 and 6, half of the exponents real; constants are left to mutation.
        """
        return cls(
            population=population,
            generations=100,
            elite=0.1,
            reproduction=0.1,
            refined=0,
            patience=50,
            restarts=0,
            vartheta=5.0,
            primitives=PrimitiveSet(
                functions=PAPER_FUNCTIONS,
                constants=(-100.0, 100.0),
                exponents=(-3.0, 3.0),
                real_exponents=0.5,
            ),
            sizes=SizeLimits(at_birth=5, later=15, terms=20),
            weights=MutationWeights(add=0.0, drop=0.0, greedy=0.0),
            fitness=FitnessRule(generations=50, error=1e-3, highest=2.0),
            threshold=HardThreshold(sigma=1e-4),
        )

    def suited(self, timed: bool) -> SearchConfig:
        """Return the settings without integrals over time where samples have no instants."""
        kept = tuple(f for f in self.primitives.functions if timed or f != "integral")
        if kept == self.primitives.functions:
            return self
        return replace(self, primitives=replace(self.primitives, functions=kept))
