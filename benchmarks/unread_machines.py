"""Machines of which no sensor reads the positions, each with an effect that is left out.

Sizes of the bank of filters were settled on pendula, an arm, two wells and tanks like these: held
out are the cart, the strapped sensors and the generator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.expressions import evaluate
from jaxsr.models import Model, Simulator, parse_model
from jaxsr.models.field import Field, Point
from jaxsr.recordings import Recording

SAMPLES, RECORDINGS, NOISE, TONES = 1_000, 2, 2e-3, 3


@dataclass(frozen=True)
class Machine:
    """A machine, its sensors and what its model lacks.

    Attributes
    ----------
    text : str
        Model file.
    state : str
        Whose equation lacks a term.
    term : str
        What it lacks.
    mechanism : str
    interval : float
        Between samples, in s.
    drive : float
        Rms of every input.
    start : tuple of float
        Typical state at the begin.
    """

    text: str
    state: str
    term: str
    mechanism: str
    interval: float
    drive: float
    start: tuple[float, ...]

    @property
    def model(self) -> Model:
        """The model, without what it lacks."""
        return parse_model(self.text)

    def recordings(
        self, rng: np.random.Generator, lacking: bool, noise: float = NOISE
    ) -> list[Recording]:
        """Return recordings of the machine, with what the model lacks if it is `lacking`.

        `noise` is that of every sensor, in the deviation of what it reads.
        """
        model = self.model
        if lacking:
            equations = {**model.equations}
            equations[self.state] = f"{equations[self.state]} {self.term}"
            model = replace(model, equations=equations)
        return [self._recorded(model, rng, number, noise) for number in range(RECORDINGS)]

    def _recorded(
        self, model: Model, rng: np.random.Generator, number: int, noise: float
    ) -> Recording:
        time = np.arange(SAMPLES) * self.interval
        rates = rng.uniform(0.5, 9.0, (len(model.inputs), TONES, 1)) * 0.01 / self.interval
        phases = rng.uniform(0.0, 2.0 * np.pi, rates.shape)
        waves = np.sin(rates * time + phases).sum(axis=1)
        inputs = dict(zip(model.inputs, self.drive * waves / np.sqrt(0.5 * TONES), strict=True))
        known = {name: p.value for name, p in model.parameters.items()}
        field = Field(Simulator(model), list(known.values()))

        def rate(t: float, x: np.ndarray) -> list[float]:
            pushed = [np.interp(t, time, u) for u in inputs.values()]
            return [float(v) for v in field.rates(Point(np.float64(t), list(x), pushed))]

        start = np.array(self.start) * rng.uniform(0.7, 1.3, len(self.start))
        run = solve_ivp(
            rate,
            (0.0, time[-1]),
            start,
            t_eval=time,
            rtol=1e-8,
            atol=1e-9,
            method="LSODA",
            max_step=self.interval,
        )
        known |= dict(zip(model.states, run.y, strict=True)) | inputs
        channels = {y: np.asarray(evaluate(e, known)) for y, e in model.reading_terms.items()}
        for y, signal in channels.items():
            channels[y] = signal + noise * np.std(signal) * rng.standard_normal(time.size)
        return Recording(f"run{number}", time, {**inputs, **channels})


def _hanging(outputs: str, readings: str) -> str:
    """A pendulum whose angle is pi where it hangs."""
    return f"""
