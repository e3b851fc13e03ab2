"""States followed step by step, with their derivatives: by the machine where it can, else NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxsr._deadline import ask
from jaxsr.models.directions import Directions
from jaxsr.models.field import Field
from jaxsr.models.parts import Part
from jaxsr.models.programs import program_of
from jaxsr.models.steps import METHODS
from jaxsr.models.transitions import Taken, transition

Array = Any


def followed(
    field: Field, to: Directions | None, method: str, x: Sequence[Array], parts: Sequence[Part]
) -> tuple[list[list[Array]], Array]:
    """Advance step by step.

    Parameters
    ----------
    to : Directions or None
        None: states alone, with derivatives in no direction.
    x : sequence of ndarray, shape (steps, segments)
    parts : sequence of Part
        One after the other.

    Returns
    -------
    states : list of list of ndarray
        At the begin, and after every step.
    slopes : ndarray, shape (states, directions, steps, segments)
        Of the last states, by the first ones and by parameters.
    """
    program = program_of(field, to) if method == "rk4" else None
    if program is not None:
        along, slopes = program.run(field, x, parts, 0 if to is None else to.count)
        return [list(states) for states in along], slopes
    known, taken = stepped(field, method, x, parts, to is not None)
    shape = np.shape(x[0])
    if to is None:
        return known, np.zeros((len(x), 0, *shape))
    return known, transition(METHODS[method][0], to, taken, shape)


def stepped(
    field: Field, method: str, x: Sequence[Array], parts: Sequence[Part], slopes: bool = True
) -> tuple[list[list[Array]], list[Taken]]:
    """Return the states at the begin and after every step, and the steps that were taken.

    Parameters
    ----------
    slopes : bool
        Whether the Jacobian of the rates is wanted at every stage.
    """
    known, taken, step = [list(x)], list[Taken](), METHODS[method][1]
    for part in parts:
        ask()
        h, stages = part.length, part.stages
        states, rows = step(field, known[-1], part.begin, h, stages, slopes)
        known.append(states)
        taken.append(Taken(h, rows, stages))
    return known, taken
