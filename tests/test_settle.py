"""What roll-outs that end early say of themselves: the promise of equal files hangs on it."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxsr
from jaxsr import _clock
from jaxsr._progress import Budget, Silent
from jaxsr._result import StoppedBy
from jaxsr.discovery.choose import Candidate
from jaxsr.discovery.equation import Equation, FittedTerm, cut_short
from jaxsr.discovery.find import Task
from jaxsr.discovery.samples import Samples, roles, samples
from jaxsr.discovery.settle import settle
from jaxsr.evolution import SearchConfig, complexity
from jaxsr.expressions import parse
from jaxsr.recordings import Recording

QUICK = SearchConfig(population=40, refined=3, generations=8, restarts=0, patience=3)
FRONTS = {
    "x": ["v", "v + x", "v + x**3"],
    "v": ["x", "x + v", "x + v**3", "x + v*Abs(v)", "x + v + x**3"],
}


def _brake(rate: str = "v") -> Recording:
    """x' = v, v' = -2 x - 0.3 v |v|, both with 5 % noise; v is the column ``rate``."""
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 8.0, 80)
    x, v = solve_ivp(
        lambda t, s: [s[1], -2.0 * s[0] - 0.3 * s[1] * abs(s[1])], (0.0, 8.0), [2.0, 0.0], t_eval=t
    ).y
    noisy = {k: s + 0.05 * np.std(s) * rng.normal(size=80) for k, s in {"x": x, rate: v}.items()}
    return Recording("brake", t, noisy)


class Clock:
    """A clock that stands still, or moves on by `pace` seconds at every look."""

    def __init__(self) -> None:
        self.now, self.pace = 0.0, 0.0

    def monotonic(self) -> float:
        self.now += self.pace
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(_clock, "time", SimpleNamespace(monotonic=made.monotonic))
    return made


class AtRollOuts(Silent):
    """Do something as the roll-outs begin."""

    def __init__(self, do: Callable[[], None]) -> None:
        self._do = do

    def stage(self, text: str) -> None:
        if text == "roll-outs":
            self._do()


def _discovered(budget: Budget, do: Callable[[], None] = lambda: None) -> jaxsr.Discovery:
    return jaxsr.discover(
        [_brake("d_x")],
        states=["x"],
        order=2,
        autonomous=True,
        config=QUICK,
        budget=budget,
        progress=AtRollOuts(do),
    )


@pytest.mark.slow
def test_time_that_runs_out_in_the_roll_outs_alone_is_told(clock: Clock) -> None:
    def late() -> None:
        clock.now += 100.0

    in_time = _discovered(Budget(50.0, 0.0))
    assert in_time.provenance["stopped_by"] == "converged"
    clock.now = 0.0
    found = _discovered(Budget(50.0, 0.0), late)
    assert found.provenance["stopped_by"] == "budget"
    # x' = d_x by definition: nothing about it hangs on the time left
    assert [e.stopped_by for e in found.equations] == ["converged", "budget"]


def test_a_stop_asked_for_in_the_roll_outs_is_told(clock: Clock) -> None:
    budget = Budget(50.0, 0.0)
    assert _discovered(budget, budget.interrupt).provenance["stopped_by"] == "interrupted"


def test_an_equation_turned_back_for_its_signs_still_tells(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What roll-outs make break a sign stays as it was found; they ran out of time all the same."""

    def late() -> None:
        clock.now += 100.0

    home = importlib.import_module("jaxsr.discovery.laws")
    monkeypatch.setattr(home, "obeys", lambda equation, signs: False)
    assert _discovered(Budget(50.0, 0.0), late).provenance["stopped_by"] == "budget"


def _front(state: str, sets: Sequence[str], data: Samples, reason: StoppedBy) -> Equation:
    """Return what a search would have found, its largest set picked."""
    problem = Task(state, "t", autonomous=True).problem(data)
    fits = [problem.fit([parse(part) for part in text.split(" + ")]) for text in sets]
    front = tuple(Candidate(f, complexity(f.terms), f.loss, f.loss) for f in fits)
    last = fits[-1]
    terms = tuple(
        FittedTerm(term, float(c), (float(c) - 1.0, float(c) + 1.0))
        for term, c in zip(last.terms, last.coefficients, strict=True)
    )
    mse = last.loss
    return Equation(
        state, terms, mse, mse, front=front, pick=len(front) - 1, noise_mse=mse, stopped_by=reason
    )


def _settled(budget: Budget, reason: StoppedBy = StoppedBy.CONVERGED) -> list[Equation]:
    data = samples([_brake()], roles(["x", "v"], None, 1, (), None))
    equations = [_front(state, sets, data, reason) for state, sets in FRONTS.items()]
    tasks = {state: Task(state, "t", autonomous=True) for state in FRONTS}
    return settle(equations, tasks, data.traces, budget)


@pytest.mark.long
def test_what_is_not_cut_short_is_the_same_and_what_differs_says_so(clock: Clock) -> None:
    """Whatever look at the clock is the last one in time, "converged" means the same equations."""
    whole = _settled(Budget())
    assert [e.stopped_by for e in whole] == ["converged", "converged"]
    clock.pace = 1.0
    changed = 0
    for seconds in (1.5, 5.0, 15.0, 40.0, 80.0, 160.0, 320.0, 1e3, 1e6):
        clock.now = 0.0
        found = _settled(Budget(seconds, 0.0))
        same = [e.terms for e in found] == [e.terms for e in whole]
        assert {e.stopped_by for e in found} == {"budget"} or same, seconds
        changed += not same
    assert changed >= 3
    assert [e.stopped_by for e in found] == ["converged", "converged"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("search", "stop", "told"),
    [
        ("converged", True, "interrupted"),
        ("converged", False, "converged"),
        ("budget", False, "budget"),
        ("budget", True, "interrupted"),
        ("target", False, "target"),
        ("interrupted", False, "interrupted"),
    ],
)
def test_the_search_s_own_reason_is_kept_unless_a_stronger_one_comes(
    search: str, stop: bool, told: str
) -> None:
    budget = Budget()
    if stop:
        budget.interrupt()
    found = _settled(budget, StoppedBy(search))
    assert [e.stopped_by for e in found] == [told, told]


def test_a_wish_to_stop_counts_more_than_a_lack_of_time() -> None:
    every = list(StoppedBy)
    assert cut_short(every) == cut_short(every[::-1]) == StoppedBy.INTERRUPTED
    assert cut_short([StoppedBy.TARGET, StoppedBy.BUDGET]) == StoppedBy.BUDGET
    assert cut_short([StoppedBy.TARGET, StoppedBy.CONVERGED]) is None
