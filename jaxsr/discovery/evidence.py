"""What free runs tell for a law: how much it leaves unpredicted, and whether it is worth its size.

Two questions, asked of every output. Does the law, run freely, predict what standing still does not
(`Evidence.left`)? And is that gain, in nats, more than choosing the law among all that were tried
costs (`Evidence.gain` against `Evidence.cost`)? The second is a description length: it tells a law
of many terms on few rows, or of a random walk, from one that holds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from jaxsr._deadline import never
from jaxsr.discovery.equation import Equation
from jaxsr.discovery.forecast import (
    Forecast,
    Readings,
    Row,
    forecast,
    window_length,
    windows,
)
from jaxsr.expressions.term import Term
from jaxsr.models.model import Model
from jaxsr.recordings import Recording

ODDS = float(np.log(20.0))
"""Nats by which a law must be likelier than no law; and within which two laws are as likely."""
_SHORT = 6  # samples of the shortest window by which a gain is counted
_ABOVE = 10.0  # mean square over the noise's that standing still must leave in such a window
_VISIBLE = 2.0  # the same in a window of the output's own memory, for it to be judged at all
_TINY = 1e-20  # mean square relative to the spread's: rounding


@dataclass(frozen=True, eq=False)
class Evidence:
    """Free runs of one output.

    Attributes
    ----------
    state : str
    whole : Forecast
        Over windows as long as the output's memory asks, of all the data.
    held : Forecast or None
        The same over data held back; None where it is too short for a window.
    short : Forecast
        Over the shortest windows in which the output moves by far more than its noise.
    share : float
        Windows that exist over those in ``short``.
    parameters : int
        Constants that were fitted.
    cost : float
        Nats that choosing the law costs.
    roughness : float
        Mean square of the step between neighbouring samples, over twice the variance: 1 where
        neighbours have nothing to do with each other.
    persistence : float
        Lag-one autocorrelation of those steps: 0 for a random walk.
    """

    state: str
    whole: Forecast
    held: Forecast | None
    short: Forecast
    share: float
    parameters: int
    cost: float
    roughness: float
    persistence: float

    @property
    def moves(self) -> bool:
        """Whether there is anything above the noise to be predicted."""
        return self.whole.trivial > max(_VISIBLE * self.whole.floor, _TINY)

    @property
    def left(self) -> float:
        """Return the share of what trivial predictions miss that the law misses too.

        Mean squares, the noise's taken off; the larger of all data and of data held back.
        """
        parts = [self.whole] if self.held is None else [self.whole, self.held]
        return max(
            (_left(p) for p in parts if p.trivial > max(_VISIBLE * p.floor, _TINY)), default=0.0
        )

    @property
    def gain(self) -> float:
        """Return the nats that the law gains on the better of the trivial predictions."""
        free = max(self.short.independent * self.share - self.parameters, 0.0)
        ratio = max(self.short.trivial, _TINY) / max(self.short.mse, _TINY)
        return 0.5 * free * float(np.log(ratio))

    @property
    def net(self) -> float:
        """Return the gain less the cost, nats."""
        return self.gain - self.cost


def _left(run: Forecast) -> float:
    return max(run.mse - run.floor, 0.0) / max(run.trivial - run.floor, _TINY)


@dataclass(frozen=True)
class Charge:
    """What terms cost: nats of a node (the choice of a symbol) and of a constant.

    Attributes
    ----------
    symbols : int
        Functions, names and constants that a node is chosen from.
    rows : int
        Samples: a constant is told to one part in the root of them.
    """

    symbols: int
    rows: int

    def of(self, equation: Equation) -> tuple[float, int]:
        """Return the cost of an equation's searched terms, and the number of their constants."""
        searched = [t for t in equation.terms if not t.given]
        nodes = sum(t.term.size for t in searched)
        constants = len(searched) + sum(_constants(t.term) for t in searched)
        nats = nodes * np.log(self.symbols) + 0.5 * constants * np.log(max(self.rows, 2))
        return float(nats), constants


def _constants(term: Term) -> int:
    return sum(n.is_constant and not float(n.value).is_integer() for n in term.walk())


