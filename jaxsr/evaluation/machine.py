"""The register machine: one compiled loop over instructions that serves every population.

Each instruction is a real branch on a contiguous row of samples, so a node costs one pass over
memory that a cache holds. Instructions, constants and their number are arguments, not structure:
any population whose buffer falls into the same bucket runs the same program.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import NDArray

from jaxsr.evaluation import elementary
from jaxsr.evaluation.schedule import INSTRUCTIONS, Schedule

Array = NDArray[Any]

_LEAST_ROWS, _LEAST_INSTRUCTIONS = 256, 1024


def _branches(samples: int, dtype: Any) -> list[Callable[..., Any]]:
    """Return what each instruction does with (buffer, left, right, immediate)."""

    def row(buffer: Any, place: Any) -> Any:
        return lax.dynamic_slice(buffer, (place, jnp.zeros_like(place)), (1, samples))

    def of(name: str) -> Callable[..., Any]:
        match name:
            case "copy":
                return lambda m, a, b, c: row(m, a)
            case "constant":
                return lambda m, a, b, c: jnp.full((1, samples), c, dtype)
            case "square":
                return lambda m, a, b, c: row(m, a) * row(m, a)
            case "cube":
                return lambda m, a, b, c: row(m, a) * row(m, a) * row(m, a)
        base, _, side = name.partition("_")
        f = elementary.function(base)
        match side:
            case "right":
                return lambda m, a, b, c: f(row(m, a), c)
            case "left":
                return lambda m, a, b, c: f(c, row(m, a))
        if elementary.arity(base) == 1:
            return lambda m, a, b, c: jnp.asarray(f(row(m, a)), dtype)
        return lambda m, a, b, c: jnp.asarray(f(row(m, a), row(m, b)), dtype)

    return [of(name) for name in INSTRUCTIONS]


def _run(buffer: Any, data: Any, first_variable: Any, count: Any, code: Any) -> Any:
    """Write the variables into the buffer (rows, samples), then run ``count`` instructions."""
    operation, left, right, target, immediate = code
    samples = buffer.shape[1]
    branches = _branches(samples, buffer.dtype)
    zero = jnp.zeros((), jnp.int32)
    buffer = lax.dynamic_update_slice(buffer, data, (first_variable, zero))

    def step(k: Any, buffer: Any) -> Any:
        value = lax.switch(operation[k], branches, buffer, left[k], right[k], immediate[k])
        return lax.dynamic_update_slice(buffer, value, (target[k], zero))

    return lax.fori_loop(zero, count, step, buffer)


@functools.cache
def _compiled() -> Any:
    return jax.jit(_run, donate_argnums=0)


def compilations() -> int:
    """Return how many shapes the machine has been compiled for in this process."""
    return int(_compiled()._cache_size())


def bucket(count: int, least: int) -> int:
    """Return the power of two at or above ``count``, at least ``least``."""
    return max(least, 1 << max(count - 1, 0).bit_length())


@dataclass(frozen=True)
class Program:
    """A schedule on a device, padded to its bucket.

    Attributes
    ----------
    schedule : Schedule
    code : tuple of jax.Array, (instructions,)
    rows : int
        Rows of the buffer, a power of two.
    dtype : dtype
    device : jax.Device or None
        None is the default one.
    """

    schedule: Schedule
    code: tuple[Any, ...]
    rows: int
    dtype: Any
    device: Any = None


def load(schedule: Schedule, dtype: Any, device: Any = None) -> Program:
    """Put a schedule's instructions where the machine reads them."""
    length = bucket(len(schedule), _LEAST_INSTRUCTIONS)
    parts = (schedule.code, schedule.left, schedule.right, schedule.target)
    with jax.enable_x64(True), jax.default_device(device):
        code = [jnp.asarray(np.pad(part, (0, length - len(part)))) for part in parts]
        values = np.pad(schedule.immediate, (0, length - len(schedule))).astype(dtype)
        code.append(jnp.asarray(values))
    rows = bucket(schedule.rows + 1, _LEAST_ROWS)  # one more: what a load points at
    return Program(schedule, tuple(code), rows, dtype, device)


class _Buffers:
    """Buffers given back for the next program of the same bucket: fresh memory is slow."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit, self._held = limit_bytes, 0
        self._free: dict[tuple[Any, ...], list[Any]] = {}
        self._lock = threading.Lock()

    def take(self, key: tuple[Any, ...]) -> Any:
        with self._lock:
            waiting = self._free.get(key)
            if waiting:
                buffer = waiting.pop()
                self._held -= buffer.nbytes
                return buffer
        rows, samples, dtype, device = key
        with jax.enable_x64(True), jax.default_device(device):
            return jnp.zeros((rows, samples), dtype)

    def give(self, key: tuple[Any, ...], buffer: Any) -> None:
        with self._lock:
            if self._held + buffer.nbytes > self._limit:
                self._free.clear()
                self._held = 0
            self._free.setdefault(key, []).append(buffer)
            self._held += buffer.nbytes


_BUFFERS = _Buffers(256 * 2**20)


def run(program: Program, data: Array, use: Callable[[Array], Any]) -> Any:
    """Evaluate data (variables, samples) and return ``use`` of the columns (terms, samples).

    The columns are the machine's own memory: ``use`` copies or reduces them before it returns.
    """
    key = (program.rows, data.shape[1], program.dtype, program.device)
    buffer = _BUFFERS.take(key)
    schedule = program.schedule
    with jax.enable_x64(True), jax.default_device(program.device):
        buffer = _compiled()(
            buffer, data, np.int32(schedule.outputs), np.int32(len(schedule)), program.code
        )
        answer = use(np.asarray(buffer)[: schedule.outputs])
    _BUFFERS.give(key, buffer)
    return answer
