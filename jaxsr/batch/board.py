"""What ended of a batch: its tasks, the cases that they are parts of, and the fleet of these."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path

from jaxsr._saved import load
from jaxsr.batch.fleet import Fleet
from jaxsr.batch.islands import best, take
from jaxsr.batch.listing import AnyCase
from jaxsr.batch.task import DONE, Outcome, Task

_PAUSE = 9.0  # times as long as writing took, between two writings of table and page


class Board:
    """The tasks of a batch and how they ended.

    Attributes
    ----------
    tasks : list of Task
    ended : dict of str to Outcome
        By the name of the task.
    fleet : Fleet
        Of the cases whose tasks have all ended.
    """

    def __init__(self, tasks: Mapping[str, list[Task]], fleet: Fleet) -> None:
        self._parts = tasks
        self._owner = {task.name: case for case, parts in tasks.items() for task in parts}
        self.tasks = [task for parts in tasks.values() for task in parts]
        self.ended: dict[str, Outcome] = {}
        self.fleet = fleet
        self._wait_until = 0.0

    @classmethod
    def of(cls, cases: Mapping[str, AnyCase], folder: str) -> Board:
        """Return the board of cases whose results go into a folder."""
        here = os.getcwd()
        tasks = {
            name: [Task(part, job, folder, here) for part, job in case.parts(name)]
            for name, case in cases.items()
        }
        return cls(tasks, Fleet(Path(folder), tuple(cases), {}, {}, cases=cases))

    def end(self, outcome: Outcome) -> bool:
        """Take down how a task ended; return whether it had ended before."""
        repeated = outcome.name in self.ended
        self.ended[outcome.name] = outcome
        case = self._owner[outcome.name]
        parts = self._parts[case]
        if case == outcome.name:
            self.fleet = self.fleet.with_outcome(outcome)
        elif all(part.name in self.ended for part in parts):
            self.fleet = self._with_best(case, parts)
        return repeated

    def _with_best(self, case: str, parts: list[Task]) -> Fleet:
        """Return the fleet with the best of a case's parts as its result."""
        fleet = self.fleet
        for part in parts:
            fleet = fleet.with_part(self.ended[part.name])
        done = [part for part in parts if self.ended[part.name].done]
        if not done:
            first = self.ended[parts[0].name]
            return fleet.with_outcome(Outcome(case, first.status, first.said))
        folders = [fleet.directory / part.name for part in done]
        chosen = folders[best([load(folder).document for folder in folders])]
        take(chosen, fleet.directory / case)
        return fleet.with_outcome(Outcome(case, DONE))

    def write_now_and_then(self) -> None:
        """Write table and page, unless that would take more than a tenth of the time."""
        begin = time.monotonic()
        if begin >= self._wait_until:
            self.fleet.write()
            end = time.monotonic()
            self._wait_until = end + _PAUSE * (end - begin)
