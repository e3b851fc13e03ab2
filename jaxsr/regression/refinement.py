"""Method and limits of the search over constants inside terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from jaxsr._result import InputError

METHODS = ("levenberg_marquardt", "adam", "lbfgs")


@dataclass(frozen=True, slots=True)
class Refinement:
    """Method and limits of the search over inner constants.

    Attributes
    ----------
    method : str
        "levenberg_marquardt" (the best of them in success and cost, benchmarks/constants.py), or
        a descent by optax through the ridge solve: "adam" (needs hundreds of iterations),
        "lbfgs". Terms without postfix code are left to the first.
    iterations : int
        Steps tried.
    floor : float
        Loss relative to the target's at which a fit is exact to rounding.
    most_constants : int
        Individuals with more inner constants are left alone: they are not identifiable.
    gain : float
        A step that lowers the loss by less than this share of it, or promises no more, is the
        last.
    reach : float
        Longest step of a constant relative to its size (or to one, for smaller constants).
    learning_rate : float
        Adam's, relative to the constants' sizes.
    """

    method: Literal["levenberg_marquardt", "adam", "lbfgs"] = "levenberg_marquardt"
    iterations: int = 15
    floor: float = 1e-22
    most_constants: int = 10
    gain: float = 1e-6
    reach: float = 10.0
    learning_rate: float = 0.01

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(
                f"unknown method {self.method!r}", "Refinement", f"Use one of {', '.join(METHODS)}."
            )
        if self.iterations < 0 or self.most_constants < 0:
            raise InputError("iterations and most_constants must not be negative", "Refinement")
        if not self.reach > 0.0:
            raise InputError(f"reach must be positive, got {self.reach}", "Refinement")
