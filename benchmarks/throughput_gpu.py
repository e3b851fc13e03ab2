"""One GPU: raw evaluation beside its memory bound and the CPU, generations, too large an answer.

``python -m benchmarks.throughput_gpu [--quick]`` measures where JAX sees a GPU and says so where
it sees none. Node-rows a second, float32, at 10^4, 10^5 and 10^6 rows, as
``benchmarks.throughput`` counts them: columns left on the device, brought to the host, and by the
CPU of the same machine, all its cores. The bound is traffic that no machine avoids, data read once
and columns written once, at the bandwidth of a copy on the same device. A generation is all of
``evolution.loop.step``, ridge regression and the search over constants in it, in a process each:
columns kept on the device, and the same machine's CPU alone. Last, sums over columns that together
are larger than the device's memory. Writes ``results/throughput_gpu.json``; ``--quick`` writes
nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxsr
from benchmarks import provenance
from benchmarks.throughput_cases import MIX, VARIABLES, Population, random_population, samples
from benchmarks.timing import repeated, spread
from jaxsr.evaluation import EngineConfig, Evaluator
from jaxsr.evaluation.resident import has_kernel, memory
from jaxsr.evolution import SearchConfig, init
from jaxsr.evolution.loop import step
from jaxsr.regression import RegressionProblem, Resources

Device = Any  # jax.Device is a variable to a type checker
ROOT = Path(__file__).resolve().parents[1]
COPY_BYTES = 2**31  # long enough that launching it does not count
ANSWER = 60_000_000  # terms x rows
ROWS, SEARCHED = (1_000, 10_000, 100_000, 1_000_000), (1_000, 10_000, 100_000, 1_000_000)
HOST_MOST = 100_000  # rows that the CPU searches on
TERMS, REPEATS, SEED = 6000, 9, 0
LONGEST = 150.0  # seconds of the searches of a kind
GENERATIONS = 2  # timed of a search, after one that compiles
BEYOND = 1.5  # times the device's memory


def measure(terms: int, rows: Sequence[int], repeats: int) -> dict[str, Any]:
    """Measure raw evaluation where JAX sees a GPU; say so where it sees none."""
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
    drawn = random_population(np.random.default_rng(SEED), terms)
    points = [_point(drawn, n, repeats, device, cpu, bandwidth) for n in rows]
    faster = [p["rows"] for p in points if p["brought"]["median"] > p["cpu"]["median"]]
    return {
        "measured": True,
        "device": device.device_kind,
        "kernel": has_kernel(),
        "cpu_threads": EngineConfig(device=cpu).workers,
        "copy_bytes": COPY_BYTES,
        "copy_bytes_per_second": bandwidth,
        "points": points,
        "crossover_rows": min(faster, default=None),
    }


def _bandwidth(device: Device, repeats: int) -> float:
    """Return bytes read and written a second by a copy."""
    size = COPY_BYTES if device.platform == "gpu" else COPY_BYTES // 256
    with jax.default_device(device):
        x = jax.random.normal(jax.random.key(0), (size // 4,), np.float32)
    copy = jax.jit(lambda a: a + 1.0)
    times = repeated(lambda: copy(x).block_until_ready(), max(7, repeats))
    return 2.0 * size / float(np.median(times))


def _point(
    drawn: Population, rows: int, repeats: int, gpu: Device, cpu: Device, bandwidth: float
) -> dict[str, Any]:
    population = drawn.first(ANSWER // rows)
    data, work = samples(rows), population.nodes * rows
    out: dict[str, Any] = {"rows": rows, "terms": len(population.terms)}
    batch = jaxsr.compile_terms(population.terms, VARIABLES, EngineConfig(device=gpu))
    there = jax.device_put(data, gpu)
    times = {
        "kept": repeated(lambda: batch.resident(there).block_until_ready(), 3 * repeats),
    }
    theta = np.zeros((len(population.terms), rows), np.float32).T
    times["brought"] = repeated(lambda: batch.evaluate(data, out=theta), repeats)
    found = theta.copy()
    host = jaxsr.compile_terms(population.terms, VARIABLES, EngineConfig(device=cpu))
    times["cpu"] = repeated(lambda: host.evaluate(data, out=theta), repeats)
    for name, spent in times.items():
        out[name] = asdict(spread(work / np.array(spent)))
    out["apart"] = _apart(found, theta)
    traffic = 4.0 * rows * (len(population.terms) + len(VARIABLES))
    out["bound"] = work * bandwidth / traffic
    out["share_of_bandwidth_bound"] = out["kept"]["median"] / out["bound"]
    print(
        f"{rows:8} rows, {len(population.terms)} terms, G node-rows/s: kept on the device "
        f"{out['kept']['median'] / 1e9:.2f}, brought to the host "
        f"{out['brought']['median'] / 1e9:.2f}, CPU {out['cpu']['median'] / 1e9:.2f}; "
        f"{out['share_of_bandwidth_bound']:.1%} of the bandwidth bound; values apart "
        f"{out['apart']:.1e}",
        flush=True,
    )
    return out


def _apart(found: np.ndarray, truth: np.ndarray) -> float:
    """Return how far apart, relative to a term's largest, all but a hundredth of the values are."""
    with np.errstate(all="ignore"):
        size = np.nanmax(np.where(np.isfinite(truth), np.abs(truth), 0.0), axis=0)
        error = np.abs(found - truth) / np.where(size > 0.0, size, 1.0)
    return float(np.nanquantile(error[np.isfinite(error)], 0.99))


