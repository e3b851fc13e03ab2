"""Simulators of every kind, opened for a command: what they are, and what they write back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxsr._arguments import is_format
from jaxsr._result import InputError
from jaxsr.models.formats.mjcf import Robot, read_mjcf, write_draft
from jaxsr.models.simulator import Simulator
from jaxsr.recordings import Recording

EXPLAINED = ("explained.xml", "explained.py")


@dataclass(frozen=True, eq=False)
class Opened:
    """A simulator of a command.

    Attributes
    ----------
    simulator : Simulator
    robot : Robot, optional
        Where it comes from, if that is a format that people have.
    drafted : Path, optional
        Sidecar that was written.
    """

    simulator: Simulator
    robot: Robot | None = None
    drafted: Path | None = None

    @property
    def checks(self) -> list[dict[str, Any]]:
        """Rows for ``data_checks``."""
        return [] if self.robot is None else self.robot.checks


def read_robot(
    path: str | Path,
    sidecar: str | Path | None = None,
    recordings: Sequence[str | Path | Recording] = (),
) -> Robot:
    """Read a robot from ``robot.xml`` (MJCF).

    Raises
    ------
    InputError
        See `read_mjcf`.
    """
    if str(path).lower().endswith(".urdf"):
        raise InputError("URDF is not read yet", str(path), "Convert it to MJCF, or write a TOML")
    return read_mjcf(path, sidecar, recordings)


def open_simulator(
    model: str,
    tables: Sequence[str] = (),
    recordings: Sequence[str] = (),
    folder: Path | None = None,
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
    """
    if not is_format(model):
        return Opened(Simulator.from_file(model, *tables))
    robot = read_robot(model, next(iter(tables), None), recordings)
    return Opened(Simulator(robot.model), robot, write_draft(robot, folder))
