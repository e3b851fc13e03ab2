"""Free runs of the sets that the evidence leads to."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.calibrating.horizon import Start
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.judging.leading import leading
from jaxsr.diagnosis.judging.nesting import plainest
from jaxsr.diagnosis.judging.noise_ratio import ABOVE_NOISE, residual_to_noise
from jaxsr.diagnosis.judging.parsimony import fewer_do, fewest
from jaxsr.diagnosis.likelihood.paths import path_over
from jaxsr.diagnosis.likelihood.posterior import Posterior
from jaxsr.diagnosis.shooting.arena import Arena, in_widths_of_best
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.output_weights import rescaled


@dataclass(frozen=True)
class FreeRuns:
    """Estimates sets in free run along the path that the evidence found.

    Attributes
    ----------
    case : Case
    path : ndarray, shape (states, samples, segments), optional
        None where it has other recordings than the case.
    near : bool
        Whether that path is as fine as the recordings.
    """

    case: Case
    path: np.ndarray | None
    near: bool

    @classmethod
    def of(cls, case: Case, arena: Arena, found: Posterior) -> FreeRuns:
        """Return them along the path of the leading hypothesis."""
        if len(found.prepared) != len(case.prepared):
            return cls(case, None, False)
        course = arena.problem.segments, case.prepared, found.prepared, found.rows
        pairs = zip(found.prepared, case.prepared, strict=True)
        near = all(a.time.size == b.time.size for a, b in pairs)
        return cls(case, path_over(*course, found.leader.path), near)

    def stop(self) -> bool:
        """Whether time is up."""
        return self.case.search.exhausted

    def entered(self, arena: Arena, members: tuple[int, ...], start: np.ndarray) -> Entry:
        """Estimate one set."""
        return enter(arena, members, start, self.path, self.stop, near=self.near)

    def begun(self, arena: Arena, null: Entry, found: Posterior, start: np.ndarray) -> Entry:
        """Return re-calibration, along the path as well where it leads and leaves much.

        Beside an impact the path that the sensors tell may begin on its wrong side.
        """
        if found.leader.members or residual_to_noise(arena, null) <= ABOVE_NOISE:
            return null
        return min(null, self.entered(arena, (), start), key=lambda e: e.fit.cost)

    def deciding(
        self,
        arena: Arena,
        null: Entry,
        starts: Sequence[Start],
        guessed: Collection[tuple[int, ...]],
    ) -> tuple[Arena, list[Entry]]:
        """Estimate the leading set, its parts and the laws inside them.

        Every reading is weighed by what the leading set leaves. Where that is more than the
        sensors' noise, the law inside a richer one may be told in its place, and so may some
        members of the set, the smallest first: none is estimated where fewer explain as much. Parts
        that are `guessed`, which the evidence did not estimate, are asked there alone.
        """
        entries = [null]
        if not starts:
            return in_widths_of_best(*rescaled(arena, entries, self.stop))
        entries.append(self.entered(arena, *starts[0]))
        arena, entries = in_widths_of_best(arena, entries)
        arena, entries = rescaled(arena, entries, self.stop)
        above = residual_to_noise(arena, entries[1]) > ABOVE_NOISE
        for number, (members, start) in enumerate(starts[1:], 1):
            if self.stop():
                break
            few = above and fewer_do(entries[1], arena, entries[2:], len(members))
            if not few and (above or members not in guessed):
                self.case.progress.update(number / len(starts), leading(arena, entries))
                entries.append(self.entered(arena, members, start))
        if above:
            few = fewest(entries[1], arena, entries[2:])
            entries, _ = plainest(arena, few, entries, self.stop)
        return in_widths_of_best(arena, entries)

    def beside(
        self, arena: Arena, entries: list[Entry], starts: Sequence[Start]
    ) -> tuple[Arena, list[Entry]]:
        """Estimate the sets that the leading one is compared with, as far as time allows."""
        known = {e.members for e in entries}
        for number, (members, start) in enumerate(starts):
            if members not in known and not self.stop():
                self.case.progress.update(number / len(starts), leading(arena, entries))
                entries = [*entries, self.entered(arena, members, start)]
        return in_widths_of_best(arena, entries)
