"""Experiments: how long, how fast, driven by what."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.concealed.systems import Array, System
from benchmarks.concealed.truth import Tape, World, replay

KINDS = ("multisine", "chirp", "switching", "steps")
STILL = ("multisine", "chirp")
"""Excitations without a mean, for plants that nothing holds in place."""


@dataclass(frozen=True, eq=False)
class Design:
    """The experiments of a case.

    Attributes
    ----------
    dt : float
    samples : int
        Of every experiment.
    learning, held : int
        How many experiments to learn from and to hold out.
    omega : float
        Rad/s, of the fastest motion of interest.
    q0, u0 : ndarray
        Rest.
    signal : ndarray, shape (drives or loops, samples, experiments)
        Inputs of an open loop; references of a closed one.
    closed : bool
    hold : str
    kinds : tuple of str
    """

    dt: float
    samples: int
    learning: int
    held: int
    omega: float
    q0: Array
    u0: Array
    signal: Array
    closed: bool
    hold: str
    kinds: tuple[str, ...]

    @property
    def experiments(self) -> int:
        """How many experiments there are."""
        return self.learning + self.held

    @property
    def length(self) -> float:
        """Seconds of an experiment."""
        return self.samples * self.dt

    def start(self, rng: np.random.Generator, system: System) -> Array:
        """Draw states at the start, near rest; shape (states, experiments)."""
        x = np.zeros((system.size * system.order, self.experiments))
        x[: system.size] = self.q0[:, None]
        spread = 0.1 * system.target * rng.normal(size=(system.size, self.experiments))
        if system.size == 2 and "n1" in system.constants:
            spread[1:] *= 0.0
        x[: system.size] += spread * (0.3 if system.order == 1 else 1.0)
        return x


def pace(system: System, p: dict[str, float]) -> float:
    """Return the fastest natural frequency about rest, or the plant's usual bandwidth."""
    q0, u0 = system.at_rest(p)
    world = World.of(system, p)
    x0 = np.zeros(system.size * system.order)
    x0[: system.size] = q0
    tape = Tape(u0[:, None, None], 1.0, "zero", np.zeros(1, int), np.zeros(1, int))
    step = 1e-6
    columns = []
    for i in range(x0.size):
        ends = []
        for side in (1, -1):
            x = x0.copy()
            x[i] += side * step
            ends.append(world.rates(0.0, x[:, None], tape, np.zeros(1), np.zeros(1, int))[:, 0])
        columns.append((ends[0] - ends[1]) / (2 * step))
    roots = np.linalg.eigvals(np.array(columns).T)
    if system.order == 1:
        return float(3.0 * np.abs(roots).max())
    swinging = np.abs(roots[np.abs(roots.imag) > 1e-3 * np.abs(roots).max()])
    return float(swinging.max()) if swinging.size else system.bandwidth


def shape(rng: np.random.Generator, kind: str, t: Array, omega: float, low: float = 0.15) -> Array:
    """Return an excitation of rms 1."""
    if kind == "multisine":
        lines = rng.integers(8, 16)
        w = omega * np.exp(rng.uniform(np.log(low), np.log(1.3), lines))
        x = np.sin(np.outer(t, w) + rng.uniform(0, 2 * np.pi, lines)).sum(1)
    elif kind == "chirp":
        w0, w1 = omega * low * 1.3, omega * rng.uniform(1.0, 1.6)
        if rng.integers(2):
            w0, w1 = w1, w0
        x = np.sin(w0 * t + (w1 - w0) * t**2 / (2 * t[-1]) + rng.uniform(0, 2 * np.pi))
    else:
        # levels held for a while: two of them, or any
        hold = (1.0 if kind == "switching" else 2.5) * np.pi / omega
        edges = np.cumsum(rng.uniform(0.5, 2.0, 10 + int(t[-1] / (0.5 * hold))) * hold)
        levels = rng.uniform(-1, 1, edges.size + 1)
        if kind == "switching":
            levels = np.sign(levels)
        x = levels[np.searchsorted(edges, t)]
        x = x - x.mean()
    return x / np.sqrt(np.mean(x**2))


