"""MuJoCo's MJCF as a simulator: the file, its sidecar and recordings make a formula model."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from jaxsr._files import atomic_write_text
from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.models.formats.agreement import check_agreement
from jaxsr.models.formats.columns import (
    POSITION,
    Matched,
    Quantity,
    match,
    quantities_of,
    says_effort,
)
from jaxsr.models.formats.formulas import tables_of
from jaxsr.models.formats.loading import read_plant_file
from jaxsr.models.formats.loops import estimated, loops_of, motors, with_loops
from jaxsr.models.formats.plant import Loop, Plant, mujoco
from jaxsr.models.formats.reach import Reach, unclamped_inputs
from jaxsr.models.formats.rotors import rotors_of, told_rotors, with_rotors
from jaxsr.models.formats.sidecar import draft, merged, read_sidecar
from jaxsr.models.model import Model
from jaxsr.models.reading import build_model
from jaxsr.recordings import Recording, read_recording

MOST_SAID = 12
"""Loops whose gains are said."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A simulator in a format that people have, read into a formula model.

    Attributes
    ----------
    plant : Plant
    model : Model
    checks : list of dict
        What was assumed, in the form of ``data_checks``.
    drafted : str
        Text of the sidecar that was drafted, empty where there was one.
    edited : bool
        Whether a sidecar gives parameters another value, or adds forces.
    recordings : tuple of Recording
        Those that it was matched with, without what the formulas do not cover.
    """

    plant: Plant
    model: Model
    checks: list[dict[str, Any]] = field(default_factory=list)
    drafted: str = ""
    edited: bool = False
    recordings: tuple[Recording, ...] = ()


def read_mjcf(
    path: str | Path,
    sidecar: str | Path | None = None,
    recordings: Sequence[str | Path | Recording] = (),
) -> Robot:
    """Read an MJCF with its sidecar; without one, find columns by the names of its elements.

    Parameters
    ----------
    path : path
        ``robot.xml``.
    sidecar : path, optional
        ``robot.toml`` beside it by default.
    recordings : sequence of path or Recording
        Those to learn from. Without any, columns have the names of joints and actuators.

    Raises
    ------
    InputError
        The file or its sidecar cannot be read, has what is not covered, or recordings do not go
        with it.
    """
    given = read_sidecar(_table(Path(path), sidecar), Path(path))
    held = bool(given.get("model", {}).get("fixed_base", False))
    plant, left_out = read_plant_file(path, fixed_base=held)
    robot = read_plant(plant, sidecar, recordings)
    rows = [_row(plant.path.name, "repair", line) for line in left_out]
    return replace(robot, checks=[*rows, *robot.checks])


def _table(path: Path, sidecar: str | Path | None) -> Path:
    """Return where the sidecar of a file is, or would be."""
    table = Path(sidecar) if sidecar is not None else path.with_suffix(".toml")
    if sidecar is not None and not table.is_file():
        raise InputError("no such file", str(table), "Check the path of the sidecar")
    return table


def read_plant(
    plant: Plant,
    sidecar: str | Path | None = None,
    recordings: Sequence[str | Path | Recording] = (),
) -> Robot:
    """Return a compiled plant as a formula model, see `read_mjcf`."""
    table = _table(plant.path, sidecar)
    given = read_sidecar(table, plant.path)
    plant = _switched_off(plant, given.get("model", {}))
    if plant.mjcf:
        if given.get("model", {}).get("fixed_base"):
            raise InputError("a URDF's base is fixed", table.name, "Take fixed_base out")
        plant = with_rotors(plant, rotors_of(plant, given.get("parameters"), table.name))
    if "servos" in given:
        plant = with_loops(plant, loops_of(plant, given["servos"], table.name))
    opened = _opened(recordings, given, given.get("model", {}))
    driven, matched = _driven(plant, given, opened)
    tables, model = _modelled(driven, table, given, matched, opened)
    covered = _covered(model, opened)
    rotors: dict[int, float] = {}
    if driven is not plant:
        driven = with_loops(plant, estimated(driven, model, covered))
    elif plant.mjcf and "parameters" not in given and not plant.loops:
        rotors = told_rotors(plant, model, covered)
        driven = with_rotors(plant, rotors)
    if driven is not plant:
        tables, model = _modelled(driven, table, given, matched, opened)
    loops = driven.loops.items()
    servos = {driven.actuator_names[i]: {"kp": x.kp, "kv": x.kv} for i, x in loops}
    own = {f"armature_{plant.joints[j]}" for j in rotors}
    drafted = "" if given or not opened else draft(plant.path, tables, matched, servos, own)
    checks = [
        *_rotors_said(plant, rotors),
        *_assumed(driven, model, matched, opened),
        *_drafted(table, drafted, model),
    ]
    values = {n: p["value"] for n, p in tables["parameters"].items()}
    edited = bool(model.additions) or any(
        p.value != values.get(n) for n, p in model.parameters.items()
    )
    return Robot(driven, model, checks, drafted, edited, covered)


def _switched_off(plant: Plant, head: Mapping[str, Any]) -> Plant:
    """Take out contacts or limits that a sidecar says have never acted."""
    off = [key for key in ("contacts", "limits") if not head.get(key, True)]
    if not off:
        return plant
    m = copy.copy(plant.m)
    for key in off:
        m.opt.disableflags |= int(getattr(mujoco().mjtDisableBit, f"mjDSBL_{key.upper()[:-1]}"))
    return replace(plant, m=m)


def _driven(
    plant: Plant, given: Mapping[str, Any], opened: Sequence[Recording]
) -> tuple[Plant, Matched]:
    """Match columns; where they are targets of motors, put loops around these, gains unknown."""
    try:
        return plant, _matched(plant, given, opened)
    except InputError as error:
        looped = with_loops(plant, {i: Loop(1.0, 0.0, estimated=True) for i in motors(plant)})
        if plant.loops or looped is plant:
            raise
        try:
            return looped, _matched(looped, given, opened)
        except InputError:
            raise error from None


def _modelled(
    plant: Plant,
    table: Path,
    given: Mapping[str, Any],
    matched: Matched,
    opened: Sequence[Recording],
) -> tuple[dict[str, Any], Model]:
    """Return the tables of a plant as its file has it, and the model with what a sidecar says."""
    inside = unclamped_inputs(plant, matched.columns, opened)
    step = min((r.sample_time for r in opened), default=math.inf)
    tables = tables_of(plant, inside, step, [q.reading for q in matched.outputs])
    check_agreement(plant, _plain(plant, tables), inside)
    if opened and says_effort(plant, matched):
        tables["model"]["input_hold"] = "linear"
    tables["model"]["outputs"] = [q.role for q in matched.outputs]
    tables["readings"] = {q.role: q.reading for q in matched.outputs}
    tables["units"] |= {q.role: q.unit for q in matched.outputs if q.unit}
    tables["columns"] = dict(matched.columns)
    model = build_model(merged(tables, given, table.name), table.name)
    return tables, replace(model, within=Reach.of(plant, model))


def _covered(model: Model, opened: Sequence[Recording]) -> tuple[Recording, ...]:
    return tuple(r if model.within is None else model.within(r) for r in opened)


def _plain(plant: Plant, tables: dict[str, Any]) -> Model:
    """Return the model before a sidecar has a say, every position read."""
    readings = {f"{q}_meas": q for q in plant.positions}
    head = {**tables["model"], "outputs": list(readings)}
    return build_model({**tables, "model": head, "readings": readings}, plant.path.name)


def write_draft(robot: Robot, elsewhere: Path | None = None) -> Path | None:
    """Write the drafted sidecar beside the simulator, or `elsewhere` where that cannot be.

    Returns
    -------
    Path or None
        Where it is.
    """
    if not robot.drafted:
        return None
    path = robot.plant.path.with_suffix(".toml")
    try:
        if path.exists():  # written meanwhile
            return None
        atomic_write_text(path, robot.drafted)
        return path
    except InputError:
        if elsewhere is None:
            return None
        atomic_write_text(elsewhere / path.name, robot.drafted)
        return elsewhere / path.name


def _opened(
    recordings: Sequence[str | Path | Recording], given: Mapping[str, Any], head: Any
) -> list[Recording]:
    columns = given.get("columns", {})
    time = columns.get(head.get("time", "t")) if isinstance(columns, dict) else None
    step = head.get("sample_time")
    return [
        r if isinstance(r, Recording) else read_recording(r, time=time, sample_time=step)
        for r in recordings
    ]


def _matched(
    plant: Plant,
    given: Mapping[str, Any],
    opened: Sequence[Recording],
) -> Matched:
    """Match columns by name, as far as the sidecar leaves them open."""
    quantities = quantities_of(plant, tables_of(plant)["units"])
    said = {k: v for k, v in given.get("columns", {}).items() if isinstance(v, str)}
    told = bool(given.get("readings"))  # which sensors there are
    if not opened:
        return _by_name(plant, quantities, said, told)
    fixed = [q for q in quantities if q.role in said]
    for q in fixed:
        opened[0].channel(said[q.role])  # says what is wrong with it
    pool = [q for q in quantities if q.role not in said and not (told and q.reading)]
    columns = [c for c in opened[0].channels if c not in said.values()]
    measured = told or any(q.reading for q in fixed)
    found = match(plant, pool, columns, opened[0].name, measured=measured)
    found.columns = {q.role: said[q.role] for q in fixed} | found.columns
    found.outputs = [] if told else [*(q for q in fixed if q.reading), *found.outputs]
    return found


def _by_name(plant: Plant, quantities: list[Quantity], said: dict[str, str], told: bool) -> Matched:
    """Return positions read from columns named as their joints, where nothing else is said."""
    found = Matched(columns=dict(said))
    if not told:
        own = [q for q in quantities if q.reading and q.role in said]
        found.outputs = [q for q in quantities if q.kind == POSITION or q in own]
        for q in found.outputs:
            found.columns.setdefault(q.role, q.names[0])
    for u, name in zip(plant.inputs, plant.actuator_names, strict=True):
        found.columns.setdefault(u, name if name not in found.columns.values() else f"u_{name}")
    return found


def _assumed(
    plant: Plant, model: Model, matched: Matched, opened: Sequence[Recording]
) -> list[dict[str, Any]]:
    """Say what of the recordings and of the model is not used."""
    rows = []
    if matched.unknown and opened:
        names = ", ".join(matched.unknown[:12])
        message = f"columns that match no joint, actuator or sensor are not used: {names}"
        rows.append(_row(opened[0].name, "columns", message))
    seen = Reach.of(plant, model).sensors
    unseen = [q for j, q in enumerate(plant.positions) if j not in seen]
    contacts = not plant.disabled("CONTACT") and bool(plant.m.ngeom)
    if unseen and opened and contacts:
        message = (
            f"{', '.join(unseen)} has no sensor of its own: whether geoms touch was not checked, "
            "and contacts do not act in the formulas"
        )
        rows.append(_row(plant.path.name, "contacts", message))
    if plant.loops:
        rows.append(_row(plant.path.name, "servos", _loops_said(plant)))
    return rows


def _rotors_said(plant: Plant, rotors: Mapping[int, float]) -> list[dict[str, Any]]:
    """Say which joints got the inertia of a rotor."""
    if not rotors:
        return []
    listed = "; ".join(f"{plant.joint_names[j]} {x:.3g}" for j, x in rotors.items())
    message = (
        "a URDF has no inertia of rotors: the recordings tell one, free from 0 on, that starts at "
        f"(kg m^2 or kg): {shortened(listed, 200)}"
    )
    return [_row(plant.path.name, "rotors", message)]


def _loops_said(plant: Plant) -> str:
    """Say which loops are part of the model, and what cannot be told from their gains."""
    parts = [f"{plant.actuator_names[i]} kp {x.kp:.4g}, kv {x.kv:.4g}" for i, x in _some(plant)]
    more = len(plant.loops) - len(parts)
    listed = "; ".join(parts) + (f"; {more} more" if more > 0 else "")
    told = any(loop.estimated for loop in plant.loops.values())
    how = "estimated from the recordings, kp free" if told else "as [servos] says"
    return (
        "the inputs are targets of position loops, force = kp*(target - position) - kv*rate, "
        f"{how}: {listed}. A joint's damping and kv of its loop cannot be told apart: kv stays"
    )


def _some(plant: Plant) -> list[tuple[int, Loop]]:
    return list(plant.loops.items())[:MOST_SAID]


def _drafted(table: Path, drafted: str, model: Model) -> list[dict[str, Any]]:
    if not drafted:
        return []
    free = ", ".join(model.free_parameters) or "nothing"
    message = (
        f"{table.name} was drafted: columns by their names, input_hold {model.input_hold!r}, "
        f"free are {free}"
    )
    return [_row(table.name, "drafted", message)]


def _row(file: str, check: str, message: str) -> dict[str, Any]:
    return {"file": file, "channel": "", "check": check, "message": message}
