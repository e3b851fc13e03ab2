"""What the figures of a report are computed from, for plants whose figures have closed forms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.optimize
import scipy.stats

from jaxsr._progress import Budget
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.judging.refine import Estimate, named_super_model
from jaxsr.diagnosis.mechanisms import force_candidates, sensor_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.models import Model, Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

STEP, COUNT, NOISE = 0.01, 1000, 0.01
TIME = np.arange(COUNT) * STEP
THRESHOLD = 1e-4
NEEDED = float(scipy.stats.norm.isf(0.5 * THRESHOLD) + scipy.stats.norm.ppf(0.95))
CART = """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "{force}"
[readings]
y = "v"
[parameters]
{parameters}
[initial]
q = 0.0
v = {start}
"""


@dataclass(frozen=True)
class Row:
    """One figure: what the report says, and what is true.

    A number is right within `tolerance`, relative to the larger of it and 1e-9; None says that
    the figure must be absent.
    """

    name: str
    found: float | str | None
    exact: float | str | None
    tolerance: float = 0.0

    @property
    def right(self) -> bool:
        """Whether the report says what is true."""
        if isinstance(self.found, float | int) and isinstance(self.exact, float | int):
            size = max(abs(self.exact), 1e-9)
            return bool(abs(self.found - self.exact) <= self.tolerance * size)
        return self.found == self.exact


def cart(force: str = "u", parameters: str = "", start: str = '"free"') -> Model:
    """Return the model of a cart of unit mass whose speed is read."""
    return parse_model(CART.format(force=force, parameters=parameters, start=start))


def white(seed: int, size: int = COUNT) -> np.ndarray:
    """Return white noise of the size that is told, exactly."""
    noise = np.random.default_rng(seed).standard_normal(size)
    return NOISE * noise / np.sqrt(np.mean(noise**2))


def integral(rate: Callable[[np.ndarray], np.ndarray], time: np.ndarray = TIME) -> np.ndarray:
    """Integrate a function of time from the first sample, by the midpoints of a fine grid."""
    fine = 50
    step = time[1] - time[0]
    middles = time[:-1, None] + step * (np.arange(fine) + 0.5) / fine
    return np.concatenate([[0.0], np.cumsum(rate(middles).mean(1) * step)])


@dataclass(frozen=True, eq=False)
class Parts:
    """What the figures are computed from, as a diagnosis has it."""

    case: Case
    arena: Any
    entries: list[Entry]
    null: Entry
    chosen: Entry
    detection: Any
    whole: None = None

    @staticmethod
    def of(
        model: Model,
        recordings: Sequence[Recording],
        candidates: Sequence[Candidate],
        members: tuple[int, ...] = (),
    ) -> Parts:
        """Estimate re-calibration and the set `members` in free run over whole recordings."""
        prepared = tuple(Prepared.build(model, r) for r in recordings)
        super_model = SuperModel.build(model, candidates)
        simulator = Simulator(super_model.model)
        widths = tuple(1e-4 for _ in simulator.smoothed_arguments)
        stepping = Stepping("rk4", 2, widths)
        scale = np.full(len(model.outputs), NOISE)
        arena = build_arena(super_model, prepared, stepping, None, scale, simulator)
        theta = super_model.seeded(members, neutral_values(super_model))
        null = enter(arena, (), neutral_values(super_model))
        chosen = enter(arena, members, theta) if members else null
        case = Case(Simulator(model), prepared, None, Budget(), Budget())
        detection = SimpleNamespace(threshold=THRESHOLD)
        return Parts(case, arena, [null, chosen], null, chosen, detection)

    @property
    def parts(self) -> Any:
        """The same where `Ingredients` are asked for."""
        return self

    def estimate(self) -> Estimate:
        """Return the chosen set under the names that a reader expects."""
        arena, entry = self.arena, self.chosen
        named = named_super_model(
            arena.super_model.given, [arena.super_model.candidates[i] for i in entry.members]
        )
        zero = np.zeros_like(entry.fit.theta)
        return Estimate(arena, entry, entry.fit.theta, zero, zero, named)


@dataclass(frozen=True)
class Drive:
    """A speed a*sin(w*t) + b of a cart of unit mass, and the command that makes it."""

    frequency: float = 2.0
    offset: float = 0.3

    @staticmethod
    def drawn(seed: int) -> Drive:
        """Draw a drive that reverses; that of seed 0 is the default one."""
        if seed == 0:
            return Drive()
        rng = np.random.default_rng(seed)
        return Drive(rng.uniform(1.0, 4.0), rng.uniform(0.1, 0.5))

    def speed(self, t: np.ndarray) -> np.ndarray:
        """Return v(t)."""
        return np.sin(self.frequency * t) + self.offset

    def command(self, t: np.ndarray) -> np.ndarray:
        """Return u(t) = dv/dt."""
        return self.frequency * np.cos(self.frequency * t)

    @property
    def signals(self) -> dict[str, np.ndarray]:
        """Command and states at the samples."""
        return {"u": self.command(TIME), "q": integral(self.speed), "v": self.speed(TIME)}

    def recording(self, noise: np.ndarray | float = 0.0, share: float = 1.0) -> Recording:
        """Return a recording of a share of the motion."""
        channels = {"u": share * self.command(TIME), "y": share * self.speed(TIME) + noise}
        return Recording("a.csv", TIME, channels)


def some(model: Model, signals: Mapping[str, np.ndarray], *wanted: str) -> list[Candidate]:
    """Return the candidates of some labels, one each, thresholds at generic starts."""
    scale = {s: np.quantile(x, np.linspace(0.0, 1.0, 21)) for s, x in signals.items()}
    inputs = {u: signals[u] for u in model.inputs}
    every = [*force_candidates(model, scale, inputs=inputs), *sensor_candidates(model)]
    return [next(c for c in every if c.label == label) for label in wanted]
