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
    known, taken, shape = [list(x)], list[Taken](), np.shape(x[0])
    tableau, step = METHODS[method]
    for part in parts:
        ask()
        begin, h, stages = part.begin, part.length, part.stages
        states, rows = step(field, known[-1], begin, h, stages, to is not None)
        known.append(states)
        taken.append(Taken(h, rows, stages))
    if to is None:
        return known, np.zeros((len(x), 0, *shape))
    return known, transition(tableau, to, taken, shape)
