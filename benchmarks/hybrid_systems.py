"""Systems that switch, and smooth ones that do not: recordings whose laws and guards are known."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr import Recording
from jaxsr.expressions import parse, to_numpy

TIGHT = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}
Start = tuple[float, ...]
_SIMULATED: dict[tuple, list[Recording]] = {}


@dataclass(frozen=True)
class Falling:
    """An event that ends an integration where a function of time and state falls through zero."""

    height: Callable[[float, np.ndarray], float]
    terminal = True
    direction = -1

    def __call__(self, t: float, x: np.ndarray) -> float:
        """Return the function whose zero is the event."""
        return self.height(t, x)


@dataclass(frozen=True)
class TrueMode:
    """Where a mode holds and its laws, as text."""

    guard: str
    laws: Mapping[str, str]


@dataclass(frozen=True)
class HybridSystem:
    """A system of several modes; laws that all modes share stand in ``common``.

    Attributes
    ----------
    thresholds : tuple of (str, float)
        Guard variable and the value at which it switches.
    starts, unseen : tuple
        Initial states of the recordings to learn from, and of those held out.
    end, unseen_end : float
        Seconds.
    step : float
        Seconds between samples.
    reset : mapping of str to str
        What becomes of states at an impact, where ``event`` falls through zero.
    """

    name: str
    common: Mapping[str, str]
    modes: Sequence[TrueMode]
    thresholds: tuple[tuple[str, float], ...]
    starts: tuple[Start, ...]
    unseen: tuple[Start, ...]
    end: float
    step: float
    unseen_end: float | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)
    event: str | None = None
    reset: Mapping[str, str] = field(default_factory=dict)

    @property
    def states(self) -> list[str]:
        """Return the states in order."""
        return [*self.common, *self.modes[0].laws] if self.modes else [*self.common]

    @property
    def derivatives(self) -> list[str]:
        """Return the columns of the derivatives."""
        return [f"d_{s}" for s in self.states]

    def mode_of(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the number of the true mode of every sample (samples,)."""
        out = np.full(len(next(iter(values.values()))), -1)
        for number, mode in reversed(list(enumerate(self.modes))):
            held = to_numpy(parse(mode.guard))(values)
            out[np.broadcast_to(held, out.shape)] = number
        return out

    def rates(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the derivatives on samples."""
        count = len(next(iter(values.values())))
        out = {s: np.broadcast_to(to_numpy(parse(law))(values), (count,)).astype(float)
               for s, law in self.common.items()}  # fmt: skip
        number = self.mode_of(values)
        for state in self.modes[0].laws if self.modes else ():
            laws = [to_numpy(parse(m.laws[state]))(values) for m in self.modes]
            laws = np.array([np.broadcast_to(law, (count,)) for law in laws])
            out[state] = laws[number, np.arange(count)].astype(float)
        return out

    def record(self, start: Start, end: float, name: str) -> Recording:
        """Return states, inputs and derivatives of the motion from ``start``."""
        time = np.arange(round(end / self.step) + 1) * self.step
        drive = {n: to_numpy(parse(law)) for n, law in self.inputs.items()}

        def values(t: np.ndarray, x: np.ndarray) -> dict[str, np.ndarray]:
            out = {"t": t, **dict(zip(self.states, x, strict=True))}
            return out | {n: np.broadcast_to(f({"t": t}), t.shape) for n, f in drive.items()}

        def field_(t: float, x: np.ndarray) -> np.ndarray:
            rates = self.rates(values(np.array([t]), x[:, None]))
            return np.array([rates[s][0] for s in self.states])

        x = self._integrated(field_, np.array(start, float), time, values)
        table = values(time, x)
        rates = self.rates(table)
        channels = {n: np.array(v) for n, v in table.items() if n != "t"}
        channels |= {f"d_{s}": rates[s] for s in self.states}
        return Recording(name, time, channels)

    def _integrated(
        self, field_: Callable, start: np.ndarray, time: np.ndarray, values: Callable
    ) -> np.ndarray:
        out = np.empty((len(start), len(time)))
        now, x, place = float(time[0]), start, 0
        crossed = None
        if self.event is not None:
            when = to_numpy(parse(self.event))

            def height(t: float, x: np.ndarray) -> float:
                return float(when(values(np.array([t]), x[:, None]))[0])

            crossed = Falling(height)
        while place < len(time):
            asked = time[place:]
            found = solve_ivp(
                field_, (now, time[-1]), x, t_eval=asked, events=crossed,
                max_step=self.step / 4.0 if self.event is None else np.inf, **TIGHT,
            )  # fmt: skip
            count = found.y.shape[1] if found.t.size else 0
            out[:, place : place + count] = found.y
            place += count
            if found.status != 1:
                break
            now, at = float(found.t_events[0][0]), found.y_events[0][0]
            table = values(np.array([now]), at[:, None])
            x = at.copy()
            for state, law in self.reset.items():
                x[self.states.index(state)] = float(to_numpy(parse(law))(table).ravel()[0])
        return out

    def training(self, seed: int = 0) -> list[Recording]:
        """Return the recordings to learn from; seeds other than 0 start a little elsewhere."""
        return self._kept("start", self._moved(seed), self.end)

    def held_out(self) -> list[Recording]:
        """Return the recordings for free runs."""
        return self._kept("unseen", list(self.unseen), self.unseen_end or self.end)

    def _kept(self, name: str, starts: list[Start], end: float) -> list[Recording]:
        key = (self.name, end, *starts)
        if key not in _SIMULATED:
            _SIMULATED[key] = [self.record(s, end, f"{name} {k}") for k, s in enumerate(starts)]
        return _SIMULATED[key]

    def _moved(self, seed: int) -> list[Start]:
        if seed == 0:
            return list(self.starts)
        rng = np.random.default_rng(seed)
        return [tuple(v * (1.0 + 0.1 * rng.uniform(-1.0, 1.0)) for v in s) for s in self.starts]


GRAVITY = 9.81
STRIBECK = HybridSystem(
    "friction (example iii)",
    {"z1": "z2"},
    (
        TrueMode("Abs(z2) > 0.1", {"z2": "20*sin(2*t) - 200*z1 - 0.63765*sign(z2)"
                 f" - {0.085 * GRAVITY * np.exp(0.3)}*sign(z2)*exp(-3*Abs(z2))"}),
        TrueMode("True", {"z2": "20*sin(2*t) - 200*z1 - 29.43*z2 + 147.15*z2*Abs(z2)"}),
    ),
    (("Abs(z2)", 0.1),),
    ((0.0, 0.0), (0.001, 0.0), (-0.001, 0.0)),
    ((0.0, 0.15), (-0.01, 0.02)),
    5.0, 5.0 / 249.0, 10.0,
)  # fmt: skip
BALL = HybridSystem(
    "ball on a soft floor",
    {"x": "v"},
    (
        TrueMode("x > 0.1", {"v": "-9.81 - 0.1*v*Abs(v)"}),
        TrueMode("True", {"v": "-9.81 - 0.1*v*Abs(v) - 2000*(x - 0.1) - 5*v"}),
    ),
    (("x", 0.1),),
    ((1.0, 0.0), (0.6, 1.0), (1.4, -1.0)),
    ((0.8, 0.5),),
    2.5, 0.005,
)  # fmt: skip
IMPACT = HybridSystem(
    "ball on a hard floor",
    {"x": "v"},
    (TrueMode("True", {"v": "-9.81 - 0.1*v*Abs(v)"}),),
    (),
    ((1.0, 0.0), (0.6, 1.0), (1.4, -1.0)),
    ((0.8, 0.5),),
    2.0, 0.005,
    event="x", reset={"x": "0", "v": "-0.8*v"},
)  # fmt: skip
HOPPER = HybridSystem(
    "spring-mass hopper",
    {"y": "v"},
    (
        TrueMode("y > 1.0", {"v": "-9.81"}),
        TrueMode("True", {"v": "-9.81 - 300*(y - 1.0)"}),
    ),
    (("y", 1.0),),
    ((1.3, 0.0), (1.15, 0.5), (1.2, -1.0)),
    ((1.25, 0.2),),
    3.0, 0.01,
)  # fmt: skip
KNEE = HybridSystem(
    "knee ligament (Eq. 21)",
    {"e": "w"},
    (
        TrueMode("e < 0", {"w": "u - w - 20*e"}),
        TrueMode("e > 0.06", {"w": "u - w - 20*e - 400*(e - 0.03)"}),
        TrueMode("True", {"w": "u - w - 20*e - 400*e**2/0.12"}),
    ),
    (("e", 0.0), ("e", 0.06)),
    ((0.02, 0.0), (0.08, 0.3), (-0.02, 0.5)),
    ((0.05, -0.2),),
    6.0, 0.01,
    inputs={"u": "2 + 4*sin(3*t) + 6*sin(7.3*t + 1)"},
)  # fmt: skip
BACKLASH = HybridSystem(
    "backlash in a drive",
    {"q1": "v1", "q2": "v2"},
    (
        TrueMode("q1 - q2 > 0.05", {"v1": "5*u - v1 - 300*(q1 - q2 - 0.05)",
                                    "v2": "200*(q1 - q2 - 0.05) - 0.5*v2"}),
        TrueMode("q1 - q2 < -0.05", {"v1": "5*u - v1 - 300*(q1 - q2 + 0.05)",
                                     "v2": "200*(q1 - q2 + 0.05) - 0.5*v2"}),
        TrueMode("True", {"v1": "5*u - v1", "v2": "-0.5*v2"}),
    ),
    (("Abs(q1 - q2)", 0.05),),
    ((0.0, 0.0, 0.0, 0.0), (0.02, 0.0, 0.5, -0.3), (-0.04, 0.0, -0.5, 0.6)),
    ((0.01, 0.0, 0.3, 0.3),),
    5.0, 0.01,
    inputs={"u": "sin(2.1*t) + 0.7*sin(5.3*t + 0.5)"},
)  # fmt: skip
TANK = HybridSystem(
    "tank that overflows",
    {},
    (
        TrueMode("h > 2.0", {"h": "0.5*u - 0.4*sqrt(h) - 3*(h - 2.0)"}),
        TrueMode("True", {"h": "0.5*u - 0.4*sqrt(h)"}),
    ),
    (("h", 2.0),),
    ((0.5,), (1.9,), (1.2,)),
    ((1.0,),),
    40.0, 0.1,
    inputs={"u": "1.2 + 0.8*sin(0.31*t) + 0.5*sin(1.1*t + 1)"},
)  # fmt: skip
SYSTEMS = {
    s.name: s for s in (STRIBECK, BALL, IMPACT, HOPPER, KNEE, BACKLASH, TANK)
}  # fmt: skip


def hardly_touching(seed: int, share: float) -> list[Recording]:
    """Return recordings of the soft ball, its contact thinned to a share of its flight."""
    rng = np.random.default_rng(seed)
    data = []
    for r in BALL.training(seed):
        touch = r.channels["x"] <= 0.1
        keep = ~touch
        most = int(share * np.count_nonzero(~touch))
        keep[rng.choice(np.flatnonzero(touch), min(most, touch.sum()), replace=False)] = True
        channels = {n: v[keep] for n, v in r.channels.items()}
        data.append(Recording(r.name, r.time[keep], channels))
    return data


def smooth(
    name: str,
    laws: Mapping[str, str],
    starts: Sequence[Start],
    end: float,
    step: float = 0.02,
    inputs: Mapping[str, str] | None = None,
) -> HybridSystem:
    """Return a system of one law."""
    drive = inputs or {}
    return HybridSystem(name, laws, (), (), tuple(starts), (), end, step, inputs=drive)


PLANE = ((1.0, 0.0), (0.3, -0.8))
ONE_LAW = (
    smooth("oscillator", {"x": "v", "v": "-4*x - 0.3*v"}, PLANE, 8.0),
    smooth("pendulum", {"x": "v", "v": "-9.81*sin(x) - 0.2*v"}, ((2.5, 0.0), (0.3, -4.0)), 8.0),
    smooth("Duffing", {"x": "v", "v": "x - x**3 - 0.2*v + 0.4*cos(1.3*t)"}, PLANE, 15.0),
    smooth("van der Pol", {"x": "v", "v": "2*(1 - x**2)*v - x"}, ((0.5, 0.0), (2.0, 1.0)), 10.0),
    smooth("Lotka-Volterra", {"x": "x - 0.5*x*y", "y": "0.3*x*y - 0.8*y"},
           ((2.0, 1.0), (4.0, 3.0)), 12.0),
    smooth("Lorenz", {"x": "10*(y - x)", "y": "x*(28 - z) - y", "z": "x*y - 8*z/3"},
           ((1.0, 1.0, 20.0), (-5.0, 2.0, 25.0)), 5.0, 0.005),
    smooth("Roessler", {"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + z*(x - 5.7)"},
           ((1.0, 1.0, 0.0), (-4.0, 2.0, 0.0)), 20.0, 0.02),
    smooth("Brusselator", {"x": "1 + x**2*y - 4*x", "y": "3*x - x**2*y"},
           ((1.0, 1.0), (2.0, 3.0)), 12.0),
    smooth("FitzHugh-Nagumo", {"x": "x - x**3/3 - y + 0.5", "y": "0.08*(x + 0.7 - 0.8*y)"},
           ((0.0, 0.0), (-1.0, 1.0)), 60.0, 0.1),
    smooth("SIR", {"x": "-0.9*x*y", "y": "0.9*x*y - 0.2*y"}, ((0.99, 0.01), (0.7, 0.1)), 30.0, 0.1),
    smooth("quadratic drag", {"x": "v", "v": "-5*x - 0.4*v*Abs(v)"}, ((2.0, 0.0), (0.5, 3.0)), 8.0),
    smooth("cubic spring", {"x": "v", "v": "-2*x - 3*x**3 - 0.1*v + 2*sin(1.7*t)"}, PLANE, 12.0),
    smooth("tanh friction", {"x": "v", "v": "-6*x - 0.8*tanh(3*v)"}, ((2.0, 0.0), (1.0, 3.0)), 8.0),
    smooth("Coulomb friction", {"x": "v", "v": "-6*x - 0.5*sign(v) + u"},
           ((1.0, 0.0), (1.0, 2.0)), 8.0, inputs={"u": "4*sin(2.1*t)"}),
    smooth("Michaelis-Menten", {"x": "u - 2*x/(0.5 + x)"}, ((1.0,), (3.0,)), 20.0, 0.05,
           inputs={"u": "0.8 + 0.6*sin(0.7*t)"}),
    smooth("tank", {"h": "0.5*u - 0.4*sqrt(h)"}, ((0.5,), (1.5,)), 40.0, 0.1,
           inputs={"u": "1 + 0.6*sin(0.4*t)"}),
    smooth("two masses", {"x": "v", "y": "w", "v": "-50*x + 30*y", "w": "60*x - 100*y"},
           ((1.0, 0.0, 0.0, 0.0), (0.0, 0.5, 1.0, 0.0)), 4.0, 0.01),
    smooth("magnet", {"x": "v", "v": "-9*x + 0.5/(x + 2)**2 - 0.2*v"}, PLANE, 8.0),
    smooth("rolling ship", {"x": "v", "v": "-x + x**3/6 - 0.1*v - 0.05*v**3 + 0.2*cos(0.9*t)"},
           ((0.5, 0.0), (0.1, 0.6)), 20.0, 0.04),
    smooth("logistic", {"x": "1.2*x*(1 - x/3) + 0.2*u"}, ((0.1,), (4.0,)), 12.0, 0.05,
           inputs={"u": "sin(1.4*t)"}),
)  # fmt: skip
"""Twenty systems that must not be split."""
