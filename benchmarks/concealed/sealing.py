"""The sealer: cases from a seed, and the truth apart, its checksum recorded before any run."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.concealed.casefile import (
    Arguments,
    Disguise,
    controller_notes,
    decoys,
    model_text,
    site_of,
    table,
    truth_values,
)
from benchmarks.concealed.detectability import Evidence, Setting, weigh
from benchmarks.concealed.plan import Ticket, deal
from benchmarks.concealed.planting import Planted, fainter, plant
from jaxsr._files import atomic_write_text, dump_json
from jaxsr._result import InputError

ROOT = Path(__file__).resolve().parents[2]
SCHEMA = "jaxsr.concealed/1"
ATTEMPTS = 6
NOISE = 1.1
"""Rms innovation up to which a fit told the truth has reached the noise; another is drawn above."""
FAINT = 2.0
"""Likelihood-ratio statistic that a case below the noise may reach about."""


def seed_of(text: str) -> int:
    """Return a seed from a number, or from the first 8 hex digits of the frozen commit.

    Raises
    ------
    InputError
        The text is neither, or the working tree differs from the commit.
    """
    if text != "commit":
        if not (text.isascii() and text.isdigit()):
            raise InputError(f"must be a whole number or commit, got {text!r}", "--seed")
        return int(text)

    def git(*words: str) -> str:
        run = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
        return run.stdout.strip()

    if git("status", "--porcelain", "--", "jaxsr", "benchmarks/concealed"):
        raise InputError("the tree differs from the commit", "--seed commit", "Commit first")
    return int(git("rev-parse", "HEAD")[:8], 16)


def seal(seed: int, count: int, out: Path, jobs: int = 1, tiny: bool = False) -> str:
    """Write `count` cases and the truth; return the truth's SHA-256.

    A sealer that was interrupted goes on where it stopped.

    Raises
    ------
    InputError
        `out` holds cases of another seed or count.
    """
    mark = {"schema": SCHEMA, "seed": seed, "cases": count, "tiny": tiny}
    started = out / "sealing.json"
    if (out / "sealed.json").exists():
        done = json.loads((out / "sealed.json").read_text(encoding="utf-8"))
        if {k: done[k] for k in mark} == mark:
            return str(done["truth_sha256"])
        raise InputError("holds other cases", str(out), "Name another place with --out")
    if started.exists() and json.loads(started.read_text(encoding="utf-8")) != mark:
        raise InputError("holds other cases", str(out), "Name another place with --out")
    atomic_write_text(started, dump_json(mark))
    tickets = deal(seed, count)
    todo = [(seed, t, out, tiny) for t in tickets if not _part(out, t).exists()]
    for number, name in enumerate(_mapped(todo, jobs), 1):
        print(f"sealed {name} ({number} of {len(todo)})", flush=True)
    cases = {t.name: json.loads(_part(out, t).read_text(encoding="utf-8")) for t in tickets}
    truth = out / "truth" / "truth.json"
    atomic_write_text(truth, dump_json({"schema": SCHEMA, "seed": seed, "cases": cases}))
    shutil.rmtree(out / "truth" / "parts")
    digest = sha256(truth)
    files = {
        str(f.relative_to(out)): sha256(f)
        for f in sorted((out / "cases").rglob("*.*"))
        if f.is_file()
    }
    atomic_write_text(
        out / "sealed.json", dump_json({**mark, "truth_sha256": digest, "files_sha256": files})
    )
    started.unlink()
    return digest


def sha256(path: Path) -> str:
    """Return the checksum of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _part(out: Path, ticket: Ticket) -> Path:
    return out / "truth" / "parts" / f"{ticket.name}.json"


def _mapped(todo: list[tuple[int, Ticket, Path, bool]], jobs: int) -> Iterable[str]:
    if jobs == 1:
        yield from (seal_case(*item) for item in todo)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(seal_case, *zip(*todo, strict=True)) if todo else ()


def seal_case(seed: int, ticket: Ticket, out: Path, tiny: bool = False) -> str:
    """Plant, weigh, disguise and write one case; return its name."""
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, 1, ticket.number, attempt])
        try:
            planted = plant(rng, ticket, tiny)
        except FloatingPointError:
            continue
        bounds, given = _priors(rng, planted)
        setting = _setting(planted, bounds, given)
        evidence, calibrated = weigh(setting)
        if evidence.innovation < NOISE:
            break
    else:
        raise FloatingPointError(f"{ticket.name}: the fit told the truth does not reach the noise")
    if ticket.kind == "below_noise":
        for _ in range(4):
            if evidence.statistic <= 3.0 * FAINT:
                break
            planted = fainter(rng, planted, float(np.sqrt(FAINT / evidence.statistic)))
            setting = _setting(planted, bounds, given)
            evidence, calibrated = weigh(setting)
    masked = ticket.kind not in ("nothing", "parameter") and rng.uniform() < 0.5
    if masked:
        # as of an engineer who calibrated the model on such data before
        given |= calibrated
        evidence = replace(evidence, absorbed=False)
    disguise = Disguise.draw(rng, planted.system, len(planted.sensors))
    _write_case(rng, out, planted, disguise, given, bounds)
    entry = _truth(planted, disguise, evidence, given, masked)
    atomic_write_text(_part(out, ticket), dump_json(entry))
    return ticket.name


