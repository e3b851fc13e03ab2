"""Unit-norm columns of terms that stay on a device, where their products are taken."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsr.evaluation.resident import memory, padded, put
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array, bucket
from jaxsr.regression.products import Places, slots_of
from jaxsr.regression.ridge import solve_many
from jaxsr.regression.store import CORRECTIONS, DAMPING, SMALL, usable_sizes

_TOGETHER = 1024  # columns made in one call, where an eighth of the room holds them
_PRODUCTS = 2**27  # pairs times rows of a call
_SHARE = 0.6  # of the device's memory that columns may take
_MOST, _LEAST = 8192, 4096  # columns there is room for; what a population needs at a time


@functools.cache
def _added() -> Any:
    def add(
        store: jax.Array, start: jax.Array, columns: jax.Array, target: jax.Array
    ) -> tuple[jax.Array, ...]:
        largest = jnp.max(jnp.abs(columns), axis=1)
        square = jnp.einsum("kr,kr->k", columns, columns)
        norm = jnp.sqrt(jnp.where((square > 0.0) & jnp.isfinite(square), square, 1.0))
        unit = columns / norm[:, None]
        store = jax.lax.dynamic_update_slice(store, unit, (start, jnp.zeros_like(start)))
        return store, largest, norm, unit @ target

    return jax.jit(add, donate_argnums=0)


@functools.cache
def _multiplied() -> Any:
    return jax.jit(lambda c, i, j: jnp.einsum("pr,pr->p", c[i], c[j]))


@functools.cache
def _left() -> Any:
    def left(
        store: jax.Array, target: jax.Array, places: jax.Array, xi: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        theta = store[places]
        residual = target - jnp.einsum("sk,skr->sr", xi, theta)
        return jnp.einsum("sr,sr->s", residual, residual), jnp.einsum("skr,sr->sk", theta, residual)

    return jax.jit(left)


def room(rows: int, device: Any) -> int:
    """Return how many columns a device's memory holds."""
    return min(_MOST, int(_SHARE * memory(device) / (8 * rows)))


def has_room(rows: int, device: Any) -> bool:
    """Tell whether a population's columns fit into a device's memory."""
    return room(rows, device) >= _LEAST


