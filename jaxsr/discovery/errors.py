"""Errors of the equations as they are stated: of the final expressions, coefficients and all."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jaxsr.discovery.choose import predict
from jaxsr.discovery.equation import Equation
from jaxsr.discovery.experiments import Experiments
from jaxsr.discovery.find import Task
from jaxsr.discovery.samples import Samples


def stated(
    equations: Sequence[Equation],
    tasks: Mapping[str, Task],
    experiments: Experiments,
    *,
    partial: bool = False,
) -> list[Equation]:
    """Return equations with the mean squares of what they state.

    ``train_mse`` is that of the expression on all rows of DATA. ``validation_mse`` is that of the
    expression on recordings that only served to choose by; where blocks of DATA did, that of its
    terms with all constants estimated on the other rows; None where nothing was held back.

    Parameters
    ----------
    equations : sequence of Equation
    tasks : mapping of str to Task
    experiments : Experiments
    partial : bool
        Whether ``train_mse`` stands already, of recordings longer than what is searched.
    """
    out = []
    for equation in equations:
        train = equation.train_mse if partial else _mse(equation, experiments.rows)
        held = _held_back(equation, tasks[equation.state], experiments)
        out.append(replace(equation, train_mse=train, validation_mse=held))
    return out


def _mse(equation: Equation, rows: Samples) -> float:
    with np.errstate(all="ignore"):
        return float(np.mean((rows.targets[equation.state] - equation.predict(rows)) ** 2))


def _held_back(equation: Equation, task: Task, experiments: Experiments) -> float | None:
    train, judge = experiments.train, experiments.judge
    if judge is experiments.rows:
        return None
    if experiments.unseen or not any(not t.given for t in equation.terms):
        value = _mse(equation, judge)
        return value if np.isfinite(value) else None
    terms = [t.term for t in equation.terms if not t.given]
    if any(node.op == "piecewise" for term in terms for node in term.walk()):
        return None  # its modes have errors of their own
    with contextlib.suppress(ArithmeticError, np.linalg.LinAlgError):
        problem = task.problem(train)
        if -1 in problem.index(terms):
            return None
        terms = list(problem.refine(terms)[0])
        weights = problem.fit(terms).coefficients
        fixed = [t for t in equation.terms if t.given]
        every = [t.term for t in fixed] + terms
        every_weight = np.concatenate([[t.coefficient for t in fixed], weights])
        time = next(iter(judge.variables))
        with np.errstate(all="ignore"):
            told = predict(every, every_weight, judge.variables, time=time, group=judge.group)
            value = float(np.mean((judge.targets[equation.state] - told) ** 2))
        return value if np.isfinite(value) else None
    return None
