"""Simulators of every kind, opened for a command: what they are, and what they write back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from jaxsr._arguments import is_format
from jaxsr.models.formats.fmu import Unit, read_fmu, write_sidecar
from jaxsr.models.formats.mjcf import Robot, read_mjcf, read_plant, write_draft
from jaxsr.models.formats.running import robot_to_csv
from jaxsr.models.formats.step_map import is_step, read_steps, steps_to_csv
from jaxsr.models.formats.time_step import step_rows
from jaxsr.models.formats.unit_edits import edited_unit
from jaxsr.models.formats.urdf import read_urdf, repair_rows
from jaxsr.models.formats.write_back import write_back
from jaxsr.models.simulation import simulate_to_csv
from jaxsr.models.simulator import Simulator
from jaxsr.recordings import Recording


def simulated_table(
    opened: Opened,
    recording: Recording | None,
    duration: float | None,
    dt: float | None,
) -> pd.DataFrame:
    """Return the table of ``jaxsr simulate``: robots and steps run as they do themselves."""
    if opened.robot is not None:
        return robot_to_csv(opened.robot, recording, duration, dt)
    if opened.unit is not None and recording is not None:
        own = steps_to_csv(opened.unit, recording)
        if own is not None:
            return own
    return simulate_to_csv(opened.simulator, recording, duration, dt)


@dataclass(frozen=True, eq=False)
class Opened:
    """A simulator of a command.

    Attributes
    ----------
    simulator : Simulator
    robot : Robot, optional
        Where it comes from, if that is MJCF or URDF.
    unit : Unit, optional
        The same, if that is an FMU or a step function.
    drafted : Path, optional
        Sidecar that was written.
    """

    simulator: Simulator
    robot: Robot | None = None
    unit: Unit | None = None
    drafted: Path | None = None

    @property
    def checks(self) -> list[dict[str, Any]]:
        """Rows for ``data_checks``."""
        own = self.robot or self.unit
        return [] if own is None else own.checks

    def _steps(self, fit: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Say what the file's own time step does, at the horizon that the verdict rests on."""
        if self.robot is None or fit.get("headline_s") not in fit["horizons_s"]:
            return []
        horizon = float(fit["headline_s"])
        given = fit["train"]["given"][fit["horizons_s"].index(fit["headline_s"])]
        mismatch = float("nan") if given is None else float(given)
        return step_rows(self.robot, self.robot.recordings, horizon, mismatch)

    def written_back(self, diagnosis: Any, folder: Path) -> dict[str, str]:
        """Return texts by name that say a diagnosis in the simulator's own format.

        What changed there stands in the diagnosis's ``data_checks`` from then on.
        """
        if self.unit is not None:
            return self._edited(diagnosis, self.unit)
        if self.robot is None:
            return {}
        plant = self.robot.plant
        back = write_back(plant, diagnosis.given, diagnosis.model, diagnosis.findings, folder)
        name = plant.path.name
        rows = [*self.checks, *self._steps(diagnosis.fit)]
        for line in back.said:
            row = {"file": name, "channel": "", "check": "written_back", "message": line}
            rows.append(row)
        diagnosis.document["data_checks"] += rows
        return back.files

    def close(self) -> None:
        """End the process of a simulator that has one."""
        if self.unit is not None:
            self.unit.native.close()

    def _edited(self, diagnosis: Any, unit: Unit) -> dict[str, str]:
        files, said = edited_unit(unit, diagnosis.given, diagnosis.model)
        rows = list(self.checks)
        for line in said:
            row = {"file": unit.path.name, "channel": "", "check": "written_back", "message": line}
            rows.append(row)
        diagnosis.document["data_checks"] += rows
        return files


def read_robot(
    path: str | Path,
    sidecar: str | Path | None = None,
    recordings: Sequence[str | Path | Recording] = (),
) -> Robot:
    """Read a robot from ``robot.xml`` (MJCF) or ``robot.urdf``.

    Raises
    ------
    InputError
        See `read_mjcf`.
    """
    if str(path).lower().endswith(".urdf"):
        plant, repairs = read_urdf(path)
        robot = read_plant(plant, sidecar, recordings)
        return replace(robot, checks=[*repair_rows(plant.path, repairs), *robot.checks])
    return read_mjcf(path, sidecar, recordings)


def open_simulator(
    model: str,
    tables: Sequence[str] = (),
    recordings: Sequence[str] = (),
    folder: Path | None = None,
    read: Callable[..., Simulator] = Simulator.from_file,
) -> Opened:
    """Open the simulator that a command names.

    Parameters
    ----------
    model : str
        ``model.toml``, ``robot.xml`` or ``file.py:function``.
    tables : sequence of str
        The file of ``--model``, if given.
    recordings : sequence of str
        Files to learn from.
    folder : Path, optional
        Takes the drafted sidecar of a robot in whose folder nothing can be written.
    read : callable
        Reads what is no robot.
    """
    table = next(iter(tables), None)
    if is_step(model):
        unit = read_steps(model, table, recordings)
        return Opened(unit.simulator.read_from(model, table), unit=unit)
    if not is_format(model):
        return Opened(read(model, *tables))
    if model.lower().endswith(".fmu"):
        unit = read_fmu(model, table, recordings)
        drafted = write_sidecar(unit.path.with_suffix(".toml"), unit.drafted, folder)
        found = unit.simulator.read_from(model, table)
        return Opened(found, unit=unit, drafted=drafted)
    robot = read_robot(model, table, recordings)
    found = Simulator(robot.model).read_from(model, table)
    return Opened(found, robot, drafted=write_draft(robot, folder))
