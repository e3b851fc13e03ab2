"""Evaluate a batch on any number of samples: chunks of rows that a cache holds, on all cores."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from jaxsr._cores import cores, side_by_side
from jaxsr.evaluation.machine import Program, bucket, load, run
from jaxsr.evaluation.resident import ResidentTerms, brought, most_samples, put
from jaxsr.evaluation.schedule import schedule
from jaxsr.expressions.postfix import PostfixBatch

Array = NDArray[Any]
Use = Callable[[Array, slice, slice], Any]

_MOST_TERMS = 65536  # in one schedule, which bounds a thread's instructions
_WINDOW = 1024  # outputs taken at a time: what a core's cache holds beside the registers
_SHARED = 3_000_000  # samples times instructions from which on threads repay their change
_ROOM = 8  # instructions for a column, where one program is to serve all batches


@dataclass(frozen=True, slots=True)
class EngineConfig:
    """How a batch is evaluated.

    Parameters
    ----------
    threads : int, optional
        Chunks evaluated at a time; by default one for each core this process may use.
    chunk : int
        Most samples evaluated at a time; a power of two. On a CPU long enough to hide the cost of
        an instruction, short enough for a core's cache; elsewhere what the device's memory holds,
        and less where that is taken.
    device : jax.Device, optional
        Where; JAX's default device when None.
    window : int, optional
        Columns taken at a time; a power of two. By default what suits the batch. With a given one
        batches of any size run the same compiled program, as long as their instructions fit.
    """

    threads: int | None = None
    chunk: int | None = None
    device: Any = None
    window: int | None = None

    def __post_init__(self) -> None:
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"`threads` must be at least 1, got {self.threads}")
        if self.chunk is not None and (self.chunk < 16 or self.chunk & (self.chunk - 1)):
            raise ValueError(f"`chunk` must be a power of two from 16 on, got {self.chunk}")
        if self.window is not None and (self.window < 16 or self.window & (self.window - 1)):
            raise ValueError(f"`window` must be a power of two from 16 on, got {self.window}")

    @property
    def platform(self) -> str:
        """Return ``cpu``, ``gpu``, ..."""
        return self.device.platform if self.device is not None else jax.default_backend()

    @property
    def resident(self) -> bool:
        """Tell whether columns are made and kept on a device with a memory of its own."""
        return self.platform != "cpu"

    @property
    def place(self) -> Any:
        """Return the device."""
        return self.device or jax.devices()[0]

    @property
    def workers(self) -> int:
        """Return how many chunks are evaluated at a time."""
        if self.resident:
            return 1
        return self.threads or cores()

    def samples(self, rows: int) -> int:
        """Return how many samples are evaluated at a time where there are ``rows``."""
        most = self.chunk or 1024
        return bucket(min(rows, most), min(128, most))


class Engine:
    """A batch's schedules, made when first needed and kept.

    Parameters
    ----------
    batch : PostfixBatch
    config : EngineConfig
    """

    def __init__(self, batch: PostfixBatch, config: EngineConfig | None = None) -> None:
        self._batch = batch
        self._config = config or EngineConfig()
        self._programs = functools.cache(self._loaded)

    def __len__(self) -> int:
        return len(self._batch)

    @property
    def unique_fraction(self) -> float:
        """Distinct inner nodes, which are computed, over all inner nodes."""
        programs = [program.schedule for _, program in self._programs(self._parts(1), "float32")]
        inner = sum(s.inner_nodes for s in programs)
        return sum(s.unique_nodes for s in programs) / inner if inner else 1.0

    def columns(self, data: Array, out: Array | None = None) -> Array:
        """Return the columns (terms, samples) of data (variables, samples), in its type."""
        if out is None:
            out = np.empty((len(self._batch), data.shape[1]), data.dtype)

        def keep(block: Array, terms: slice, samples: slice) -> None:
            out[terms, samples] = block

        self.each(data, keep)
        return out

    def each(
        self, data: Array, use: Use, *, whole: bool = False, constants: Array | None = None
    ) -> list[Any]:
        """Call ``use(block, terms, samples)`` on blocks of columns; return what it returned.

        A block (terms, samples) is the machine's own memory. Blocks come from several threads at
        once, and are never all held: this is how to reduce a library that does not fit in memory.
        The answers are ordered by samples, then terms, whatever thread was first.

        Parameters
        ----------
        data : ndarray, (variables, samples)
        use : callable
        whole : bool
            Whether terms stay together, however few the samples: blocks then hold as many terms
            as a window.
        constants : ndarray, (constants,), optional
            Values of the batch's open constants, see :class:`jaxsr.evaluation.open.OpenTerms`.
        """
        size = self._config.samples(data.shape[1])
        if self._config.resident:
            size = self._config.chunk or self._held(data)
        while True:
            try:
                if self._config.resident:
                    return self._on_device(data, use, size, constants)
                return self._each(data, use, size, whole, constants)
            except jax.errors.JaxRuntimeError as error:
                if "RESOURCE_EXHAUSTED" not in str(error) or size <= 16:
                    raise
                size //= 2

    def resident(self, data: jax.Array, constants: Array | None = None) -> jax.Array:
        """Return the columns (terms, samples) of data (variables, samples) on the device."""
        if not len(self._batch):
            with jax.enable_x64(True):
                return jax.numpy.zeros((0, data.shape[1]), data.dtype)
        return self._terms_there.columns(data, constants)

    @property
    def is_resident(self) -> bool:
        """Tell whether the batch is evaluated on a device with a memory of its own."""
        return self._config.resident

    def reduced(self, data: Array, use: Callable[[jax.Array, slice], Any]) -> list[Any]:
        """Return what ``use(columns, samples)`` makes of each chunk of columns on the device.

        Chunks hold as many samples as the device's memory does; smaller ones are tried where it
        has less.

        Parameters
        ----------
        data : ndarray, (variables, samples)
        use : callable
            Gets columns (terms, samples of the chunk), which lie on the device.
        """
        size, there = self._held(data), put(data, self._config.place)
        while True:
            try:
                return [
                    use(self.resident(there[:, start : start + size]), slice(start, start + size))
                    for start in range(0, data.shape[1], size)
                ]
            except jax.errors.JaxRuntimeError as error:
                if "RESOURCE_EXHAUSTED" not in str(error) or size <= 16:
                    raise
                size //= 2

    @functools.cached_property
    def _terms_there(self) -> ResidentTerms:
        return ResidentTerms(self._batch, self._config.place)

    def _held(self, data: Array) -> int:
        """Return how many samples the device holds at once: all of them, mostly."""
        most = most_samples(len(self._batch), data.dtype.itemsize, self._config.place)
        return min(data.shape[1], 1 << most.bit_length() - 1)

    def _on_device(self, data: Array, use: Use, size: int, constants: Array | None) -> list[Any]:
        """Make columns on the device, by chunks that it holds, and bring them to the host."""
        terms, answers = slice(0, len(self._batch)), []
        if not len(self._batch):
            return answers
        for start in range(0, data.shape[1], size):
            part = slice(start, min(start + size, data.shape[1]))
            there = put(data[:, part], self._config.place)
            block = brought(self.resident(there, constants))
            answers.append(use(block, terms, part))
        return answers

    def _each(
        self, data: Array, use: Use, size: int, whole: bool, constants: Array | None
    ) -> list[Any]:
        rows = data.shape[1]
        if not len(self._batch) or not rows:
            return []
        starts = range(0, rows, size)
        # few samples: terms are shared among the threads instead
        shares = 1 if whole or len(starts) >= self._config.workers else self._config.workers
        programs = self._programs(self._parts(shares), data.dtype.name)
        if constants is not None:
            programs = [(terms, program.at(constants)) for terms, program in programs]

        def one(job: tuple[int, slice, Program]) -> list[Any]:
            start, terms, program = job
            stop = min(start + size * together, rows)

            def took(chunk: int, block: Array, own: slice) -> Any:
                first = start + chunk * size
                last = min(first + size, stop)
                place = slice(terms.start + own.start, terms.start + own.stop)
                return use(block[:, : last - first], place, slice(first, last))

            return run(program, _chunks(data[:, start:stop], size), took)

        # few terms: several chunks at a time, or calling would cost as much as computing
        together = 1
        if self._config.window is None:
            together = _together(programs, len(starts) // self._config.workers)
        jobs = [(start, *piece) for start in starts[::together] for piece in programs]
        work = rows * sum(len(program.schedule) for _, program in programs)
        answers = side_by_side(one, jobs, self._config.workers if work >= _SHARED else 1)
        return list(itertools.chain.from_iterable(answers))

    def _parts(self, shares: int) -> int:
        """Return how many schedules the terms are divided into."""
        needed = -(-len(self._batch) // _MOST_TERMS)
        return max(needed, min(shares, len(self._batch)))

    def _loaded(self, parts: int, dtype: str) -> Sequence[tuple[slice, Program]]:
        count = len(self._batch)
        bounds = [count * k // parts for k in range(parts + 1)]
        pieces = [slice(a, b) for a, b in itertools.pairwise(bounds)]

        def one(piece: slice) -> tuple[slice, Program]:
            batch = self._batch
            code = (batch.opcode[piece], batch.operand[piece], batch.constants[piece])
            part = PostfixBatch(*code, batch.variables)
            # terms shared among threads mean few samples: then the smaller window wins
            most = _WINDOW if parts == 1 else _WINDOW // 2
            window = self._config.window
            plan = schedule(part, window or min(most, bucket(len(part), 16)))
            room = 0 if window is None else _ROOM * window
            return piece, load(plan, np.dtype(dtype), self._config.device, room)

        return side_by_side(one, pieces, self._config.workers)


def _together(programs: Sequence[tuple[slice, Program]], most: int) -> int:
    """Return how many chunks to evaluate in one call: a power of two."""
    plans = [program.schedule for _, program in programs]
    if any(len(plan.ends) > 1 for plan in plans):
        return 1
    room = _WINDOW // max(plan.window for plan in plans)
    return 1 << max(min(room, most), 1).bit_length() - 1


def _chunks(data: Array, samples: int) -> Array:
    """Return data (variables, rows) as (chunks, variables, samples), the last sample repeated."""
    variables, rows = max(len(data), 1), data.shape[1]
    count = -(-rows // samples)
    out = np.zeros((count, variables, samples), data.dtype)
    for chunk in range(count if len(data) else 0):
        part = data[:, chunk * samples : (chunk + 1) * samples]
        out[chunk, :, : part.shape[1]] = part
        out[chunk, :, part.shape[1] :] = part[:, -1:]
    return out
