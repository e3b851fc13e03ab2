"""What a monitor said of files, kept in ``monitor.json``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jaxsr._files import atomic_write_text, check_writable_directory, dump_json
from jaxsr._result import InputError
from jaxsr.monitoring.alarm import Alarm, stretch_behind
from jaxsr.monitoring.live import Monitor

SCHEMA = "jaxsr.monitor/1"


class Journal:
    """Files that were judged, and the alarms they raised.

    Parameters
    ----------
    watch : Monitor
    directory : Path
        Where ``monitor.json`` is written, anew after every file.
    command : str
        Kept in it.

    Raises
    ------
    InputError
        The directory cannot be written.
    """

    def __init__(self, watch: Monitor, directory: Path, command: str = "") -> None:
        check_writable_directory(directory)
        self.watch, self.directory, self.command = watch, directory, command
        self.files: list[str] = []
        self.skipped: dict[str, str] = {}
        self.alarms: list[dict[str, Any]] = []
        self.write()

    def judge(self, path: Path) -> list[Alarm]:
        """Judge a file and return its alarms; one that cannot be read is listed as skipped."""
        try:
            found = self.watch.read(path)
        except InputError as error:
            self.skipped[str(path)] = str(error)
            found = []
        else:
            self.files.append(str(path))
            self.alarms += [{**alarm.to_dict(), "diagnosis": None} for alarm in found]
        self.write()
        return found

    def diagnose(self, alarm: Alarm, path: Path, budget: float | None = None) -> str:
        """Diagnose a file from where it left the model to its end, and say what was found.

        The results are in ``alarm_001`` and so on.
        """
        number = next(
            k
            for k, row in enumerate(self.alarms)
            if row["time_s"] == alarm.time and row["stream"] == alarm.stream
        )
        folder = self.directory / f"alarm_{number + 1:03d}"
        try:
            found = stretch_behind(alarm, path).diagnose(budget=budget)
            found.save(folder)
            said = f"{found.sentence} Report: {folder / 'report.html'}"
        except InputError as error:
            said = f"not diagnosed: {error}"
        self.alarms[number]["diagnosis"] = said
        self.write()
        return said

    @property
    def sentence(self) -> str:
        """Say how much was judged, and how many alarms there were."""
        count, files = len(self.alarms), len(self.files)
        alarms = "1 alarm" if count == 1 else f"{count or 'no'} alarms"
        named = "1 file" if files == 1 else f"{files} files"
        return f"{alarms} in {self.watch.hours:.3g} h of {named}"

    def write(self) -> None:
        """Write ``monitor.json``."""
        document = {
            "schema": SCHEMA,
            "model": self.watch.model.name,
            "command": self.command,
            "false_alarms_per_hour": self.watch.false_alarms_per_hour,
            "exponent": self.watch.exponent,
            "hours": self.watch.hours,
            "files": self.files,
            "skipped": self.skipped,
            "alarms": self.alarms,
        }
        atomic_write_text(self.directory / "monitor.json", dump_json(document))
