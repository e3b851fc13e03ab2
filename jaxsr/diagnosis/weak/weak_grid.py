"""Test functions over all recordings, and which of them every equation can be held against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jaxsr.models.balance import Balance
from jaxsr.models.model import Model
from jaxsr.models.segments import Prepared
from jaxsr.views import WeakView


@dataclass(frozen=True, eq=False)
class WeakGrid:
    """Place test functions over recordings whose sensors may drop samples, each at its own times.

    A row is a test function whose support lies in a recording without a break in its time. An
    equation has that row where every state that stands in it is known all along the support:
    measured, or missing between near neighbours, where the sensor's own samples tell it.

    Attributes
    ----------
    model : Model
        The model whose equations are held against the rows.
    prepared : tuple of Prepared
    half_width : float
        Half the support of a test function, in s.
    views : tuple of (WeakView or None)
        None for a recording that is shorter than one support.
    """

    model: Model
    prepared: tuple[Prepared, ...]
    half_width: float
    views: tuple[WeakView | None, ...]

    @staticmethod
    def build(
        model: Model,
        prepared: Sequence[Prepared],
        half_width: float,
        spacing: float | None = None,
    ) -> WeakGrid:
        """Place test functions of one width over every recording that holds one."""
        views = tuple(
            WeakView.build(item.time, half_width, spacing or half_width / 4)
            if 2.0 * half_width <= item.time[-1] - item.time[0]
            else None
            for item in prepared
        )
        return WeakGrid(model, tuple(prepared), half_width, views)

    @cached_property
    def edges(self) -> np.ndarray:
        """First sample of every recording in the samples of all, and their number."""
        return np.cumsum([0, *(item.time.size for item in self.prepared)])

    @cached_property
    def first(self) -> np.ndarray:
        """First row of every recording, and the number of rows."""
        return np.cumsum([0, *(0 if v is None else int(v.valid.sum()) for v in self.views)])

    @cached_property
    def centre(self) -> np.ndarray:
        """Centres of all rows in s, shape (rows,)."""
        parts = [view.centres[view.valid] for view in self.views if view is not None]
        return np.concatenate([np.zeros(0), *parts])

    def integrate(self, columns: np.ndarray) -> np.ndarray:
        """Return the rows of signals along all recordings, shape (rows,) or (rows, columns)."""
        parts = [np.zeros((0, *columns.shape[1:]))]
        for view, a, b in zip(self.views, self.edges[:-1], self.edges[1:], strict=True):
            if view is not None:
                parts.append(view.integrate(columns[a:b])[view.valid])
        return np.concatenate(parts)

    def known(self, number: int, state: str) -> np.ndarray:
        """Return which rows of one recording the equation of `state` has, shape (rows,)."""
        view, estimate = self.views[number], self.prepared[number].states
        if view is None:
            return np.zeros(0, bool)
        used = used_states(self.model, state)
        if used & estimate.hidden:
            return np.zeros(int(view.valid.sum()), bool)
        present = np.ones(view.time.size, bool)
        for name in used & estimate.seen.keys():
            present &= estimate.seen[name]
        return view.covered(present)[view.valid]

    @property
    def observable(self) -> tuple[str, ...]:
        """Dynamic states whose equation has rows."""
        return tuple(
            state
            for state in self.model.dynamic_states
            if any(self.known(r, state).any() for r in range(len(self.views)))
        )

    def observable_in(self, model: Model) -> tuple[str, ...]:
        """Observable states whose equation in an edit of the model needs no hidden state."""
        hidden = set().union(*(item.states.hidden for item in self.prepared))
        return tuple(s for s in self.observable if not used_states(model, s) & hidden)


def used_states(model: Model, state: str) -> set[str]:
    """Return the states that stand in the equation of `state`, with those that it accelerates."""
    used, balance = set(model.equation_terms[state].variables) | {state}, Balance.of(model)
    if balance is not None and state in balance.states:
        beside = balance.row(state)
        used |= set(beside).union(*(model.equation_terms[s].variables for s in beside))
    for column, term in model.inertia_terms.get(state, {}).items():
        used |= term.variables | {column}
    return used & set(model.states)
