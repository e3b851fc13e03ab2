"""Raw evaluation on one GPU, as a share of what its memory allows, and where it passes the CPU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxsr
from benchmarks.throughput_cases import VARIABLES, Population, random_population, samples
from benchmarks.timing import repeated, spread

Device = Any  # jax.Device is a variable to a type checker
COPY_BYTES = 2**28
ANSWER = 60_000_000  # terms x rows


def measure(terms: int, rows: Sequence[int], repeats: int) -> dict[str, Any]:
    """Measure where JAX sees a GPU; say so where it sees none.

    The bound is traffic that no machine avoids: the data read once and the answer written once,
    at the bandwidth of a copy on the same device.
    """
    devices = [device for device in jax.devices() if device.platform == "gpu"]
    if not devices:
        print("no GPU at hand: nothing measured")
        return {"measured": False, "reason": "JAX saw no GPU on this machine"}
    return compare(devices[0], jax.local_devices(backend="cpu")[0], terms, rows, repeats)


def compare(
    device: Device, cpu: Device, terms: int, rows: Sequence[int], repeats: int
) -> dict[str, Any]:
    """Return rates of both devices and the share of the first one's bandwidth."""
    bandwidth = _bandwidth(device, repeats)
    drawn = random_population(np.random.default_rng(0), terms)
    points = [_point(drawn, n, repeats, device, cpu, bandwidth) for n in rows]
    faster = [p["rows"] for p in points if p["gpu"]["median"] > p["cpu"]["median"]]
    return {
        "measured": True,
        "device": device.device_kind,
        "copy_bytes_per_second": bandwidth,
        "points": points,
        "crossover_rows": min(faster, default=None),
    }


def _bandwidth(device: Device, repeats: int) -> float:
    """Return bytes read and written a second by a copy."""
    x = jax.device_put(jnp.zeros(COPY_BYTES // 4, jnp.float32), device)
    copy = jax.jit(lambda a: a + 1.0)
    times = repeated(lambda: copy(x).block_until_ready(), max(7, repeats))
    return 2.0 * COPY_BYTES / float(np.median(times))


def _point(
    drawn: Population, rows: int, repeats: int, gpu: Device, cpu: Device, bandwidth: float
) -> dict[str, Any]:
    population = drawn.first(ANSWER // rows)
    data, work = samples(rows), population.nodes * rows
    out: dict[str, Any] = {"rows": rows, "terms": len(population.terms)}
    for name, device in (("gpu", gpu), ("cpu", cpu)):
        with jax.default_device(device):
            batch = jaxsr.compile_terms(population.terms, VARIABLES)
            times = np.array(repeated(lambda batch=batch: batch.evaluate(data), repeats))
        out[name] = asdict(spread(work / times))
    traffic = 4.0 * rows * (len(population.terms) + len(VARIABLES))
    out["share_of_bandwidth_bound"] = out["gpu"]["median"] / (work * bandwidth / traffic)
    print(
        f"{rows:8} rows: GPU {out['gpu']['median'] / 1e9:.2f}, CPU {out['cpu']['median'] / 1e9:.2f}"
        f" G node-rows/s, {out['share_of_bandwidth_bound']:.1%} of the bandwidth bound",
        flush=True,
    )
    return out
