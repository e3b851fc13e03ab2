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
        self._total, self._running, self._told = len(board.tasks), 0, False
        done = len(board.ended)
        already = f"{done} of {self._total} cases are done already"
        progress.stage(already if done else f"{self._total} cases")

    def run(self, running: int) -> None:
        """Hear how many tasks run."""
        if running != self._running:
            self._running = running
            # The line of the last end has the other counts.
            words = f"{running} run" if self._told else self._words
            self._progress.update(self._fraction, words)

    def end(self, outcome: Outcome, repeated: bool) -> None:
        """Tell how a task ended, and what is left."""
        self._told, left = True, self._total - len(self._board.ended)
        self._running = min(self._running, left)  # who ended a task begins the next one
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
        done, running = sum(outcome.done for outcome in ended), self._running
        # A task that is tried again runs, and counts as failed until it is done.
        failed, waiting = len(ended) - done, max(self._total - len(ended) - running, 0)
        return f"{done} of {self._total} done, {failed} failed, {running} run, {waiting} wait"
