"""What the report's own script draws: figures as numbers, packed, and the script with its hash."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from jaxsr.report.evidence import Evidence, ForceResidual, ModelRun, Trajectory
from jaxsr.report.formatting import unit_text
from jaxsr.report.words import mechanism_at, site_words

NUMBERS = 220_000
"""Numbers of four bytes that a report carries for its script: about 1.2 MB."""
MOST, FEWEST = 4000, 50
"""Samples of a course that a screen can show, and that are carried whatever the number."""
SERIES = 40
"""Courses that a report carries; of more those with the largest errors before."""
SCRIPTS = ("charts.js", "explore.js")


@cache
def script() -> str:
    """Return the script of the page, one function that leaves no names behind."""
    folder = resources.files("jaxsr.report") / "templates"
    parts = [(folder / name).read_text(encoding="utf-8") for name in SCRIPTS]
    return '"use strict";\n(() => {\n' + "\n".join(parts) + "})();\n"


@cache
def script_hash() -> str:
    """Return the hash by which the page allows its script, and no other."""
    digest = hashlib.sha256(script().encode("utf-8")).digest()
    return "sha256-" + base64.b64encode(digest).decode("ascii")


def packed(evidence: Evidence) -> str:
    """Return the numbers of a report as JSON that may stand inside a script element."""
    runs = _largest(evidence.trajectories)
    rivals, shared = rival_keys(evidence), {run.recording: run for run in runs}
    columns = sum(3 + (run.given is not None) + len(run.rivals) for run in runs)
    columns += sum(2 + len(run.inputs) for run in shared.values())
    columns += sum(4 + len(part.variables) for part in evidence.residuals)
    most = max(min(MOST, NUMBERS // max(columns, 1)), FEWEST)
    keys = {labels: key for labels, (key, _) in rivals.items()}
    document = {
        "recordings": {name: _recording(run, most) for name, run in shared.items()},
        "series": [_series(run, most, keys) for run in runs],
        "rivals": [[key, words] for key, words in rivals.values()],
        "residuals": [_residual(part, most) for part in evidence.residuals[:SERIES]],
        "units": {name: unit_text(unit) for name, unit in evidence.units.items()},
    }
    return _text(document)


def packed_runs(runs: Sequence[ModelRun]) -> str:
    """Return the numbers of a discovery's free runs, in the form of `packed`."""
    kept = [run for run in runs if len(run.time) > 1][:SERIES]
    shared = {run.recording: run for run in kept}
    columns = 2 * len(kept) + sum(2 + len(run.inputs) for run in shared.values())
    most = max(min(MOST, NUMBERS // max(columns, 1)), FEWEST)
    document = {
        "models": [["measured", "measured"], ["explained", "model"]],
        "recordings": {name: _recording(run, most) for name, run in shared.items()},
        "series": [
            {
                "recording": run.recording,
                "role": "held_out",
                "output": run.output,
                "unit": unit_text(run.unit),
                "measured": _numbers(run.measured[_every(len(run.time), most)]),
                "explained": _numbers(run.simulated[_every(len(run.time), most)]),
            }
            for run in kept
        ],
        "rivals": [],
        "residuals": [],
        "units": {run.output: unit_text(run.unit) for run in kept},
    }
    return _text(document)


def _text(document: Mapping[str, Any]) -> str:
    """Return JSON that cannot end a script element."""
    return json.dumps(document, ensure_ascii=True, allow_nan=False).replace("<", "\\u003c")


def _largest(runs: Sequence[Trajectory]) -> list[Trajectory]:
    """Return the courses that a report carries, in their order."""

    def error(run: Trajectory) -> float:
        apart = run.recalibrated - run.measured
        apart = apart[np.isfinite(apart)]
        return float(np.sqrt(np.mean(apart**2))) if apart.size else 0.0

    usable = [run for run in runs if len(run.time) > 1]
    kept = sorted(range(len(usable)), key=lambda k: -error(usable[k]))[:SERIES]
    return [usable[k] for k in sorted(kept)]


def _recording(run: Trajectory | ModelRun, most: int) -> dict[str, Any]:
    """Return what all courses of a recording share."""
    every = _every(len(run.time), most)
    inputs = {name: _numbers(values[every]) for name, values in run.inputs.items()}
    return {"time": _numbers(run.time[every], wide=True), "inputs": inputs}


def _series(run: Trajectory, most: int, keys: Mapping[tuple[str, ...], str]) -> dict[str, Any]:
    every = _every(len(run.time), most)
    return {
        "recording": run.recording,
        "role": run.role,
        "output": run.output,
        "unit": unit_text(run.unit),
        "measured": _numbers(run.measured[every]),
        "given": None if run.given is None else _numbers(run.given[every]),
        "recalibrated": _numbers(run.recalibrated[every]),
        "explained": _numbers(run.explained[every]),
        **{keys[labels]: _numbers(values[every]) for labels, values in run.rivals.items()},
    }


def _every(samples: int, most: int) -> slice:
    """Return which samples are carried."""
    return slice(None, None, max(-(-samples // most), 1))


def rival_keys(evidence: Evidence) -> dict[tuple[str, ...], tuple[str, str]]:
    """Return a key and words for every set whose runs a report carries, by its labels."""
    labels = dict.fromkeys(m for run in evidence.trajectories for m in run.rivals)
    return {m: (f"rival{k}", " + ".join(map(mechanism_at, m))) for k, m in enumerate(labels)}


def _same_samples(one: Trajectory, other: Trajectory) -> bool:
    same = (one.recording, one.role) == (other.recording, other.role)
    return same and len(one.time) == len(other.time)


def _residual(part: ForceResidual, most: int) -> dict[str, Any]:
    every = _every(len(part.time), most)
    variables = {part.state_name: part.state, **part.variables}
    return {
        "recording": part.recording,
        "site": part.site,
        "words": site_words(part.site),
        "unit": unit_text(part.unit),
        "time": _numbers(part.time[every], wide=True),
        "recalibrated": _numbers(part.recalibrated[every]),
        "explained": _numbers(part.explained[every]),
        "variables": {name: _numbers(values[every]) for name, values in variables.items()},
    }


def _numbers(values: np.ndarray, wide: bool = False) -> dict[str, Any]:
    """Return numbers as little-endian bytes in base64."""
    kind = "<f8" if wide else "<f4"
    with np.errstate(over="ignore"):  # what is beyond four bytes is shown as nothing
        data = np.asarray(values, dtype=float).astype(kind).tobytes()
    return {"data": base64.b64encode(data).decode("ascii"), "wide": wide}