class ResidentStore:
    """Columns of terms on a device, each divided by its norm; only products come back.

    Parameters
    ----------
    columns_of : callable
        Terms to their columns (terms or more, rows) on the device.
    admits : callable or None
        Whether a term may be used at all; None for all.
    target : ndarray, (rows,)
    device : jax.Device
    """

    def __init__(
        self,
        columns_of: Callable[[Sequence[Term]], jax.Array],
        admits: Callable[[Term], bool] | None,
        target: Array,
        device: Any,
    ) -> None:
        self._columns_of, self._admits, self._device = columns_of, admits, device
        self._rows = len(target)
        self.target = put(target, device)
        self._capacity = room(self._rows, device)
        self._step = min(_TOGETHER, max(16, 1 << (self._capacity // 8).bit_length() - 1))
        self.epoch = 0
        self.forget()

    def forget(self) -> None:
        """Drop every column."""
        self._norms: list[float] = []
        self._moments: list[float] = []
        self._moment = np.zeros(0)
        self._index: dict[Term, int] = {}
        self._store: jax.Array | None = None
        self.epoch += 1

    @property
    def store(self) -> jax.Array:
        """Return the unit columns (room, rows)."""
        if self._store is None:  # all at once: one shape, for which programs are made
            with jax.enable_x64(True), jax.default_device(self._device):
                self._store = jnp.zeros((self._capacity, self._rows))
        return self._store

    def norms(self, places: Sequence[int]) -> Array:
        """Return what the columns were divided by."""
        return np.array([self._norms[k] for k in places])

    def moments(self) -> Array:
        """Return the products of all columns with the target."""
        if len(self._moment) != len(self._moments):
            self._moment = np.array(self._moments)
        return self._moment

    def index(self, terms: Sequence[Term]) -> list[int]:
        """Return where each term's column is held; -1 for a term that cannot be used."""
        known = self._index
        try:
            return [known[term] for term in terms]
        except KeyError:
            pass
        new = [term for term in dict.fromkeys(terms) if term not in known]
        if len(self._moments) + len(new) + self._step > self._capacity:
            self.forget()
            new = list(dict.fromkeys(terms))
        if self._admits is not None:
            self._index.update((term, -1) for term in new if not self._admits(term))
            new = [term for term in new if term not in self._index]
        for start in range(0, len(new), self._step):
            self._add(new[start : start + self._step])
        return [self._index[term] for term in terms]

    def _add(self, terms: Sequence[Term]) -> None:
        start = len(self._moments)
        with jax.enable_x64(True):
            columns = self._columns_of(terms)
            if start + len(columns) > len(self.store):  # one call needs more than there is room
                more = jnp.zeros((max(len(columns), self._capacity // 4), self._rows))
                self._store = jnp.concatenate([self.store, more])
            self._store, *facts = _added()(self.store, np.int32(start), columns, self.target)
            largest, norms, moments = (np.asarray(f)[: len(terms)] for f in facts)
        usable = usable_sizes(largest)
        # places are taken by unusable columns too: nobody is told of them
        places = np.where(usable, start + np.arange(len(terms)), -1)
        self._index.update(zip(terms, places.tolist(), strict=True))
        self._norms += norms.tolist()
        self._moments += moments.tolist()

    def products(self, first: Places, second: Places) -> Array:
        """Return the products of pairs of columns."""
        out = np.empty(len(first))
        step = max(256, 1 << max(_PRODUCTS // self._rows, 1).bit_length() - 1)
        with jax.enable_x64(True):
            waiting = []
            for start in range(0, len(first), step):
                part = slice(start, min(start + step, len(first)))
                size = min(step, padded(part.stop - start, 256))
                pair = np.zeros((2, size), np.int32)
                pair[0, : part.stop - start] = first[part]
                pair[1, : part.stop - start] = second[part]
                waiting.append((part, _multiplied()(self.store, *pair)))
            for part, found in waiting:
                out[part] = np.asarray(found)[: part.stop - part.start]
        return out

    def exact_losses(
        self, sets: Sequence[Sequence[int]], shares: Sequence[Array], grams: Sequence[Array]
    ) -> Array:
        """Return residual sums of squares, from the residuals themselves.

        As :func:`jaxsr.regression.store.refined_loss`, of many sets at a time.
        """
        count, width = len(sets), bucket(max(map(len, sets), default=1))
        slots, packed = np.full((count, width), -1), slots_of(sets)
        slots[:, : packed.shape[1]] = packed
        xi, damped = np.zeros((count, width)), np.tile(np.eye(width), (count, 1, 1))
        for row, (share, gram) in enumerate(zip(shares, grams, strict=True)):
            size = len(share)
            xi[row, :size] = share
            damped[row, :size, :size] = gram + DAMPING * np.eye(size)
        least, live = np.full(count, np.inf), np.ones(count, dtype=bool)
        for _ in range(CORRECTIONS):
            at = np.flatnonzero(live)
            if not len(at):
                break
            loss, slope = self._residuals(slots[at], xi[at])
            step = solve_many(damped[at], slope)
            gain = np.einsum("sk,sk->s", slope, step) + DAMPING * np.einsum("sk,sk->s", step, step)
            lower = loss < least[at]
            final = lower & (gain < SMALL * loss)
            least[at] = np.where(lower, np.where(final, loss - gain, loss), least[at])
            xi[at] += step
            live[at] = lower & ~final
        return least

    def _residuals(self, slots: Places, xi: Array) -> tuple[Array, Array]:
        """Return squares of residuals (sets,) and their products with the columns."""
        used = slots >= 0
        step = min(256, max(4, _PRODUCTS // (self._rows * slots.shape[1])))
        loss, slope = np.empty(len(slots)), np.empty(slots.shape)
        for part in _pieces(len(slots), step):
            size = min(step, padded(part.stop - part.start, 4))
            places = np.zeros((size, slots.shape[1]), np.int32)
            own = np.zeros(places.shape)
            places[: part.stop - part.start] = np.where(used[part], slots[part], 0)
            own[: part.stop - part.start] = np.where(used[part], xi[part], 0.0)
            with jax.enable_x64(True):
                found = _left()(self.store, self.target, places, own)
                loss[part], slope[part] = (np.asarray(f)[: part.stop - part.start] for f in found)
        return loss, np.where(used, slope, 0.0)


def _pieces(count: int, step: int) -> Iterator[slice]:
    for start in range(0, count, step):
        yield slice(start, min(start + step, count))
