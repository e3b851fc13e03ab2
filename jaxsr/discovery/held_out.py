"""Free runs of the model that was found over recordings held out: their errors and their course."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr._deadline import never
from jaxsr.discovery.evidence import Bench
from jaxsr.discovery.forecast import Forecast, Readings, mean_square
from jaxsr.models.model import Model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording
from jaxsr.report.evidence import ModelRun


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What free runs over recordings held out tell.

    Attributes
    ----------
    errors : dict of str to float
        NRMSE by state.
    runs : tuple of ModelRun
        Their course, recording by recording.
    """

    errors: dict[str, float]
    runs: tuple[ModelRun, ...]


def held_out_runs(
    bench: Bench,
    model: Model,
    recordings: Sequence[Recording],
    origin: float = 0.0,
    expired: Callable[[], bool] = never,
) -> HeldOut:
    """Run a model freely over recordings held out, window by window.

    Parameters
    ----------
    bench : Bench
        Tells how long a window is.
    model : Model
    recordings : sequence of Recording
        Pieces of one recording follow one another under its name.
    origin : float
        Instant from which their time is counted, seconds.
    expired : callable
    """
    readings, forecasts = bench.over(model, recordings, expired)
    told = [(k, run) for k, run in enumerate(forecasts) if run is not None]
    states = [model.readings[y] for y in model.outputs]
    runs = [
        _course(model, readings, (name, numbers), (k, run), origin)
        for name, numbers in _joined(readings.items)
        for k, run in told
        if any(row[0] in numbers for row in run.rows)
    ]
    return HeldOut({states[k]: float(np.sqrt(run.mse)) for k, run in told}, tuple(runs))


def _joined(items: Sequence[Prepared]) -> list[tuple[str, list[int]]]:
    """Return recordings by a name of their own, each with the numbers of its pieces."""
    found: list[tuple[str, list[int]]] = []
    for number, item in enumerate(items):
        name = item.recording.name
        last = items[found[-1][1][-1]] if found and found[-1][0] == name else None
        if last is not None and item.time[0] > last.time[-1]:
            found[-1][1].append(number)
        else:
            found.append((name, [number]))
    names = [name for name, _ in found]
    return [
        (f"{name} ({names[:k].count(name) + 1})" if names.count(name) > 1 else name, numbers)
        for k, (name, numbers) in enumerate(found)
    ]


def _course(
    model: Model,
    readings: Readings,
    recording: tuple[str, list[int]],
    forecast: tuple[int, Forecast],
    origin: float,
) -> ModelRun:
    """Return one output of one recording; between its pieces stands a sample of nothing."""
    (name, numbers), (output, run) = recording, forecast
    columns, starts, lengths, errors = [], [], [], []
    for number in numbers:
        item = readings.items[number]
        simulated = np.full(item.time.size, np.nan)
        for place, (own, first, last) in enumerate(run.rows):
            if own == number:
                simulated[first:last] = run.course[: last - first, place]
                starts.append(item.time[first])
                lengths.append(item.time[last - 1] - item.time[first])
                errors.append(run.law[:, place])
        if columns:
            between = np.full((1, 3 + item.inputs.shape[1]), np.nan)
            between[0, 0] = 0.5 * (columns[-1][-1, 0] + item.time[0])
            columns.append(between)
        known = item.time, item.outputs[:, output], simulated, *item.inputs.T
        columns.append(np.column_stack(known))
    table = np.concatenate(columns)
    name_of = model.outputs[output]
    state = model.readings[name_of]
    return ModelRun(
        recording=name,
        output=state,
        unit=model.units.get(name_of) or model.units.get(state),
        time=table[:, 0] + origin,
        measured=table[:, 1],
        simulated=np.where(np.isfinite(table[:, 2]), table[:, 2], np.nan),
        starts=np.array(starts) + origin,
        horizon_s=float(np.median(lengths)),
        nrmse=float(np.sqrt(mean_square(np.concatenate(errors)))),
        inputs=dict(zip(model.inputs, table[:, 3:].T, strict=True)),
    )
