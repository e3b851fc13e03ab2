"""Free runs of the sets that the evidence leads to: in which order, and where they end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from jaxsr.diagnosis import free_runs as module
from jaxsr.diagnosis.free_runs import FreeRuns

LEADER, RICH, BESIDE, INNER, RIVAL = (0, 1), (0,), (1,), (2,), (0, 3)


@dataclass
class Runs:
    """Free runs in which an estimate is a second, and what was estimated."""

    seconds: float = np.inf
    found: list[tuple[int, ...]] | None = None

    def entered(self, arena: Any, members: tuple[int, ...], *_: Any, **__: Any) -> Any:
        """Take a second."""
        self.found = [*(self.found or []), members]
        fit = SimpleNamespace(cost=1.0, path=None)
        return SimpleNamespace(members=members, stepping=None, fit=fit)

    @property
    def spent(self) -> bool:
        """Whether time is up."""
        return len(self.found or []) >= self.seconds


@pytest.fixture
def free(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Runs, FreeRuns]]:
    """Free runs of a richer law and another force, which leave more than the noise or do not."""

    def made(*, above: bool, seconds: float = np.inf) -> tuple[Runs, FreeRuns]:
        runs = Runs(seconds)

        def inside(arena: Any, few: Any, entries: list[Any], stop: Callable[[], bool]) -> Any:
            if few.members == RICH and not stop():
                entries = [*entries, runs.entered(arena, INNER)]
            return entries, entries[-1]

        progress = SimpleNamespace(update=lambda *_: None)

        class Search:
            exhausted = property(lambda _: runs.spent)

        for name, stand_in in {
            "enter": runs.entered,
            "rescaled": lambda arena, entries, _: (arena, entries),
            "in_widths_of_best": lambda arena, entries: (arena, entries),
            "residual_to_noise": lambda *_: 20.0 if above else 1.0,
            "fewer_do": lambda *_: False,
            "fewest": lambda all_of_it, _, parts: next(
                (e for e in parts if e.members == RICH), all_of_it
            ),
            "leading": lambda *_: "",
            "plainest": inside,
        }.items():
            monkeypatch.setattr(module, name, stand_in)
        case = cast("Any", SimpleNamespace(search=Search(), progress=progress))
        return runs, FreeRuns(case, None, False)

    return made


def asked(runs: Runs, free: FreeRuns, guessed: set[tuple[int, ...]]) -> list[tuple[int, ...]]:
    arena, null = cast("Any", None), cast("Any", SimpleNamespace(members=(), stepping=None))
    starts = [(members, np.zeros(1)) for members in (LEADER, RICH, BESIDE)]
    arena, entries = free.deciding(arena, null, starts, guessed)
    free.beside(arena, entries, [(members, np.zeros(1)) for members in (RICH, RIVAL)])
    return runs.found or []


def test_what_decides_is_estimated_before_what_it_is_compared_with(free: Any) -> None:
    """A law inside a richer one, which may be told in its place, comes before the rivals."""
    runs, of = free(above=True)
    assert asked(runs, of, set()) == [LEADER, RICH, BESIDE, INNER, RIVAL]


@pytest.mark.parametrize("seconds", [1, 2, 3, 4])
def test_time_ends_with_the_rivals_first(free: Any, seconds: int) -> None:
    runs, of = free(above=True, seconds=seconds)
    assert asked(runs, of, set()) == [LEADER, RICH, BESIDE, INNER, RIVAL][:seconds]


def test_where_nothing_is_left_above_the_noise_no_plainer_law_is_asked_for(free: Any) -> None:
    """Nor are the parts that the evidence did not estimate."""
    runs, of = free(above=False)
    assert asked(runs, of, {BESIDE}) == [LEADER, RICH, RIVAL]
