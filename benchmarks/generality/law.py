"""What a law is: a mechanism of CONTRACT.md, section 4, with its constants drawn to a size."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

Array = np.ndarray
Values = Mapping[str, Any]
SMOOTH = 0.01
"""Width over which dry friction reverses, in the rms speed."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What a law may look at: arrays (lanes,), its own states (states, lanes).

    Along a pair of axes q and v are differences. `soft` is the speed over which dry friction
    reverses, `u` the signal of an input.
    """

    t: Any
    q: Any
    v: Any
    u: Any = 0.0
    z: Any = ()
    soft: float = 1.0
    run: Any = 0

    @property
    def sign(self) -> Any:
        """The sign of the speed, smooth as dry friction is in the truth."""
        return np.tanh(self.v / self.soft)


@dataclass(frozen=True, eq=False)
class Scene:
    """The undisturbed motion at a place, over all recordings: arrays (samples,).

    Attributes
    ----------
    t, q, v, u, y : ndarray
        Time; coordinate, speed, input or reading, where the place has them.
    run : ndarray of int
        Recording of every sample.
    net : float
        Rms of the net force along the axis.
    dt, duration : float
    runs : int
        Recordings to learn from.
    """

    t: Array
    run: Array
    q: Array = field(default_factory=lambda: np.zeros(0))
    v: Array = field(default_factory=lambda: np.zeros(0))
    u: Array = field(default_factory=lambda: np.zeros(0))
    y: Array = field(default_factory=lambda: np.zeros(0))
    net: float = 1.0
    dt: float = 1.0
    duration: float = 1.0
    runs: int = 2

    @property
    def pace(self) -> float:
        """Dominant frequency of the motion, rad/s."""
        signal = self.v if self.v.any() else self.u
        change = np.diff(signal)[np.diff(self.run) == 0] / self.dt
        return float(np.sqrt(np.mean(change**2)) / (np.std(signal) + 1e-300))

    @property
    def centred(self) -> bool:
        """Whether the coordinate moves about zero."""
        return bool(abs(self.q.mean()) < 0.5 * self.q.std())

    def motion(self) -> Motion:
        """Return the motion as a law sees it."""
        return Motion(self.t, self.q, self.v, self.u, soft=self.soft, run=self.run)

    @property
    def soft(self) -> float:
        """Width over which dry friction reverses."""
        return SMOOTH * float(np.sqrt(np.mean(self.v**2))) + 1e-300 if self.v.size else 1.0


@dataclass(frozen=True, eq=False)
class Law:
    """A mechanism.

    Attributes
    ----------
    mechanism, family, verdict : str
        Name of the contract, family of this benchmark, verdict of the contract.
    kind : {"force", "pair", "inertia", "drive", "late_drive", "reading", "instants"}
        What it changes: a force along an axis or between two, the inertia of an axis, an input, the
        time of an input, a reading, the time of a reading.
    draw : callable
        (rng, scene) -> constants, of a size yet to be set; None where the motion does not ask for
        such a law.
    master : str or tuple of str
        The constants that set the size: linear ones where `bracket` is None.
    act : callable
        (motion, constants) -> force, input or reading.
    bracket : callable, optional
        (scene, constants) -> ends between which the master is sought for a size.
    rates : callable, optional
        (motion, constants) -> rates of its own states, as many as `states`.
    begin : callable, optional
        (motion, constants) -> start of its own states; zeros by default.
    unchecked : tuple of str
        Constants known up to convention only.
    needs : str
        "position", "turning", "straight" or nothing: of the axis.
    where : callable, optional
        Tells of a scene whether the law can be told there.
    """

    mechanism: str
    family: str
    verdict: str
    kind: str
    draw: Callable[[np.random.Generator, Scene], dict[str, float]]
    master: tuple[str, ...]
    act: Callable[[Motion, Values], Any]
    bracket: Callable[[Scene, Values], tuple[float, float]] | None = None
    states: int = 0
    rates: Callable[[Motion, Values], Any] | None = None
    begin: Callable[[Motion, Values], Any] | None = None
    unchecked: tuple[str, ...] = ()
    needs: str = ""
    where: Callable[[Scene], bool] | None = None

    def size(self, scene: Scene, constants: Values) -> float:
        """Return the rms of the effect along a motion, in that of what it acts upon.

        The net force along an axis, the input about its mean, the reading about its mean.
        """
        motion = replace(scene.motion(), z=self.followed(scene, constants))
        if self.kind in ("force", "pair", "inertia"):
            return _rms(self.act(motion, constants)) / scene.net
        if self.kind == "drive":
            return _rms(self.act(motion, constants) - scene.u) / float(np.std(scene.u))
        if self.kind == "reading":
            change = self.act(replace(motion, q=scene.y), constants) - scene.y
            return _rms(change) / float(np.std(scene.y))
        signal = scene.u if self.kind == "late_drive" else scene.y
        late = self.act(motion, constants)
        moved = [
            np.interp(late[own], scene.t[own], signal[own]) - signal[own]
            for own in (scene.run == r for r in np.unique(scene.run))
        ]
        return _rms(np.concatenate(moved)) / float(np.std(signal))

    def sized(self, scene: Scene, constants: dict[str, float], share: float) -> dict[str, float]:
        """Return constants that bring an effect of a size; the nearest size that there is."""
        if self.bracket is None:
            factor = share / self.size(scene, constants)
            return {n: v * factor if n in self.master else v for n, v in constants.items()}
        low, high = self.bracket(scene, constants)

        def left(logarithm: float) -> float:
            tried = {**constants, self.master[0]: float(np.exp(logarithm))}
            return self.size(scene, tried) - share

        lower, upper = float(np.log(low)), float(np.log(high))
        values = left(lower), left(upper)
        if values[0] * values[1] > 0.0:
            best = (lower, upper)[int(np.argmin(np.abs(values)))]
        else:
            best = float(np.asarray(brentq(left, lower, upper, xtol=1e-4)))
        return {**constants, self.master[0]: float(np.exp(best))}

    def followed(self, scene: Scene, constants: Values) -> Any:
        """Return its own states along a motion, by RK4 between samples."""
        if not self.states or self.rates is None:
            return ()
        rates, out = self.rates, np.zeros((self.states, scene.t.size))
        now = np.zeros(self.states)

        def at(k: int, share: float) -> Motion:
            def between(a: Array) -> Any:
                return a[k] + share * (a[k + 1] - a[k]) if a.size else 0.0

            return Motion(scene.t[k] + share * scene.dt, between(scene.q), between(scene.v),
                          between(scene.u), soft=scene.soft)  # fmt: skip

        for k in range(scene.t.size):
            if k == 0 or scene.run[k] != scene.run[k - 1]:
                start = replace(at(min(k, scene.t.size - 2), 0.0))
                now = np.zeros(self.states)
                if self.begin is not None:
                    now = np.array(self.begin(start, constants), dtype=float)
            out[:, k] = now
            if k + 1 < scene.t.size and scene.run[k + 1] == scene.run[k]:
                now = _step(rates, at, k, now, constants, scene.dt)
        return out


def _step(
    rates: Any, at: Callable[[int, float], Motion], k: int, z: Array, c: Values, dt: float
) -> Array:
    parts = 4  # states of laws are faster than samples
    h = dt / parts
    for i in range(parts):
        a, b, e = (at(k, (i + s) / parts) for s in (0.0, 0.5, 1.0))
        k1 = np.array(rates(replace(a, z=z), c))
        k2 = np.array(rates(replace(b, z=z + 0.5 * h * k1), c))
        k3 = np.array(rates(replace(b, z=z + 0.5 * h * k2), c))
        k4 = np.array(rates(replace(e, z=z + h * k3), c))
        z = z + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return z


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a positive number."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
