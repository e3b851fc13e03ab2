"""What `machine_steps` takes: programs of the register machine, and steps to take them through."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

Array = np.ndarray


class Code(NamedTuple):
    """Two programs: rates, and rates with their derivatives.

    Attributes
    ----------
    instructions : ndarray of int, shape (instructions, 5)
        Of `expressions.instructions`: what of either program is calculated once, and what at every
        stage.
    bounds : ndarray of int, shape (5,)
        Where these four parts begin and end.
    preset : ndarray, shape (registers,)
    fixed_at : ndarray of int, shape (values,)
        Registers of constants.
    time_at, states_at, inputs_at : ndarray of int, shape (2, names)
        Registers in either program; -1 where a name does not occur.
    rates_at : ndarray of int, shape (2, states)
    by_state : ndarray of int, shape (entries, 3)
        State whose rate it is of, state it is by, register: the entries of J.
    by_parameter : ndarray of int, shape (entries, 4)
        State whose rate it is of, parameter it is by, register, and the row of
        `Course.input_rates` that it is to be multiplied by, or -1: the entries of P.
    """

    instructions: Array
    bounds: Array
    preset: Array
    fixed_at: Array
    time_at: Array
    states_at: Array
    inputs_at: Array
    rates_at: Array
    by_state: Array
    by_parameter: Array


class Course(NamedTuple):
    """Parts of steps, one after the other, and what comes from outside.

    Attributes
    ----------
    of : ndarray of int, shape (parts,)
        The step that each is a part of.
    times : ndarray, shape (2, steps, samples)
        Begin and length of a step.
    shares : ndarray, shape (2, parts, samples)
        Of it, at which a part begins and ends.
    inputs : ndarray, shape (3, inputs, steps, samples)
        At its begin, its middle and its end.
    input_rates : ndarray, shape (3, delays, steps, samples)
        The same of the derivatives of inputs by their delays.
    """

    of: Array
    times: Array
    shares: Array
    inputs: Array
    input_rates: Array
