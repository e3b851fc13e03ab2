"""How far a batch is, told as it goes."""

from __future__ import annotations

from jaxsr._progress import Progress
from jaxsr.batch.board import Board
from jaxsr.batch.task import Outcome


class Tally:
    """Tell how many tasks are done, failed, run and wait: a line for each that ends, and a bar.

    Parameters
    ----------
    progress : Progress
    board : Board
        What ended, before the first line too.
    """

    def __init__(self, progress: Progress, board: Board) -> None:
        self._progress, self._board = progress, board
        self._total, self._running = len(board.tasks), 0
        done = len(board.ended)
        already = f"{done} of {self._total} cases are done already"
        progress.stage(already if done else f"{self._total} cases")

    def run(self, running: int) -> None:
        """Hear how many tasks run."""
        if running != self._running:
            self._running = running
            self._progress.update(self._fraction, self._words)

    def end(self, outcome: Outcome, repeated: bool) -> None:
        """Tell how a task ended, and what is left."""
        again = "tried again: " if repeated else ""
        told = f"{again}{outcome.name}: {outcome.message or 'done'}"
        self._progress.stage(f"{self._words}: {told}")
        self._progress.update(self._fraction)

    @property
    def _fraction(self) -> float:
        return len(self._board.ended) / self._total

    @property
    def _words(self) -> str:
        ended = self._board.ended.values()
        left, done = self._total - len(ended), sum(outcome.done for outcome in ended)
        running = min(self._running, left)  # who ended a task begins the next one
        failed, waiting = len(ended) - done, left - running
        return f"{done} of {self._total} done, {failed} failed, {running} run, {waiting} wait"
