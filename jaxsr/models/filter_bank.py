r"""Where states are that no sensor reads, and on which a model depends otherwise than in a line.

A bank of cubature Kalman filters (Arasaratnam & Haykin, IEEE Trans. Autom. Control 54 (2009)), each
from another start and with another size of model error; those that the readings make least likely
are given up, half at a time (Gaussian sums, Alspach & Sorenson, IEEE Trans. Autom. Control 17
(1972)). What is left is smoothed backwards (Rauch, Tung & Striebel, AIAA J. 3 (1965)).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from jaxsr._deadline import ask
from jaxsr.expressions import Term, affine_slope
from jaxsr.models.field import Field, Point
from jaxsr.models.inputs import stage_inputs
from jaxsr.models.model import FREE, Model
from jaxsr.models.simulator import Simulator
from jaxsr.models.states import StateEstimate

Array = Any
STARTS, SEED = 128, 0
"""Of the bank, and of their draw."""
CERTAIN = 1e-6
"""Doubt about a start that [initial] gives, in the size of its state."""
HALVING, ROUNDS = 32, 64
"""Samples, at least, and times as many in a recording, after which half of the bank is given up."""
SHARES = (0.1, 1.0)
"""Sizes of the model's error in a sample, as shares of the rates."""
LONGEST, TURN = 5_000, 0.2
"""Samples that are filtered, and how far readings may go from one to the next, in their deviation:
of a sensor that is read more often every so many are left out."""
FEWEST = 200
"""Samples that are filtered, where a recording has as many."""
ROUNDED = 1e-12
"""What sensors that read alike differ by, of what they read."""
FLOOR = 1e-3
"""Least noise of a sensor, in its deviation: a filter without any doubt leads nowhere else."""


def bends(model: Model, hidden: Collection[str]) -> bool:
    """Whether equations or readings depend on hidden states otherwise than in a line.

    Where they do not, a linear smoother is right from any start.
    """
    return any(_bends(term, frozenset(hidden)) for term in _terms(model))


def _terms(model: Model) -> list[Term]:
    """Return all that a model says of rates, masses and readings."""
    masses = [e for row in model.inertia_terms.values() for e in row.values()]
    return [*model.equation_terms.values(), *masses, *model.reading_terms.values()]


def _bends(term: Term, hidden: frozenset[str]) -> bool:
    slopes = [affine_slope(term, name) for name in hidden & term.variables]
    return any(slope is None or slope.variables & hidden for slope in slopes)


def found_along(
    model: Model, estimate: StateEstimate, time: Array, inputs: Array, outputs: Array
) -> Array:
    """Return all states at the first `LONGEST` samples, from the start that readings tell.

    Parameters
    ----------
    estimate : StateEstimate
        With the start that is tried first.
    outputs : ndarray, shape (samples, outputs)
        NaN where missing.

    Returns
    -------
    ndarray, shape (samples, states)
        Not finite where no start leads anywhere.
    """
    every = _every(outputs)
    rows = slice(0, LONGEST * every, every)
    held = _means(inputs, every)[rows] if every > 1 else None
    scene = _Scene.of(model, time[rows], inputs[rows], outputs[rows], held)
    try:
        path = scene.smoothed(scene.likeliest(_starts(model, estimate, scene)))
    except np.linalg.LinAlgError:  # what is believed of the states has no bounds
        path = np.full((1, len(model.states)), np.nan)
    if every == 1 or not np.isfinite(path).all():
        return path
    return CubicSpline(scene.time, path)(time[: (len(path) - 1) * every + 1])


