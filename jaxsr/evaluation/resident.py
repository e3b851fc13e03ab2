"""Columns of terms that stay on a device: a kernel of its own on CUDA, the stack machine elsewhere.

Nothing comes back to the host but what a caller makes of the columns there.
"""

from __future__ import annotations

import functools
import importlib.util
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxsr.evaluation import kernel
from jaxsr.evaluation.interpreter import interpreted
from jaxsr.evaluation.stream import Stream, streamed
from jaxsr.expressions.postfix import PostfixBatch

Array = NDArray[Any]

_ROOM = 4  # a device's memory over that of one answer
_UNKNOWN = 2**31  # bytes, where a device does not say what it has


def has_kernel() -> bool:
    """Tell whether Numba can compile for CUDA here."""
    return importlib.util.find_spec("numba") is not None and _has_cuda()


@functools.cache
def _has_cuda() -> bool:
    from numba import cuda

    return bool(cuda.is_available())


def memory(device: Any) -> int:
    """Return the bytes that JAX may use on a device."""
    facts = device.memory_stats() or {}
    return int(facts.get("bytes_limit", _UNKNOWN))


def most_samples(terms: int, itemsize: int, device: Any) -> int:
    """Return how many samples of so many terms a device holds beside its other work."""
    return max(16, memory(device) // (_ROOM * itemsize * max(terms, 1)))


class ResidentTerms:
    """A batch of terms, its code on a device.

    Parameters
    ----------
    batch : PostfixBatch
        Constants may be open, see :class:`jaxsr.evaluation.open.OpenTerms`.
    device : jax.Device
    """

    def __init__(self, batch: PostfixBatch, device: Any) -> None:
        self._batch, self._device = batch, device
        self._loaded: dict[str, tuple[Any, ...]] = {}
        self._stream = streamed(batch) if device.platform == "gpu" and has_kernel() else None
        if self._stream is not None and self._stream.depth > kernel.DEEPEST:
            self._stream = None

    def __len__(self) -> int:
        return len(self._batch)

    def columns(self, data: jax.Array, constants: Array | None = None) -> jax.Array:
        """Return the columns (terms, samples) of data (variables, samples), on the device.

        Parameters
        ----------
        data : jax.Array, (variables, samples)
            float32 or float64, on the device.
        constants : ndarray, (constants,), optional
            Values of the open constants.
        """
        if self._stream is None:
            return interpreted(self._batch, data, constants)
        return self._launched(self._stream, data, constants)

    def _launched(self, stream: Stream, data: jax.Array, constants: Array | None) -> jax.Array:
        from numba import cuda

        kind = data.dtype.name
        if kind not in self._loaded:
            parts = (stream.words, stream.values.astype(kind), stream.starts)
            self._loaded[kind] = tuple(map(cuda.to_device, parts))
        words, values, starts = self._loaded[kind]
        if constants is not None:
            values = cuda.to_device(stream.at(constants).astype(kind))
        samples = data.shape[1]
        with jax.enable_x64(True), jax.default_device(self._device):
            out = jnp.zeros((len(stream), samples), data.dtype)
        # Numba's work does not wait for JAX's, nor JAX's for Numba's
        jax.block_until_ready((data, out))
        depth = 4 if stream.depth <= 4 else kernel.DEEPEST
        run = kernel.kernel(depth, kind)[kernel.grid(len(stream), samples), kernel.THREADS]
        run(words, values, starts, cuda.as_cuda_array(data), cuda.as_cuda_array(out))
        cuda.synchronize()
        return out


def put(values: Array, device: Any) -> jax.Array:
    """Return an array on a device, in its own type."""
    with jax.enable_x64(True):
        return jax.device_put(np.asarray(values), device)
