"""Which windows of a recording are judged, one behind another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from jaxsr.models.segments import Prepared, unbroken
from jaxsr.monitoring.following import Window


@dataclass(frozen=True)
class Rhythm:
    """How samples are judged.

    Attributes
    ----------
    block : int
        Samples that are judged at a time.
    lead : int
        Samples before them that lead the filter there.
    """

    block: int = 64
    lead: int = 128

    @property
    def least(self) -> int:
        """Samples that lead where a recording begins."""
        return max(self.lead // 4, 2)

    def windows(self, number: int, item: Prepared, judged: int = 0) -> list[Window]:
        """Return the whole windows of a recording, behind `judged` samples that were.

        None goes across a break in the rows.
        """
        found: list[Window] = []
        for start, stop in unbroken(item.time):
            found += [
                Window(number, max(first - self.lead, start), first, first + self.block)
                for first in self._firsts(start, stop, judged)
            ]
        return found

    def _firsts(self, start: int, stop: int, judged: int) -> range:
        first = judged if judged > start + self.least else start + self.least
        return range(first, stop - self.block + 1, self.block)


def batches(windows: Sequence[Window], size: int) -> Iterator[Sequence[Window]]:
    """Yield windows, so many at a time."""
    for k in range(0, len(windows), size):
        yield windows[k : k + size]
