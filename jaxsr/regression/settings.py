"""Settings of a regression problem, by what they are about."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from jaxsr.evaluation.evaluator import Evaluator
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array
from jaxsr.regression.refinement import Refinement
from jaxsr.regression.threshold import HardThreshold


@dataclass(frozen=True)
class Rules:
    """How terms are weighed, and which may be used.

    Attributes
    ----------
    ridge : float
        Damping of unit-norm columns.
    threshold : HardThreshold
        What removes negligible terms.
    refinement : Refinement
        Limits of the search over inner constants.
    signs : mapping of Term to int
        Terms whose coefficients must not be negative (1) or not be positive (-1).
    admits : callable, optional
        Whether a term may be used, e.g. :class:`jaxsr.regression.InUnits`; all may when None.
    """

    ridge: float = 1e-10
    threshold: HardThreshold = field(default_factory=HardThreshold)
    refinement: Refinement = field(default_factory=Refinement)
    signs: Mapping[Term, int] = field(default_factory=dict)
    admits: Callable[[Term], bool] | None = None


@dataclass(frozen=True, eq=False)
class Sampling:
    """How samples follow each other in time.

    Attributes
    ----------
    time : str
        Name of the variable that is time, if it is among the variables.
    instants : ndarray, (samples,), optional
        Time of each sample for integrals, where it is not among the variables.
    group : ndarray of int, (samples,), optional
        Number of each sample's recording: integrals over time begin anew in each.
    """

    time: str = "t"
    instants: Array | None = None
    group: NDArray[np.intp] | None = None


@dataclass(frozen=True)
class TargetErrors:
    """What no fit can explain, as losses relative to the target's sum of squares.

    Attributes
    ----------
    floor : float
        What errors of the target itself leave; a fit that good is exact.
    noise : float
        What measurement noise of the target leaves, estimated.
    """

    floor: float = 1e-20
    noise: float = 0.0


@dataclass(frozen=True)
class Resources:
    """What evaluates terms, and the memory for it.

    Attributes
    ----------
    evaluator : callable
        What makes the evaluator, called as :class:`jaxsr.evaluation.Evaluator`.
    limit_bytes : int
        Memory for columns. Where it holds fewer than 1024 of them (12,000 rows by default), a
        problem without view and fixed columns keeps none and goes through its samples in pieces;
        any other holds what one call needs.
    """

    evaluator: Callable[..., Evaluator] = Evaluator
    limit_bytes: int = 192 * 2**20