def _priors(rng: np.random.Generator, planted: Planted) -> tuple[dict, dict[str, float]]:
    """Return bounds of the constants that may be calibrated, and the given values."""
    bounds = {
        c: (planted.p[c] * rng.uniform(0.25, 0.5), planted.p[c] * rng.uniform(2.0, 4.0))
        for c, constant in planted.system.constants.items()
        if constant.free
    }
    given = dict(planted.p)
    for effect in planted.effects:
        if effect.replaces:
            given[effect.replaces] = planted.p[effect.replaces] * effect.values["ratio"]
    return bounds, given


def _setting(planted: Planted, bounds: dict, given: dict[str, float]) -> Setting:
    return Setting(
        planted.system,
        planted.p,
        planted.effects,
        planted.sensors,
        planted.design,
        planted.recorded,
        bounds,
        given,
    )


def _write_case(
    rng: np.random.Generator,
    out: Path,
    planted: Planted,
    disguise: Disguise,
    given: dict[str, float],
    bounds: dict[str, tuple[float, float]],
) -> None:
    """Write a case's folder, whole or not at all."""
    name, system, made = planted.ticket.name, planted.system, planted.design
    folder = out / "cases" / name
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".sealing-") as temporary:
        place = Path(temporary) / name
        (place / "experiments").mkdir(parents=True)
        text = model_text(
            system, disguise, planted.sensors, given, bounds, made.hold, f"case {name}"
        )
        (place / "model.toml").write_text(text, encoding="utf-8")
        files = []
        for e in range(made.experiments):
            rows = table(
                planted.recorded, e, system, disguise, planted.sensors, made, planted.gains
            )
            files.append(f"experiments/e{e + 1}.csv")
            rows.to_csv(place / files[-1], index=False, float_format="%.10g")
        candidates = None
        if planted.ticket.kind == "decoys":
            candidates = "decoys.json"
            terms = {"candidates": decoys(rng, system, disguise)}
            (place / candidates).write_text(dump_json(terms), encoding="utf-8")
        Arguments(
            case=name,
            model="model.toml",
            data=tuple(files[: made.learning]),
            held_out=tuple(files[made.learning :]),
            seed=0,
            candidates=candidates,
            controllers=tuple(controller_notes(planted.gains, disguise, planted.sensors, system)),
        ).write(place)
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(place, folder)


def _truth(
    planted: Planted,
    disguise: Disguise,
    evidence: Evidence,
    given: dict[str, float],
    masked: bool,
) -> dict[str, Any]:
    """Return what the scorer will know of a case."""
    system, units = planted.system, disguise.units
    effects = []
    for effect, size in zip(planted.effects, planted.sizes, strict=True):
        kind = "equation" if effect.kind == "external" else effect.kind
        twins = system.twins.get((effect.mechanism, effect.index), ()) if kind == "equation" else ()
        values = truth_values(effect, disguise, system, planted.sensors)
        if effect.replaces:
            dims = system.constants[effect.replaces].dims
            values = {
                disguise.names[effect.replaces]: units.number(planted.p[effect.replaces], dims)
            }
        effects.append(
            {
                "mechanism": effect.mechanism,
                "family": effect.family,
                "verdict": effect.verdict,
                "site": site_of(effect, disguise, system),
                "sites": [site_of(effect, disguise, system, r) for r in effect.rows],
                "twins": [disguise.names[t] for t in twins],
                "values": values,
                "unchecked": list(effect.shape),
                "size": size,
            }
        )
    ticket = planted.ticket
    return {
        "kind": ticket.kind,
        "system": ticket.system,
        "multibody": system.multibody,
        "closed_loop": ticket.closed,
        "masked": masked,
        "samples": planted.design.samples * planted.design.learning,
        "excitation": list(planted.design.kinds),
        "truth_by": "MuJoCo and DOP853" if system.simulator == "mujoco" else "DOP853",
        "turning": [disguise.names[f"v{i + 1}"] for i in system.turning],
        "springs": bool(system.springs),
        "sensors": [asdict(s) for s in planted.sensors],
        "effects": effects,
        "evidence": evidence.document(),
        "given": {
            disguise.names[c]: units.number(given[c], constant.dims)
            for c, constant in system.constants.items()
        },
        "true": {
            disguise.names[c]: units.number(planted.p[c], constant.dims)
            for c, constant in system.constants.items()
        },
    }