def _every(outputs: Array) -> int:
    """Return how many samples make one of the filter."""
    pace, seen = _pace(outputs), np.isfinite(outputs)
    most = int(np.clip(TURN / max(pace, 1e-12), 1, max(len(outputs) // FEWEST, 1)))
    whole = seen.sum(axis=0)
    # A slow sensor may be read in between.
    return next(k for k in range(most, 0, -1) if (2 * k * seen[::k].sum(axis=0) >= whole).all())


def _pace(outputs: Array) -> float:
    """Return how far readings go from one sample to the next, in their deviation, at most."""
    size, moves = _mean_square(outputs - _mean(outputs)), _mean_square(np.diff(outputs, axis=0))
    moves = np.maximum(moves - 2.0 * _noise(outputs), 0.0)
    return float(np.sqrt(np.max(moves[size > 0.0] / size[size > 0.0], initial=0.0)))


def _noise(outputs: Array) -> Array:
    """Return variances of the sensors: what neighbours tell, and not less than `FLOOR`."""
    size = _mean_square(outputs - _mean(outputs))
    found = _mean_square(np.diff(outputs, 2, axis=0)) / 6.0 + FLOOR**2 * size
    return np.where(found > 0.0, found, 1.0)


def _mean(values: Array) -> Array:
    """Return the mean of every column, of what is there; 0 where nothing is."""
    there = np.isfinite(values)
    return np.sum(values, axis=0, where=there) / np.maximum(there.sum(axis=0), 1)


def _mean_square(values: Array) -> Array:
    return _mean(values**2)


def _means(inputs: Array, count: int) -> Array:
    """Return the means of inputs over so many samples from each on."""
    if count == 1 or not inputs.size:
        return inputs
    padded = np.concatenate([inputs, np.repeat(inputs[-1:], count - 1, axis=0)])
    sums = np.cumsum(np.concatenate([np.zeros((1, inputs.shape[1])), padded]), axis=0)
    return (sums[count:] - sums[:-count]) / count


@dataclass(frozen=True, eq=False)
class _Bank:
    """Beliefs of the states, a row a filter.

    Attributes
    ----------
    x, spread : ndarray, shapes (filters, states), (filters, states, states)
    share : ndarray, shape (filters,)
        Of the rates that the model's error has.
    rates : ndarray, shape (filters, states)
        Mean squares up to now.
    log : ndarray, shape (filters,)
        Log likelihood of the readings up to now.
    begun : _Bank, optional
        As the filters started.
    """

    x: Array
    spread: Array
    share: Array
    rates: Array
    log: Array
    begun: _Bank | None = None

    def chosen(self, which: Any) -> _Bank:
        """Return some of the filters."""
        begun = None if self.begun is None else self.begun.chosen(which)
        x, spread, share = self.x[which], self.spread[which], self.share[which]
        return _Bank(x, spread, share, self.rates[which], self.log[which], begun)


@dataclass(frozen=True, eq=False)
class _Scene:
    """A model's field beside a recording.

    Attributes
    ----------
    field : Field
    time : ndarray, shape (samples,)
    stages : list of ndarray, shape (3, samples - 1)
        Inputs at start, middle and end of every step.
    inputs : ndarray, shape (samples, inputs)
    outputs : ndarray, shape (samples, outputs)
    noise : ndarray, shape (outputs,)
        Variances.
    pushed : ndarray of bool, shape (states,)
        States whose equation says more than that they are another one's integral.
    """

    field: Field
    time: Array
    stages: list[Array]
    inputs: Array
    outputs: Array
    noise: Array
    pushed: Array

    @staticmethod
    def of(
        model: Model, time: Array, inputs: Array, outputs: Array, held: Array | None = None
    ) -> _Scene:
        """Return the scene; inputs act over a step by their averages, if these are given."""
        simulator = Simulator(model)
        pushed_by, hold = (inputs, model.input_hold) if held is None else (held, "zero")
        tables = [stage_inputs(time, u, hold, 1) for u in pushed_by.T]
        stages = [np.stack([t[:, 0] for t in table]) for table in tables]
        pushed = np.array([s in model.dynamic_states for s in model.states])
        field = Field(simulator, simulator.values())
        return _Scene(field, time, stages, inputs, outputs, _noise(outputs), pushed)

    def step(self, bank: _Bank, k: int) -> tuple[_Bank, tuple[Array, Array, Array] | None]:
        """Lead a bank from the sample before to sample k, and show it the readings there.

        Returns
        -------
        bank : _Bank
        led : tuple of ndarray, optional
            What was believed of the states before the readings, and how that goes with the states
            one sample before.
        """
        led = None
        if k:
            bank, led = self._led(bank, k - 1)
        return self._corrected(bank, k), led

    def _led(self, bank: _Bank, k: int) -> tuple[_Bank, tuple[Array, Array, Array]]:
        points = _points(bank.x, bank.spread)
        ends, rates = self._advanced(points, k)
        h = self.time[k + 1] - self.time[k]
        count = k + 1
        size = bank.rates + ((rates**2).mean(1) - bank.rates) / count
        x = ends.mean(1)
        apart = ends - x[:, None]
        spread = np.swapaxes(apart, 1, 2) @ apart / points.shape[1]
        doubt = size * (bank.share[:, None] * h) ** 2 * self.pushed
        spread[:, np.arange(x.shape[1]), np.arange(x.shape[1])] += doubt
        before = points - bank.x[:, None]
        cross = np.swapaxes(before, 1, 2) @ apart / points.shape[1]
        moved = replace(bank, x=x, spread=spread, rates=size)
        return moved, (x, spread, cross)

    def _advanced(self, points: Array, k: int) -> tuple[Array, Array]:
        """Return where a step of the classical Runge-Kutta method leads, and the first rates."""
        x, (t, after) = np.moveaxis(points, -1, 0), self.time[k : k + 2]
        h = after - t

        def rates(share: float, along: Array | None, stage: int) -> Array:
            there = x if along is None else x + share * h * along
            inputs = [np.full(x.shape[1:], table[stage, k]) for table in self.stages]
            time = np.full(x.shape[1:], t + share * h)
            return np.stack(self.field.rates(Point(time, list(there), inputs)))

        k1 = rates(0.0, None, 0)
        k2 = rates(0.5, k1, 1)
        k3 = rates(0.5, k2, 1)
        k4 = rates(1.0, k3, 2)
        ends = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return np.moveaxis(ends, 0, -1), np.moveaxis(k1, 0, -1)

    def _corrected(self, bank: _Bank, k: int) -> _Bank:
        seen = np.isfinite(self.outputs[k])
        if not seen.any():
            return bank
        points = _points(bank.x, bank.spread)
        shape = points.shape[:-1]
        inputs = [np.full(shape, u) for u in self.inputs[k]]
        at = Point(np.full(shape, self.time[k]), list(np.moveaxis(points, -1, 0)), inputs)
        y = np.stack([np.broadcast_to(v, shape) for v in self.field.readings(at)[0]], -1)[..., seen]
        mean = y.mean(1)
        off, apart = y - mean[:, None], points - bank.x[:, None]
        count = points.shape[1]
        told = np.swapaxes(off, 1, 2) @ off / count + np.diag(self.noise[seen])
        cross = np.swapaxes(off, 1, 2) @ apart / count
        missed = (self.outputs[k, seen] - mean)[:, None]
        good = np.isfinite(told).all((1, 2)) & np.isfinite(missed).all((1, 2))
        if not good.all():
            told[~good], missed[~good], cross[~good] = np.eye(int(seen.sum())), 0.0, 0.0
        size = np.trace(told, axis1=1, axis2=2)
        inverse = np.linalg.inv(told + ROUNDED * size[:, None, None] * np.eye(told.shape[1]))
        likely = (missed @ inverse @ np.swapaxes(missed, 1, 2))[:, 0, 0]
        log = bank.log - 0.5 * (likely - np.linalg.slogdet(inverse)[1])
        gain = inverse @ cross
        x = bank.x + (missed @ gain)[:, 0]
        spread = bank.spread - np.swapaxes(cross, 1, 2) @ gain
        return replace(bank, x=x, spread=spread, log=np.where(good, log, -np.inf))

    def likeliest(self, bank: _Bank) -> _Bank:
        """Return the one filter that is left, as it started."""
        count = len(self.time)
        stretch = max(HALVING, count // ROUNDS)
        for begin in range(0, count, stretch):
            if len(bank.x) == 1:
                break
            ask()
            stop = min(begin + stretch, count)
            for k in range(begin, stop):
                bank, _ = self.step(bank, k)
            left = (len(bank.x) + 1) // 2 if stop < count else 1
            bank = bank.chosen(np.argsort(-bank.log, kind="stable")[:left])
        assert bank.begun is not None
        return bank.begun

    def smoothed(self, bank: _Bank) -> Array:
        """Return the states that one filter finds, smoothed, shape (samples, states)."""
        known, led = [], []
        for k in range(len(self.time)):
            if k % HALVING == 0:
                ask()
            bank, told = self.step(bank, k)
            known.append(bank.x[0])
            led.append(told)
        path = np.array(known)
        for k in reversed(range(len(path) - 1)):
            x, spread, cross = (part[0] for part in led[k + 1])
            gain = cross @ np.linalg.pinv(spread, hermitian=True)
            path[k] = path[k] + gain @ (path[k + 1] - x)
        return path


def _points(x: Array, spread: Array) -> Array:
    """Return points that have this mean and spread, shape (filters, points, states)."""
    spread = 0.5 * (spread + np.swapaxes(spread, 1, 2))
    size = np.sqrt(x.shape[1])
    try:
        columns = size * np.swapaxes(np.linalg.cholesky(spread), 1, 2)
    except np.linalg.LinAlgError:  # what is known for certain, or a filter that leads nowhere
        finite = np.isfinite(spread).all((1, 2))[:, None, None]
        sizes, axes = np.linalg.eigh(np.where(finite, spread, 0.0))
        root = axes * np.sqrt(np.maximum(sizes, 0.0))[:, None]
        columns = size * np.swapaxes(root, 1, 2)
    return x[:, None] + np.concatenate([columns, -columns], axis=1)


def _starts(model: Model, estimate: StateEstimate, scene: _Scene) -> _Bank:
    """Return the bank: the start that there is, and others for what is hidden and free."""
    free = [i for i, s in enumerate(model.states) if _open(model, estimate, s)]
    size, turns = _sizes(model, estimate, scene)
    drawn = np.random.default_rng(SEED).random((STARTS, max(len(free), 1)))
    x = np.tile(estimate.values[0], (STARTS, 1))
    given = [model.initial.get(s, FREE) != FREE for s in model.states]
    deviation = np.tile(np.where(given, CERTAIN, 0.1) * size, (STARTS, 1))
    apart = len(drawn) ** (-1.0 / max(len(free), 1))
    for column, i in enumerate(free):
        share = 2.0 * drawn[1:, column] - 1.0
        if turns[i]:
            x[1:, i], deviation[:, i] = np.pi * share, np.pi * apart
        else:  # orders of magnitude are not known: the quantiles of Cauchy's distribution
            x[1:, i] = size[i] * np.tan(0.5 * np.pi * share)
            deviation[:, i] = np.maximum(np.abs(x[:, i]), size[i]) * max(apart, 0.1)
    shares = np.tile(SHARES, STARTS // len(SHARES))
    spread = np.einsum("ci,ij->cij", deviation**2, np.eye(x.shape[1]))
    bank = _Bank(x, spread, shares, np.zeros_like(x), np.zeros(STARTS))
    return replace(bank, begun=bank)


def _open(model: Model, estimate: StateEstimate, state: str) -> bool:
    return state in estimate.hidden and model.initial.get(state, FREE) == FREE


def _sizes(model: Model, estimate: StateEstimate, scene: _Scene) -> tuple[Array, Array]:
    """Return the size that states may have, and which of the hidden ones are angles."""
    mean = float(np.mean(_mean(np.abs(scene.outputs))))
    pace = max(_pace(scene.outputs) / float(np.median(np.diff(scene.time))), 1e-12)
    terms = _terms(model)
    turns = np.array([any(_turns(term, s) for term in terms) for s in model.states])
    size = np.where(turns, np.pi, mean)
    for i, state in enumerate(model.states):
        parent = model.kinematic_parent(state)
        if state not in estimate.hidden:
            size[i] = np.std(estimate.values[:, i])
        elif parent is not None:
            size[i] = pace * size[model.states.index(parent)]
    return np.maximum(size, 1e-12), turns


def _turns(term: Term, state: str) -> bool:
    """Whether a state stands inside a sine or cosine."""
    if state not in term.variables:
        return False
    if term.op in ("sin", "cos"):
        return True
    return any(_turns(arg, state) for arg in term.args)
