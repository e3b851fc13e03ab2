"""MuJoCo's MJCF as a simulator: the file, its sidecar and recordings make a formula model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from jaxsr._files import atomic_write_text
from jaxsr._result import InputError
from jaxsr.models.formats.agreement import check_agreement
from jaxsr.models.formats.columns import POSITION, Matched, Quantity, match, quantities_of
from jaxsr.models.formats.formulas import tables_of
from jaxsr.models.formats.plant import Plant
from jaxsr.models.formats.reach import Reach, unclamped_inputs
from jaxsr.models.formats.sidecar import draft, merged, read_sidecar
from jaxsr.models.model import Model
from jaxsr.models.reading import build_model
from jaxsr.recordings import Recording, read_recording


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
    plant = Plant.read(path)
    return read_plant(plant, sidecar, recordings)


def read_plant(
    plant: Plant,
    sidecar: str | Path | None = None,
    recordings: Sequence[str | Path | Recording] = (),
) -> Robot:
    """Return a compiled plant as a formula model, see `read_mjcf`."""
    table = Path(sidecar) if sidecar is not None else plant.path.with_suffix(".toml")
    if sidecar is not None and not table.is_file():
        raise InputError("no such file", str(table), "Check the path of the sidecar")
    given = read_sidecar(table, plant.path)
    tables = tables_of(plant)
    quantities = quantities_of(plant, tables["units"])
    head = given.get("model", {})
    opened = _opened(recordings, given, head)
    matched = _matched(plant, quantities, given, opened)
    inside = unclamped_inputs(plant, matched.columns, opened)
    tables = tables_of(plant, inside)
    check_agreement(plant, _plain(plant, tables), inside)
    tables["model"]["outputs"] = [q.role for q in matched.outputs]
    tables["readings"] = {q.role: q.reading for q in matched.outputs}
    tables["units"] |= {q.role: q.unit for q in matched.outputs if q.unit}
    tables["columns"] = dict(matched.columns)
    drafted = "" if given or not opened else draft(plant.path, tables, matched)
    model = build_model(merged(tables, given, table.name), table.name)
    reach = Reach.of(plant, model)
    model = replace(model, within=reach)
    covered = tuple(reach(recording) for recording in opened)
    checks = [*_assumed(plant, model, matched, opened), *_drafted(table, drafted, model)]
    values = {n: p["value"] for n, p in tables["parameters"].items()}
    edited = bool(model.additions) or any(
        p.value != values.get(n) for n, p in model.parameters.items()
    )
    return Robot(plant, model, checks, drafted, edited, covered)


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
    recordings: Sequence[str | Path | Recording], given: dict[str, Any], head: Any
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
    quantities: list[Quantity],
    given: dict[str, Any],
    opened: Sequence[Recording],
) -> Matched:
    """Match columns by name, as far as the sidecar leaves them open."""
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
        found.outputs = [q for q in quantities if q.kind == POSITION]
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
    return rows


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
