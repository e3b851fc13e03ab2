"""What is believed of the constants of a set before the recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.diagnosis.likelihood.estimate import Belief
from jaxsr.diagnosis.likelihood.table import Table
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.candidate import UNLIMITED
from jaxsr.diagnosis.mechanisms.super_model import SuperModel


def belief_of(work: Workspace, table: Table, chosen: Sequence[int], theta: np.ndarray) -> Belief:
    """Beliefs of parameters of the super-model: those of the table, where it has them."""
    names = list(work.super_model.model.parameters)
    parameters = list(work.super_model.model.parameters.values())
    rows = []
    for j in chosen:
        if names[j] in table.names:
            k, known = table.names[names[j]], table.belief
            rows.append((known.mean[k], known.deviation[k], known.low[k], known.high[k]))
            continue
        low, high = parameters[j].bounds or (-UNLIMITED, UNLIMITED)
        value = theta[j]
        size = abs(value) if value else min(high - low, 1.0)
        rows.append((value, size, low - 1e-12 * size, high + 1e-12 * size))
    columns = np.array(rows, dtype=float).reshape(-1, 4).T
    mean, deviation, low, high = columns
    floors = _floors(work.super_model, chosen)
    return Belief(mean, deviation, low, high, floors)


def _floors(model: SuperModel, chosen: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Return which chosen constants are never below which other ones, by their places."""
    names, at = list(model.model.parameters), {j: k for k, j in enumerate(chosen)}
    place = {name: at[j] for j, name in enumerate(names) if j in at}
    return tuple(
        (place[own[spec.name]], place[own[spec.floor]])
        for candidate, own in zip(model.candidates, model.names, strict=True)
        for spec in candidate.parameters
        if spec.floor in own and {own[spec.name], own[spec.floor]} <= place.keys()
    )