def problem(rows: int, evaluator: Any, noise: float = 0.05) -> RegressionProblem:
    """Return a regression on two oscillations, whose law is a spring, a pendulum and a force."""
    t = np.linspace(0.0, 20.0, rows)
    x, z = np.cos(1.3 * t) + 0.4 * np.cos(3.1 * t + 0.5), 1.1 * np.sin(0.9 * t + 0.2)
    v, w = np.gradient(x, t), np.gradient(z, t)
    y = -1.69 * x + 0.8 * np.sin(2.0 * z) - 0.3 * v * np.abs(v) + np.sin(2.5 * t + 0.4)
    y += noise * np.std(y) * np.random.default_rng(SEED).normal(size=rows)
    return RegressionProblem(
        y, {"t": t, "x": x, "z": z, "v": v, "w": w}, resources=Resources(evaluator)
    )


class Kept(Evaluator):
    """Columns on JAX's first device, however few."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.device = jax.devices()[0]

    def differentiates(self, sets: int) -> bool:
        """Tell that constants are searched for there too."""
        return True


class OnHost(Evaluator):
    """Columns on the CPU, however many."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.device = None


KINDS = {"kept": Kept, "cpu": OnHost, "rule": Evaluator}


def generations(kind: str, rows: int, count: int, population: int) -> dict[str, Any]:
    """Return wall seconds of the first population and of each generation, and the best loss."""
    config, rng = SearchConfig(population=population), np.random.default_rng(SEED)
    began = time.perf_counter()
    regression = problem(rows, KINDS[kind])
    state, each = init(rng, regression, config), []
    first = time.perf_counter() - began
    for _ in range(count + 1 if rows < SEARCHED[-1] else 2):
        began = time.perf_counter()
        state, _ = step(rng, state, regression)
        each.append(time.perf_counter() - began)
    row = {"rows": rows, "kind": kind, "first": first, "each": each, "loss": state.front.best_loss}
    row["generation"] = statistics.median(each[1:])
    print(
        f"{rows:8} rows, {kind}: first population {first:.2f} s, first generation {each[0]:.2f} s, "
        f"a generation {row['generation']:.3f} s, loss {row['loss']:.3e}",
        flush=True,
    )
    return row


def apart(kind: str, rows: Sequence[int], count: int, population: int) -> list[dict[str, Any]]:
    """Return :func:`generations` of a process of its own, which sees the CPU alone for "cpu".

    None are kept on a device that is a CPU.
    """
    there = "jax.default_backend() == 'gpu'" if kind == "kept" else "True"
    code = (
        "import json, jax; from benchmarks.throughput_gpu import generations\n"
        f"for rows in {list(rows)} if {there} else []:\n"
        f"    print('ROW', json.dumps(generations({kind!r}, rows, {count}, {population})))"
    )
    platforms = {"JAX_PLATFORMS": "cpu"} if kind == "cpu" else {}
    found = []
    with subprocess.Popen(
        [sys.executable, "-u", "-W", "ignore", "-c", code],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, **platforms},
    ) as process:
        assert process.stdout is not None
        stop = threading.Timer(LONGEST, process.kill)  # what was measured by then stands
        stop.start()
        for line in process.stdout:
            if line.startswith("ROW "):
                found.append(json.loads(line[4:]))
            else:
                print(line, end="", flush=True)
        stop.cancel()
    return found


def too_large(device: Device, terms: int, factor: float = BEYOND) -> dict[str, Any]:
    """Return the time of sums over columns that together are larger than the memory."""
    drawn = random_population(np.random.default_rng(SEED), terms)
    rows = int(factor * memory(device) / (4 * terms))
    batch = jaxsr.compile_terms(drawn.terms, VARIABLES, EngineConfig(device=device))
    data = samples(rows)
    y = np.asarray(data[:, 0])
    began = time.perf_counter()
    total, _, _ = batch.moments(data, y)
    seconds = time.perf_counter() - began
    few = jaxsr.compile_terms(drawn.terms[:20], VARIABLES, EngineConfig(device=device))
    same = np.allclose(few.moments(data, y)[0], total[:20], rtol=1e-6, equal_nan=True)
    row = {
        "terms": terms,
        "rows": rows,
        "answer_bytes": 4 * terms * rows,
        "memory_bytes": memory(device),
        "seconds": seconds,
        "node_rows_per_second": drawn.nodes * rows / seconds,
        "same_in_a_smaller_batch": bool(same),
    }
    print(
        f"{terms} terms on {rows} rows, {row['answer_bytes'] / 2**30:.0f} GiB on a device of "
        f"{row['memory_bytes'] / 2**30:.0f} GiB: sums in {seconds:.2f} s, "
        f"{row['node_rows_per_second'] / 1e9:.1f} G node-rows/s, same sums: {same}",
        flush=True,
    )
    return row


def main() -> None:
    """Run, print, write the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few terms, nothing written")
    options = parser.parse_args()
    rows, terms, repeats = (ROWS, TERMS, REPEATS) if not options.quick else ((1_000,), 60, 3)
    searched, sizes = SEARCHED if not options.quick else (1_000,), (GENERATIONS, 600)
    # first, since this process takes most of a device's memory once it has seen one
    kept = apart("kept", searched, *sizes)
    body = measure(terms, rows, repeats)
    if not body["measured"]:
        return
    host = apart("cpu", [n for n in searched if n <= HOST_MOST], *sizes)
    body["too_large"] = too_large(jax.devices()[0], terms, 0.05 if options.quick else BEYOND)
    body["generations"] = [*kept, *host]
    times = {row["rows"]: row["generation"] for row in host}
    gained = [r["rows"] for r in kept if r["generation"] < times.get(r["rows"], 0.0)]
    body["crossover_rows_of_a_generation"] = min(gained, default=None)
    if not options.quick:
        setting = {"unit": "node-rows/s, duplicates counted", "terms": MIX}
        provenance.write("throughput_gpu", "one GPU", [SEED], {"setting": setting, **body})


if __name__ == "__main__":
    main()
