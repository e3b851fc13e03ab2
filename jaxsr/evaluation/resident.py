"""Columns of terms that stay on a device: a kernel of its own on CUDA, the stack machine elsewhere.

Nothing comes back to the host but what a caller makes of the columns there.
"""

from __future__ import annotations

import functools
import importlib.util
import warnings
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
    """Try one term: packages that do not suit each other fail as late as here."""
    try:
        from numba import cuda

        if not cuda.is_available():
            return False
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it is told below where it does not do
            kernel.tried()
    except Exception as error:
        warnings.warn(f"Numba cannot use the GPU: {error!r:.200}", RuntimeWarning, stacklevel=2)
        return False
    return True


def memory(device: Any) -> int:
    """Return the bytes that JAX may use on a device."""
    facts = device.memory_stats() or {}
    return int(facts.get("bytes_limit", _UNKNOWN))


def most_samples(terms: int, itemsize: int, device: Any) -> int:
    """Return how many samples of so many terms a device holds beside its other work."""
    return max(16, memory(device) // (_ROOM * itemsize * max(terms, 1)))


def padded(count: int, least: int) -> int:
    """Return the first of ``least`` times 1, 4, 16, ... that holds ``count``.

    A device's programs take long to compile, and what is padded costs it little.
    """
    size = least
    while size < count:
        size *= 4
    return size


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
        if self._stream is not None and self._stream.depths.max(initial=0) > kernel.DEPTHS[-1]:
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

        kind, samples = data.dtype.name, data.shape[1]
        if kind not in self._loaded:
            parts = (stream.words, stream.values.astype(kind), stream.starts)
            self._loaded[kind] = tuple(map(cuda.to_device, parts))
        words, values, starts = self._loaded[kind]
        if constants is not None:
            values = cuda.to_device(stream.at(constants).astype(kind))
        with jax.enable_x64(True), jax.default_device(self._device):
            out = jnp.zeros((len(stream), samples), data.dtype)
        # Numba's work does not wait for JAX's, nor JAX's for Numba's
        jax.block_until_ready((data, out))
        read, written = cuda.as_cuda_array(data), cuda.as_cuda_array(out)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*Grid size")  # of what is too small to matter
            for depth, chosen in self._by_depth:
                grid = kernel.grid(len(chosen), samples)
                run = kernel.kernel(depth, kind)[grid, kernel.THREADS]
                run(words, values, starts, chosen, read, written)
        cuda.synchronize()
        return out

    @functools.cached_property
    def _by_depth(self) -> list[tuple[int, Any]]:
        """Return the terms that each depth of stack serves, on the device."""
        from numba import cuda

        assert self._stream is not None
        served = np.searchsorted(kernel.DEPTHS, self._stream.depths)
        return [
            (kernel.DEPTHS[k], cuda.to_device(np.flatnonzero(served == k).astype(np.int32)))
            for k in np.unique(served).tolist()
        ]


def put(values: Array, device: Any) -> jax.Array:
    """Return an array on a device, in its own type."""
    with jax.enable_x64(True):
        return jax.device_put(np.asarray(values), device)


def brought(there: jax.Array) -> Array:
    """Return an array on the host, by way of memory that the device writes to itself."""
    (device,) = there.devices()
    kinds = {kind.kind for kind in device.addressable_memories()}
    if device.platform != "gpu" or "pinned_host" not in kinds:
        return np.asarray(there)
    place = jax.sharding.SingleDeviceSharding(device, memory_kind="pinned_host")
    with jax.enable_x64(True):
        return np.asarray(jax.device_put(there, place))
