"""Recordings of the generated forms: what becomes of clean samples on their way into a file."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

Rng = np.random.Generator
Table = dict[str, np.ndarray]
"""Column to samples; the first is time, NaN is a missing sample."""


@dataclass(frozen=True)
class Channels:
    """Names of the columns that are sensors and inputs."""

    sensors: tuple[str, ...]
    inputs: tuple[str, ...]


Spoil = Callable[[Table, Channels, Rng, int], Table]


def untouched(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
    return table


@dataclass(frozen=True)
class Plan:
    """Sizes of the files, and what happens to each.

    Attributes
    ----------
    sizes, held : tuple of int
        Samples of each file of DATA, and of each held-out one.
    spoil : callable
        Takes a table, its channels, random numbers and the number of its file.
    scale : float
        Of the first sensor: 1000 for mm where the model has m.
    jitter : float
        Of the sampling times, relative to their step.
    rates : tuple of float
        Of each file, relative to the usual step; cycled.
    time : str
        Name of the time column.
    unit : float
        Of the time column, in seconds.
    origin : float
        Of the time column, in seconds.
    digits : int
        Significant digits in the file.
    mark, comma : str
        Between columns, and of decimals.
    still : bool
        Whether inputs stand still.
    noise : float
        Of each sensor, relative to its standard deviation.
    may_refuse : str
        Why exit status 2 would be right too.
    """

    sizes: tuple[int, ...] = (300,)
    held: tuple[int, ...] = ()
    spoil: Spoil = untouched
    scale: float = 1.0
    jitter: float = 0.0
    rates: tuple[float, ...] = (1.0,)
    time: str = "t"
    unit: float = 1.0
    origin: float = 0.0
    digits: int = 9
    mark: str = ","
    comma: str = "."
    still: bool = False
    noise: float = 1e-3
    may_refuse: str = field(default="")


def file_text(table: Table, plan: Plan) -> str:
    """Return the text of a CSV file."""
    out = io.StringIO()
    out.write(plan.mark.join(table) + "\n")
    digits = max(plan.digits, 16 if plan.origin else 0)
    for row in zip(*table.values(), strict=True):
        cells = ["" if np.isnan(v) else f"{v:.{digits}g}" for v in row]
        out.write(plan.mark.join(cells).replace(".", plan.comma) + "\n")
    return out.getvalue()


def _blank(table: Table, name: str, missing: np.ndarray) -> Table:
    return {**table, name: np.where(missing, np.nan, table[name])}


def _one_in(step: int, every_sensor: bool) -> Spoil:
    def spoil(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
        names = channels.sensors if every_sensor else channels.sensors[:1]
        for k, name in enumerate(names):
            index = np.arange(table[name].size)
            table = _blank(table, name, (index + k) % step != 0)
        return table

    return spoil


def _drop_outs(share: float, every_sensor: bool) -> Spoil:
    def spoil(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
        names = channels.sensors if every_sensor else channels.sensors[-1:]
        for name in names:
            table = _blank(table, name, rng.random(table[name].size) < share)
        return table

    return spoil


def _rows_lost(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
    kept = rng.random(next(iter(table.values())).size) >= 0.1
    kept[[0, -1]] = True
    return {name: column[kept] for name, column in table.items()}


def _input_drop_outs(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
    for name in channels.inputs:
        table = _blank(table, name, rng.random(table[name].size) < 0.03)
    return table


def _in_turn(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
    """Sensors that drop out one after the other; a single one for every other tenth."""
    for k, name in enumerate(channels.sensors):
        size = table[name].size
        part = np.arange(size) * 10 // size
        table = _blank(table, name, part % max(len(channels.sensors), 2) == k)
    return table


def _long_gap(rows: bool) -> Spoil:
    def spoil(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
        size = next(iter(table.values())).size
        start = int(size * rng.uniform(0.2, 0.5))
        gap = np.zeros(size, dtype=bool)
        gap[start : start + size // 4] = True
        if rows:
            return {name: column[~gap] for name, column in table.items()}
        return _blank(table, channels.sensors[0], gap)

    return spoil


def _absent(column: bool) -> Spoil:
    """The last sensor is absent from the second file: no column, or an empty one."""

    def spoil(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
        if number != 1:
            return table
        name = channels.sensors[-1]
        if column:
            return {k: v for k, v in table.items() if k != name}
        return _blank(table, name, np.ones(table[name].size, dtype=bool))

    return spoil


def _stuck(value: float | None) -> Spoil:
    """The last sensor is stuck, at a value or where it is."""

    def spoil(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
        name = channels.sensors[-1]
        held = table[name][0] if value is None else value
        return {**table, name: np.full(table[name].size, held)}

    return spoil


def _extra_columns(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
    size = next(iter(table.values())).size
    return {**table, "battery": np.full(size, 24.0), "spare": np.full(size, np.nan)}


def _saturated(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
    name = channels.sensors[0]
    low, high = np.quantile(table[name], [0.0, 0.8])
    return {**table, name: np.clip(table[name], low, high)}


def _coarse(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
    name = channels.sensors[0]
    step = max(np.ptp(table[name]) / 40, 1e-9)
    return {**table, name: step * np.round(table[name] / step)}


def _spikes(table: Table, channels: Channels, rng: Rng, number: int) -> Table:
    name = channels.sensors[0]
    column = table[name].copy()
    at = rng.integers(0, column.size, 3)
    column[at] += 20 * (np.std(column) + 1e-6) * rng.choice([-1.0, 1.0], 3)
    return {**table, name: column}


Kind = Callable[[Rng, bool], Plan]


def _size(rng: Rng, small: bool, most: int = 3000) -> int:
    """Draw a length, log-uniform; at most 240 samples in the quick forms."""
    return int(np.exp(rng.uniform(np.log(120), np.log(240 if small else most))))


def _sizes(rng: Rng, small: bool, files: int) -> tuple[int, ...]:
    return tuple(_size(rng, small, 1500) for _ in range(files))


KINDS: dict[str, Kind] = {
    "plain": lambda rng, small: Plan((_size(rng, small),)),
    "20 samples": lambda rng, small: Plan((20,)),
    "60 samples": lambda rng, small: Plan((60,)),
    "long": lambda rng, small: Plan((400,) if small else (int(rng.integers(5000, 20000)),)),
    "held out": lambda rng, small: Plan((_size(rng, small),), held=(_size(rng, small),)),
    "two files": lambda rng, small: Plan(_sizes(rng, small, 2), held=(100,)),
    "eight files": lambda rng, small: Plan((60,) * 8 if small else _sizes(rng, small, 8)),
    "one file short": lambda rng, small: Plan(
        (_size(rng, small), int(rng.choice([5, 10, 30]))), may_refuse="a file is too short"
    ),
    "held-out file short": lambda rng, small: Plan(
        (_size(rng, small),),
        held=(int(rng.choice([4, 10, 30])),),
        may_refuse="a held-out file is too short",
    ),
    "one sensor every 2nd": lambda rng, small: Plan((_size(rng, small),), spoil=_one_in(2, False)),
    "one sensor every 3rd": lambda rng, small: Plan((_size(rng, small),), spoil=_one_in(3, False)),
    "one sensor every 10th": lambda rng, small: Plan(
        (600 if small else int(rng.integers(1000, 5000)),), spoil=_one_in(10, False)
    ),
    "all sensors every 2nd, in turn": lambda rng, small: Plan(
        (_size(rng, small),), spoil=_one_in(2, True)
    ),
    "rates differ between files": lambda rng, small: Plan(
        _sizes(rng, small, 2), rates=(1.0, float(rng.choice([0.5, 1.37, 3.0])))
    ),
    "jitter": lambda rng, small: Plan((_size(rng, small),), jitter=0.3),
    "drop-outs 0.5 %": lambda rng, small: Plan((_size(rng, small),), spoil=_drop_outs(0.005, True)),
    "drop-outs 2 %": lambda rng, small: Plan((_size(rng, small),), spoil=_drop_outs(0.02, False)),
    "drop-outs 10 %": lambda rng, small: Plan((_size(rng, small),), spoil=_drop_outs(0.1, True)),
    "drop-outs 20 %": lambda rng, small: Plan((_size(rng, small),), spoil=_drop_outs(0.2, False)),
    "rows lost": lambda rng, small: Plan((_size(rng, small),), spoil=_rows_lost),
    "sensors in turn": lambda rng, small: Plan((_size(rng, small),), spoil=_in_turn),
    "long gap of a sensor": lambda rng, small: Plan((_size(rng, small),), spoil=_long_gap(False)),
    "long gap of rows": lambda rng, small: Plan((_size(rng, small),), spoil=_long_gap(True)),
    "sensor without a column in one file": lambda rng, small: Plan(
        _sizes(rng, small, 2), spoil=_absent(True)
    ),
    "sensor empty in one file": lambda rng, small: Plan(
        _sizes(rng, small, 2), spoil=_absent(False)
    ),
    "sensor stuck": lambda rng, small: Plan(
        (_size(rng, small),), spoil=_stuck(None), may_refuse="a sensor is constant"
    ),
    "sensor all zero": lambda rng, small: Plan(
        (_size(rng, small),), spoil=_stuck(0.0), may_refuse="a sensor is constant"
    ),
    "extra columns": lambda rng, small: Plan((_size(rng, small),), spoil=_extra_columns),
    "sensor saturated": lambda rng, small: Plan((_size(rng, small),), spoil=_saturated),
    "sensor coarse": lambda rng, small: Plan((_size(rng, small),), spoil=_coarse),
    "spikes": lambda rng, small: Plan((_size(rng, small),), spoil=_spikes),
    "time from 1e9 s": lambda rng, small: Plan((_size(rng, small),), origin=1.0e9 + 0.25),
    "time in ms": lambda rng, small: Plan((_size(rng, small),), time="time_ms", unit=1e-3),
    "sensor in mm": lambda rng, small: Plan((_size(rng, small),), scale=1000.0),
    "input with drop-outs": lambda rng, small: Plan(
        (_size(rng, small),), spoil=_input_drop_outs, may_refuse="an input has missing samples"
    ),
    "input stands still": lambda rng, small: Plan((_size(rng, small),), still=True),
    "semicolons and decimal commas": lambda rng, small: Plan(
        (_size(rng, small),), mark=";", comma=",", digits=6
    ),
    "times rounded": lambda rng, small: Plan(
        (_size(rng, small),), rates=(float(rng.choice([1.0 / 3.0, 0.7])),), digits=6
    ),
    "no noise": lambda rng, small: Plan((_size(rng, small),), noise=0.0, digits=15),
}