def smoothed(x: Array, samples: float) -> Array:
    """Return x behind two first-order filters, as a trajectory generator gives it."""
    a = 1.0 - np.exp(-1.0 / max(samples, 1e-9))
    for _ in range(2):
        y, last = np.empty_like(x), x[0]
        for k, value in enumerate(x):
            last = last + a * (value - last)
            y[k] = last
        x = y
    return x


def design(
    rng: np.random.Generator,
    system: System,
    p: dict[str, float],
    closed: bool,
    narrow: bool = False,
    tiny: bool = False,
) -> Design:
    """Draw the experiments of a case, inputs scaled to the plant's usual motion.

    `narrow`: one sine at one amplitude in all experiments, which tells few causes apart.
    """
    omega = pace(system, p)
    per_period = rng.uniform(35.0, 60.0)
    dt = 2 * np.pi / (omega * per_period)
    dt = float(f"{dt:.2g}")
    learning = 3 if tiny else int(rng.integers(3, 6))
    samples = 240 if tiny else 80 * int(rng.integers(9, 15))
    count = learning + 2
    t = dt * np.arange(samples)
    loose = not system.springs and not system.turning and system.order == 2
    loose = loose or "n1" in system.constants
    options = STILL if loose and not closed else KINDS
    kinds = tuple(str(k) for k in rng.choice(options, count))
    rows = len(system.loops) if closed else len(system.drives)
    signal = np.empty((rows, samples, count))
    low = 0.3 if loose else 0.15
    single = omega * rng.uniform(0.35, 0.7)
    for e, kind in enumerate(kinds):
        for r in range(rows):
            x = shape(rng, kind, t, omega * (0.6 if closed else 1.0), low)
            if narrow:
                x = np.sqrt(2) * np.sin(single * t + rng.uniform(0, 2 * np.pi))
            x = x * (1.0 if narrow else rng.uniform(0.6, 1.2))
            if closed:
                x = smoothed(x, 0.3 / (omega * dt) if not narrow else 0.0)
            signal[r, :, e] = x
    q0, u0 = system.at_rest(p)
    hold = "zero" if closed or rng.uniform() < 0.3 else "linear"
    made = Design(
        dt,
        samples,
        learning,
        2,
        omega,
        q0,
        u0,
        signal,
        closed,
        hold,
        ("one sine",) * count if narrow else kinds,
    )
    if closed:
        lead = np.array([c for _, c in system.loops])
        return replace(made, signal=q0[lead][:, None, None] + system.target * signal)
    return _scaled(system, p, made)


def _scaled(system: System, p: dict[str, float], made: Design) -> Design:
    """Scale the inputs until the first coordinate moves as it usually does."""
    count, world = made.experiments, World.of(system, p)
    x0 = np.zeros((system.size * system.order, count))
    x0[: system.size] = made.q0[:, None]
    run = np.arange(count)
    weights = np.sqrt(np.mean(made.signal[0] ** 2, axis=0))
    m = np.array(
        [float(np.ravel(world.system.mass(x0[:, :1], p)[d.row][d.row])[0]) for d in system.drives]
    )
    scale = np.array([p[d.scale] if d.scale else 1.0 for d in system.drives])
    rate = made.omega**2 if system.order == 2 else made.omega
    amplitude = np.outer(system.target * m * rate / scale, np.ones(count))
    if not system.drives[0].actuated:
        amplitude = np.full((1, count), system.target)
    for _ in range(6):
        u = made.u0[:, None, None] + amplitude[:, None, :] * made.signal
        tape = Tape(u, made.dt, made.hold, run, np.zeros(count, int))
        x, _ = replay(world, tape, x0, made.samples, 2)
        moved = np.sqrt(np.mean((x[: system.size] - made.q0[:, None, None]) ** 2, axis=1))
        reach = moved.max(0) if system.turning else moved[0]
        reach = np.where(np.isfinite(reach), np.maximum(reach, 1e-9), 1e9)
        ratio = np.clip(system.target * weights / reach, 0.02, 3.0)
        amplitude = amplitude * ratio**0.9
        if np.all(np.abs(ratio - 1) < 0.15):
            break
    return replace(made, signal=made.u0[:, None, None] + amplitude[:, None, :] * made.signal)
