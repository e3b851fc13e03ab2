"""A family of cheap plants, and the prior that the engine publishes for its edits and constants."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

from benchmarks.generality.laws import LAWS
from benchmarks.generality.plant import LEAD, Plant, Signal, readings
from benchmarks.generality.system import Array, Axis, Constant, Drive, Gauge, System, Values
from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.table import Table, tabled
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import prepare
from jaxsr.models import Model, parse_model
from jaxsr.recordings import Recording

SAMPLES = 200
NOISE = 4e-3
"""Of the reading's deviation."""
FAR = 1e6
"""Mean of a constant that stands for no limit."""
LEFT_OUT = (
    *("position_dependent_friction@", "backlash@", "clipping@", "drift@output"),
    "transient_force@",  # when it acts is picked from the residual, and no prior is drawn from
)


def _oscillator(x: Array, u: Array, p: Values, f: Array) -> Any:
    place, speed = x
    return [speed, (u[0] - p["c"] * speed - p["k"] * place + f[0]) / p["m"]]


PLANT = System(
    name="cheap_oscillator",
    group="calibration",
    states=("q", "v"),
    tables="""
[equations]
q = "v"
v = "(u - c*v - k*q)/m"
""",
    motion=_oscillator,
    constants={
        "m": Constant(1.0, 1.0),
        "c": Constant(1.0, 1.0, free=True),
        "k": Constant(30.0, 30.0, free=True),
    },
    drives={"u": Drive(8.0, (1.5, 12.0))},
    axes=(Axis("v", "q"),),
    gauges=(Gauge("q", "position"),),
    dt=0.02,
)
BOUNDS = {"c": (0.2, 1.8), "k": (15.0, 45.0)}
"""Of the free parameters: the prior is normal about the file's value, with the deviation of a
uniform one between the bounds."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What the engine believes before it sees a plant, and what it offers."""

    work: Workspace
    table: Table

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Everything that was offered."""
        return self.work.super_model.candidates

    @property
    def labels(self) -> list[str]:
        """Mechanisms at places that can be drawn."""
        names = dict.fromkeys(
            c.label for c in self.candidates if c.mechanism in (*LAWS, "wrong_value")
        )
        return [n for n in names if not n.startswith(LEFT_OUT)]

    def constants(self, rng: np.random.Generator, number: int) -> dict[str, float]:
        """Draw the constants of a candidate, by its own names."""
        candidate, model = self.candidates[number], self.work.super_model
        names, found = model.names[number], {}
        theta = model.seeded([number], self.work.theta)
        order = list(model.model.parameters)
        for spec in candidate.parameters:
            full = names[spec.name]
            mean, deviation = self._belief(number, spec.name, float(theta[order.index(full)]))
            low, high = model.model.parameters[full].bounds or (spec.low, spec.high)
            found[spec.name] = mean if spec.fixed else truncated(rng, mean, deviation, low, high)
        return found

    def _belief(self, number: int, own: str, value: float) -> tuple[float, float]:
        """Return mean and deviation: those of the table of columns, else by the value itself."""
        full, belief = self.work.super_model.names[number][own], self.table.belief
        k = self.table.names.get(full)
        # a limit far away is tried at its seed instead
        if k is not None and abs(belief.mean[k]) < FAR:
            return float(belief.mean[k]), float(belief.deviation[k])
        return value, abs(value) or 1.0


def truncated(
    rng: np.random.Generator, mean: float, deviation: float, low: float, high: float
) -> float:
    """Draw from a normal distribution cut at its bounds."""
    a, b = norm.cdf([(low - mean) / deviation, (high - mean) / deviation])
    return float(np.clip(norm.ppf(rng.uniform(a, b)) * deviation + mean, low, high))


def model() -> Model:
    """Return the model that the engine is given."""
    values = {n: c.low for n, c in PLANT.constants.items()}
    return parse_model(PLANT.model_text(values, BOUNDS, {"y": "q"}), "cheap.toml")


def recorded(
    rng: np.random.Generator, plant: Plant, signal: Signal, reach: Array | None = None
) -> Recording:
    """Integrate a plant and read its position."""
    time = signal.time[LEAD:]
    _, y = readings(plant, signal, PLANT.gauges, time, reach)
    noisy = y[0] + NOISE * y[0].std() * rng.normal(size=time.size)
    return Recording("run.csv", time, {"u": signal.values[0][LEAD:], "y": noisy})


def workspace(given: Model, recording: Recording) -> Workspace:
    """Return what the engine works with on a recording.

    Raises
    ------
    ArithmeticError
        Not even re-calibration can be followed.
    """
    course = followed(given, prepare(given, [recording]))
    if course is None:
        raise ArithmeticError("nothing can be followed")
    super_model = SuperModel.build(given, offered(given, course))
    return Workspace.build(super_model, course.prepared, course.seconds, course.null.noise)


def prior(given: Model, recording: Recording) -> Prior:
    """Return the prior that the engine has on a motion without any edit."""
    work = workspace(given, recording)
    return Prior(work, tabled(work, work.theta, work.narrow.segments.course))