@dataclass(frozen=True, eq=False)
class Bench:
    """Recordings on which laws are run.

    Attributes
    ----------
    readings : Readings
        Of DATA.
    held : Readings
        Recordings to choose by, or DATA itself.
    blocks : tuple of Row or None
        Rows of DATA held back; None where other recordings are.
    rate_of : mapping of str to str
        Displacement to its rate, where that has no sensor.
    """

    readings: Readings
    held: Readings
    blocks: tuple[Row, ...] | None
    rate_of: Mapping[str, str]

    def rows_held(self, length: int) -> list[Row]:
        """Return windows of data held back."""
        if self.blocks is None:
            return windows(self.held.items, length)
        rows = []
        for number, first, last in self.blocks:
            parts = max(1, (last - first) // length)
            edges = np.linspace(first, last, parts + 1).round().astype(int).tolist()
            rows += [(number, a, b) for a, b in pairwise(edges)]
        return [row for row in rows if row[2] - row[1] >= _SHORT]

    def evidence(
        self,
        model: Model,
        equations: Sequence[Equation],
        charge: Charge,
        expired: Callable[[], bool] = never,
    ) -> list[Evidence] | None:
        """Return what free runs of a model tell; None where time ended or it cannot be run."""
        model = replace(model, columns={y: model.readings[y] for y in model.outputs})
        charges = {e.state: charge.of(e) for e in equations}
        out = []
        for place, output in enumerate(model.outputs):
            state = model.readings[output]
            length = window_length(self.readings, place)
            whole = forecast(
                model, self.readings, place, windows(self.readings.items, length), expired
            )
            if whole is None:
                return None
            held, rows = None, self.rows_held(length)
            if rows:
                held = forecast(model, self.held, place, rows, expired)
            short, share = self._short(model, place, whole, length, expired)
            own = [charges.get(s, (0.0, 0)) for s in (state, self.rate_of.get(state, ""))]
            out.append(
                Evidence(
                    state,
                    whole,
                    held,
                    short,
                    share,
                    sum(count for _, count in own),
                    sum(nats for nats, _ in own) + ODDS,
                    *self._steps(place),
                )
            )
        return out

    def over(
        self, model: Model, recordings: Sequence[Recording], expired: Callable[[], bool] = never
    ) -> tuple[Readings, list[Forecast | None]]:
        """Return other recordings as read, and a model's free runs over them, output by output.

        None for an output that no window tells of.
        """
        model = replace(model, columns={y: model.readings[y] for y in model.outputs})
        whole = list(recordings)
        readings = Readings.of(model, whole, [{} for _ in whole])
        runs: list[Forecast | None] = []
        for place in range(len(model.outputs)):
            rows = windows(readings.items, window_length(self.readings, place))
            run = forecast(model, readings, place, rows, expired) if rows else None
            runs.append(run if run is not None and run.count else None)
        return readings, runs

    def _short(
        self,
        model: Model,
        place: int,
        whole: Forecast,
        length: int,
        expired: Callable[[], bool],
    ) -> tuple[Forecast, float]:
        size = _SHORT
        if _left(whole) > 1.0:  # no gain is left to be counted
            return whole, 1.0
        while size < length and not expired():
            rows = windows(self.readings.items, size)
            run = forecast(model, self.readings, place, rows, expired)
            if run is None:
                break
            if run.trivial > _ABOVE * run.floor:
                there = sum(item.time.size for item in self.readings.items)
                return run, max(there / sum(b - a for _, a, b in rows), 1.0)
            size *= 2
        return whole, 1.0

    def _steps(self, place: int) -> tuple[float, float]:
        steps = [np.diff(item.outputs[:, place]) for item in self.readings.items]
        scale = float(self.readings.scale[place])
        rough = [s[np.isfinite(s)] for s in steps]
        square = float(np.mean(np.concatenate(rough) ** 2)) if sum(map(len, rough)) else 0.0
        pairs = [(s[1:] * s[:-1])[np.isfinite(s[1:] * s[:-1])] for s in steps]
        product = float(np.mean(np.concatenate(pairs))) if sum(map(len, pairs)) else 0.0
        return 0.5 * square / scale**2, product / square if square > 0.0 else 0.0
