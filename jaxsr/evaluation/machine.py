"""The register machine: one compiled loop over instructions that serves every population.

Each instruction is a real branch on a contiguous row of samples, so a node costs one pass over
memory that a cache holds. Instructions, constants and their number are arguments, not structure:
any population whose buffer falls into the same bucket runs the same program.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
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


def _at(values: Any, k: Any) -> Any:
    return lax.dynamic_index_in_dim(values, k, keepdims=False)


def _branches(samples: int, dtype: Any) -> list[Callable[..., Any]]:
    """Return what each instruction does with (buffer, k, left, right, immediate, row map).

    The operands are looked up inside the branch, where the compiler joins that to the arithmetic.
    """
    zero = np.int32(0)

    def row(buffer: Any, places: Any, k: Any, moved: Callable[[Any], Any]) -> Any:
        return lax.dynamic_slice(buffer, (moved(_at(places, k)), zero), (1, samples))

    def of(name: str) -> Callable[..., Any]:
        match name:
            case "copy":
                return lambda m, k, a, b, c, to: row(m, a, k, to)
            case "constant":
                return lambda m, k, a, b, c, to: jnp.full((1, samples), _at(c, k), dtype)
            case "square":
                return lambda m, k, a, b, c, to: row(m, a, k, to) ** 2
            case "cube":
                return lambda m, k, a, b, c, to: row(m, a, k, to) ** 3
        base, _, side = name.partition("_")
        f = elementary.function(base)
        match side:
            case "right":
                return lambda m, k, a, b, c, to: f(row(m, a, k, to), _at(c, k))
            case "left":
                return lambda m, k, a, b, c, to: f(_at(c, k), row(m, a, k, to))
        if elementary.arity(base) == 1:
            return lambda m, k, a, b, c, to: jnp.asarray(f(row(m, a, k, to)), dtype)
        return lambda m, k, a, b, c, to: jnp.asarray(f(row(m, a, k, to), row(m, b, k, to)), dtype)

    return [of(name) for name in INSTRUCTIONS]


def _run(buffer: Any, data: Any, window: Any, start: Any, stop: Any, code: Any) -> Any:
    """Run some instructions on each chunk of data (chunks, variables, samples).

    The buffer's first rows are the outputs, ``window`` for each chunk; variables and registers
    behind them serve one chunk after the other.
    """
    operation, left, right, target, immediate = code
    chunks, zero = data.shape[0], np.int32(0)
    functions = _branches(buffer.shape[1], buffer.dtype)

    def on(chunk: Any, buffer: Any) -> Any:
        def moved(row: Any, chunk: Any) -> Any:
            if chunks == 1:
                return row
            return row + window * jnp.where(row < window, chunk, np.int32(chunks - 1))

        def branch(function: Callable[..., Any]) -> Callable[..., Any]:
            return lambda m, k, j, a, b, c: function(m, k, a, b, c, lambda row: moved(row, j))

        branches = [branch(function) for function in functions]
        samples = lax.dynamic_index_in_dim(data, chunk, keepdims=False)
        buffer = lax.dynamic_update_slice(buffer, samples, (window * chunks, zero))

        def step(k: Any, buffer: Any) -> Any:
            operands = (buffer, k, chunk, left, right, immediate)
            value = lax.switch(_at(operation, k), branches, *operands)
            return lax.dynamic_update_slice(buffer, value, (moved(_at(target, k), chunk), zero))

        return lax.fori_loop(start, stop, step, buffer)

    if chunks == 1:
        return on(zero, buffer)
    return lax.fori_loop(zero, np.int32(chunks), on, buffer)


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
    dtype : dtype
    device : jax.Device or None
        None is the default one.
    """

    schedule: Schedule
    code: tuple[Any, ...]
    dtype: Any
    device: Any = None

    def at(self, constants: Array) -> Program:
        """Return the program with open constants (see ``evaluation.open``) at these values."""
        plan = self.schedule
        values = np.zeros(len(self.code[-1]), self.dtype)
        values[: len(plan)] = plan.immediate
        values[plan.open] = constants[plan.number[plan.open]]
        with jax.enable_x64(True), jax.default_device(self.device):
            return replace(self, code=(*self.code[:-1], jnp.asarray(values)))


def load(schedule: Schedule, dtype: Any, device: Any = None, room: int = 0) -> Program:
    """Put a schedule's instructions where the machine reads them.

    ``room`` is the least number of instructions that the program is made for.
    """
    length = bucket(len(schedule), max(_LEAST_INSTRUCTIONS, room))
    parts = (schedule.code, schedule.left, schedule.right, schedule.target)
    with jax.enable_x64(True), jax.default_device(device):
        code = [jnp.asarray(np.pad(part, (0, length - len(part)))) for part in parts]
        values = np.pad(schedule.immediate, (0, length - len(schedule))).astype(dtype)
        code.append(jnp.asarray(values))
    return Program(schedule, tuple(code), dtype, device)


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


def _seen(buffer: Any) -> Array:
    """Return the buffer's memory without a copy where the device is the host.

    ``np.asarray`` would leave a view with the JAX array, and a donated buffer of which anyone
    holds a view is copied.
    """
    return np.from_dlpack(buffer) if buffer.device.platform == "cpu" else np.asarray(buffer)


_BUFFERS = _Buffers(256 * 2**20)


def run(program: Program, data: Array, use: Callable[[int, Array, slice], Any]) -> list[Any]:
    """Evaluate data (chunks, variables, samples); return what ``use`` makes of each segment.

    ``use`` gets a chunk's number, columns (terms, samples), and which terms they are. The columns
    are the machine's own memory: it copies or reduces them before it returns. Several chunks go
    together only where the schedule has one segment.
    """
    schedule, answers = program.schedule, []
    window, start, chunks = schedule.window, 0, len(data)
    rows = bucket(schedule.rows + (chunks - 1) * window, _LEAST_ROWS)
    key = (rows, data.shape[2], program.dtype, program.device)
    buffer = _BUFFERS.take(key)
    with jax.enable_x64(True), jax.default_device(program.device):
        values = jnp.asarray(data)
        for segment, stop in enumerate(schedule.ends):
            limits = (np.int32(window), np.int32(start), np.int32(stop))
            buffer = _compiled()(buffer, values, *limits, program.code)
            columns = _seen(buffer)
            terms = slice(segment * window, min((segment + 1) * window, schedule.outputs))
            for chunk in range(chunks):
                first = chunk * window
                answers.append(use(chunk, columns[first : first + terms.stop - terms.start], terms))
            start = stop
            del columns  # a view that is still held keeps the next call from writing in place
    _BUFFERS.give(key, buffer)
    return answers