[model]
states = ["th", "w"]
outputs = {outputs}
[equations]
th = "w"
w = "64.0*sin(th) - c*w"
[readings]
{readings}
[parameters]
c = {{ value = 0.06, bounds = [0.0, 1.0] }}
"""


_CART = """
[model]
states = ["s", "th", "v", "w"]
inputs = ["u"]
outputs = ["y"]
[equations]
s = "v"
th = "w"
v = "u - 0.5*v + 0.3*w**2*sin(th)"
w = "-2.0*sin(th) - c*w"
[inertia]
v = { v = "2.0", w = "0.3*cos(th)" }
w = { v = "0.3*cos(th)", w = "0.2" }
[readings]
y = "s"
[parameters]
c = { value = 0.02, bounds = [0.0, 1.0] }
"""
_STRAPPED = """
[model]
states = ["th", "w"]
inputs = ["u"]
outputs = ["gyro", "a"]
[equations]
th = "w"
w = "u - 20.0*sin(th) - c*w"
[readings]
gyro = "w"
a = "0.4*w**2 + 9.81*cos(th)"
[parameters]
c = { value = 0.1, bounds = [0.0, 2.0] }
"""
_GENERATOR = """
[model]
states = ["d", "w"]
inputs = ["u"]
outputs = ["P"]
[equations]
d = "w"
w = "u - 1.5*sin(d) - c*w"
[readings]
P = "1.5*sin(d)"
[parameters]
c = { value = 0.2, bounds = [0.0, 2.0] }
"""
_TANKS = """
[model]
states = ["h1", "h2"]
inputs = ["u"]
outputs = ["p"]
[equations]
h1 = "1.0 + u - a*sqrt(Abs(h1))"
h2 = "a*sqrt(Abs(h1)) - b*sqrt(Abs(h2))"
[readings]
p = "9.81*h2"
[parameters]
a = { value = 0.6, bounds = [0.1, 2.0] }
b = { value = 0.5, bounds = [0.1, 2.0] }
"""
_WELLS = """
[model]
states = ["x", "v"]
inputs = ["u"]
outputs = ["light"]
[equations]
x = "v"
v = "u + x - x**3 - c*v"
[readings]
light = "(x + 0.3)**2"
[parameters]
c = { value = 0.1, bounds = [0.0, 1.0] }
"""
_ARM = """
[model]
states = ["q1", "q2", "w1", "w2"]
inputs = ["u1", "u2"]
outputs = ["x", "y"]
[equations]
q1 = "w1"
q2 = "w2"
w1 = "u1 - c*w1 - 5*(2*cos(q1) + cos(q1 + q2)) + sin(q2)*(2*w1*w2 + w2**2)"
w2 = "u2 - c*w2 - 5*cos(q1 + q2) - sin(q2)*w1**2"
[inertia]
w1 = { w1 = "3 + 2*cos(q2)", w2 = "1 + cos(q2)" }
w2 = { w1 = "1 + cos(q2)", w2 = "1" }
[readings]
x = "cos(q1) + cos(q1 + q2)"
y = "sin(q1) + sin(q1 + q2)"
[parameters]
c = { value = 0.3, bounds = [0.0, 3.0] }
"""
_MARKER = _hanging('["x"]', 'x = "0.4*sin(th)"')
_GYRO = _hanging('["g"]', 'g = "w"')
_BENT = _hanging('["y"]', 'y = "th + e1*sin(th) + e2*cos(th)"')
_ECCENTRIC = _BENT + "".join(
    f"{e} = {{ value = 0.0, bounds = [-0.1, 0.1] }}\n" for e in ("e1", "e2")
)
_DRAG, _DRY = "quadratic_drag", "coulomb_friction"

MACHINES = {
    "marker": Machine(_MARKER, "w", "- 0.03*w*Abs(w)", _DRAG, 0.01, 0.0, (1.6, 0.0)),
    "gyro": Machine(_GYRO, "w", "- 0.6*tanh(w/0.01)", _DRY, 0.01, 0.0, (1.6, 0.0)),
    "eccentric encoder": Machine(_ECCENTRIC, "w", "- 0.03*w*Abs(w)", _DRAG, 0.01, 0.0, (1.6, 0.0)),
    "cart": Machine(_CART, "w", "- 0.08*tanh(w/0.01)", _DRY, 0.01, 2.0, (0.1, 0.8, 0.0, 0.0)),
    "strapped sensors": Machine(_STRAPPED, "w", "- 0.05*w*Abs(w)", _DRAG, 0.01, 2.0, (1.0, 0.0)),
    "generator": Machine(_GENERATOR, "w", "- 0.15*w*Abs(w)", _DRAG, 0.05, 0.4, (0.7, 0.0)),
    "tanks": Machine(_TANKS, "h1", "- 0.08*h1", "linear_stiffness", 0.2, 0.35, (2.5, 1.2)),
    "intensity of light": Machine(_WELLS, "v", "- 0.2*v*Abs(v)", _DRAG, 0.02, 0.3, (1.3, 0.0)),
    "tip of an arm": Machine(_ARM, "w2", "- 0.8*tanh(w2/0.01)", _DRY, 0.01, 4.0, (-1.2, 0.5, 0, 0)),
}
"""By what their sensors are."""
