"""Recordings to the rows of a regression: variables, derivatives, and who may see which row."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline

from jaxsr._result import InputError
from jaxsr.discovery.treatment import Treatment, treat
from jaxsr.discovery.weak_rows import WeakRows, weak_rows
from jaxsr.expressions import is_identifier
from jaxsr.recordings import Recording, noise_level
from jaxsr.views import choose_method, integrate
from jaxsr.views.gaps import fill, reachable

Trace = dict[str, dict[str, np.ndarray]]
"""Of one recording: "time"; "values" of all states and inputs and, of smooth ones, their "slopes";
"measured" states and their "noise"."""
_CUBIC = 8  # samples
_FEWEST_TWICE = 4  # samples of which there is a second derivative
_COMPLETE = 0.3  # share of the instants of the least known channel
_FEWEST_WEAK = 12  # test functions; with fewer, derivatives at samples tell more
_TOLD = 100  # samples of which noise can be told
_FINEST = 1e-3  # noise of a state relative to its spread, at least: no model is truer


@dataclass(frozen=True, slots=True)
class Roles:
    """Which column is what.

    Attributes
    ----------
    states : tuple of str
        All states; with second-order systems displacements first, then their rates.
    derivatives : dict
        State to the column of its derivative, where there is one.
    rate_of : dict
        State whose derivative is another state by definition (order 2): displacement to rate.
    inputs : tuple of str
    time : str
        Symbol of time.
    autonomous : bool
        Whether time is kept out of the equations.
    treatment : Treatment
        How states are smoothed and differentiated.
    hurried : bool
        Whether noisy states are smoothed evenly and differentiated, which is soon done.
    """

    states: tuple[str, ...]
    derivatives: dict[str, str]
    rate_of: dict[str, str]
    inputs: tuple[str, ...]
    time: str
    autonomous: bool = False
    treatment: Treatment = field(default_factory=Treatment)
    hurried: bool = False

    def needed(self, columns: Collection[str]) -> list[str]:
        """Return the columns without which a recording that has ``columns`` serves nothing.

        Rates are computed where they are absent, and what has a derivative is integrated.
        """
        told = {s for s, column in self.derivatives.items() if column in columns}
        told |= {q for q, rate in self.rate_of.items() if rate in told}
        states = [s for s in self.states if s not in told and s not in self.rate_of.values()]
        return [*states, *self.derivatives.values(), *self.inputs]


@dataclass(frozen=True, slots=True)
class Samples:
    """Rows of several recordings, one after the other.

    Attributes
    ----------
    variables : dict of str to ndarray, (rows,)
        Time, states and inputs.
    targets : dict of str to ndarray, (rows,)
        Derivative of each state.
    group : ndarray of int, (rows,)
        Number of the recording.
    estimated : frozenset of str
        States whose derivative was computed from their samples.
    errors : dict of str to ndarray, (rows,)
        Standard error of a computed derivative, where it is known.
    noise : dict of str to float
        Measurement noise of a derivative that is a column.
    weak : dict of str to WeakRows
        Equations of states too noisy to be differentiated, in the weak view.
    traces : tuple of Trace
        Whole recordings, for roll-outs.
    """

    variables: dict[str, np.ndarray]
    targets: dict[str, np.ndarray]
    group: np.ndarray
    estimated: frozenset[str]
    errors: dict[str, np.ndarray] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)
    weak: dict[str, WeakRows] = field(default_factory=dict)
    traces: tuple[Trace, ...] = ()

    def __len__(self) -> int:
        return len(self.group)

    def take(self, rows: np.ndarray) -> Samples:
        """Return some of the rows."""
        return Samples(
            {k: v[rows] for k, v in self.variables.items()},
            {k: v[rows] for k, v in self.targets.items()},
            self.group[rows],
            self.estimated,
            {k: v[rows] for k, v in self.errors.items()},
            self.noise,
            {k: v.take(rows) for k, v in self.weak.items()},
            self.traces,
        )


def roles(
    states: Sequence[str],
    derivatives: Sequence[str] | None,
    order: int,
    inputs: Sequence[str],
    time: str | None,
) -> Roles:
    """Name every column's role; see :func:`jaxsr.discovery.discover`."""
    if not states:
        raise InputError("states are missing", "states", "Name at least one column.")
    if order not in (1, 2):
        raise InputError(f"order must be 1 or 2, got {order}", "order")
    if derivatives and len(derivatives) != len(states):
        raise InputError(
            f"{len(derivatives)} derivatives for {len(states)} states",
            "derivatives",
            "Name one for each state, in the same order.",
        )
    rates = tuple(f"d_{s}" for s in states) if order == 2 else ()
    named = [*states, *rates, *inputs]
    for name in named:
        if not is_identifier(name):
            raise InputError(
                f"column {name!r} is not an identifier", "", "Rename it to letters, digits and _."
            )
    if len(set(named)) != len(named):
        raise InputError(f"a column has two roles among {', '.join(named)}", "states")
    symbol = time if time and is_identifier(time) else "t"
    if symbol in named:
        raise InputError(f"{symbol} is the name of time and of a column", "time")
    # of a second-order system the given derivatives are accelerations
    targets = rates if order == 2 else tuple(states)
    given = dict(zip(targets, derivatives, strict=True)) if derivatives else {}
    pairs = dict(zip(states, rates, strict=True)) if order == 2 else {}
    return Roles((*states, *rates), given, pairs, tuple(inputs), symbol)


def samples(recordings: Sequence[Recording], roles: Roles) -> Samples:
    """Collect the rows of recordings; rows in which anything is missing are left out."""
    parts = [_of_one(recording, roles) for recording in recordings]
    # what only some recordings allow is left out for all
    kept = {k: set.intersection(*(set(getattr(p, k)) for p in parts)) for k in ("errors", "weak")}
    whole = Samples(
        _joined([p.variables for p in parts]),
        _joined([p.targets for p in parts]),
        np.concatenate([np.full(len(p), k) for k, p in enumerate(parts)]),
        frozenset().union(*(p.estimated for p in parts)),
        _joined([{n: p.errors[n] for n in sorted(kept["errors"])} for p in parts]),
        {n: float(np.median([p.noise[n] for p in parts])) for n in parts[0].noise},
        {n: WeakRows.joined([p.weak[n] for p in parts]) for n in sorted(kept["weak"])},
        _levelled([trace for p in parts for trace in p.traces]),
    )
    columns = (*whole.variables.values(), *whole.targets.values())
    complete = np.all([np.isfinite(v) for v in columns], axis=0)
    if not np.any(complete):
        names = ", ".join(recording.name for recording in recordings)
        raise InputError("no sample has every state, input and derivative", names)
    if not np.all(complete):
        whole = whole.take(np.flatnonzero(complete))
    enough = {n: rows for n, rows in whole.weak.items() if len(rows.target) >= _FEWEST_WEAK}
    return replace(whole, weak=enough)


def _levelled(traces: Sequence[Trace]) -> tuple[Trace, ...]:
    """Give short recordings, whose noise cannot be told, no less than the others' median noise."""
    long = [trace for trace in traces if len(trace["time"]["t"]) >= _TOLD]
    out = []
    for trace in traces:
        noise = dict(trace["noise"])
        if long and len(trace["time"]["t"]) < _TOLD:
            for name, own in noise.items():
                usual = float(np.median([np.sqrt(np.mean(o["noise"][name] ** 2)) for o in long]))
                noise[name] = np.maximum(own, usual)
        out.append({**trace, "noise": noise})
    return tuple(out)


def _joined(tables: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _of_one(recording: Recording, roles: Roles) -> Samples:
    t = recording.time
    displacement = {rate: q for q, rate in roles.rate_of.items()}
    recording = integrated(recording, roles)
    computed = {r for r in displacement if r not in recording.channels}
    if computed and len(t) < _FEWEST_TWICE:
        raise InputError(
            f"{len(t)} samples are too few to differentiate twice",
            recording.name,
            f"Give at least {_FEWEST_TWICE}, or a column d_STATE of the rate",
        )
    treated = {
        name: treat(
            *(t, recording.channel(name), roles.treatment),
            given=name in roles.derivatives,
            hurried=roles.hurried,
        )
        for name in roles.states
        if name not in computed
    }
    channels = [*treated, *roles.derivatives.values(), *roles.inputs]
    sparse = _is_sparse([recording.channels[n] for n in channels])
    states = {name: signal.values for name, signal in treated.items()}
    if sparse:  # sensors take turns: few instants are known of all of them
        states = {name: fill(t, values) for name, values in states.items()}
    states |= {rate: treated[displacement[rate]].derivative(1)[0] for rate in computed}
    values = {roles.time: t} | {name: states[name] for name in roles.states}
    values |= {name: _bridged(t, recording.channel(name)) for name in roles.inputs}
    targets, errors, noise, weak = {}, {}, {}, {}
    for state in roles.states:
        if state in roles.rate_of:
            targets[state] = values[roles.rate_of[state]]
        elif state in roles.derivatives:
            targets[state] = recording.channel(roles.derivatives[state])
            # of few samples, motion cannot be told from noise
            noise[state] = noise_level(t, targets[state]) if len(t) >= _TOLD else 0.0
        else:
            order = 2 if state in computed else 1
            signal = treated[displacement[state] if order == 2 else state]
            targets[state], errors[state] = signal.derivative(order)
            if sparse and errors[state] is not None:
                targets[state], errors[state] = fill(t, targets[state]), None
            if signal.weak:
                weak[state] = weak_rows(t, signal.filled, signal.noise, order)
    known = {n: e for n, e in errors.items() if e is not None}
    # beside given derivatives states stay as recorded, but what drives a roll-out must be smooth
    smooth = {n: treat(t, recording.channel(n)).values for n in treated if n in roles.derivatives}
    driving = values | (smooth if len(t) >= _TOLD else {})
    driving = {n: _filled(t, v) for n, v in driving.items() if n != roles.time}
    trace = {
        "time": {"t": t},
        "values": driving,
        "slopes": {n: CubicSpline(t, v)(t, 1) for n, v in driving.items() if _is_smooth(t, v)},
        "measured": {n: signal.recorded for n, signal in treated.items()},
        "noise": {
            n: np.maximum(signal.noise, _FINEST * float(np.nanstd(signal.recorded)) or 1.0)
            for n, signal in treated.items()
        },
    }
    group = np.zeros(len(t), int)
    every = frozenset(errors)
    return Samples(values, targets, group, every, known, noise, weak, (trace,))


def integrated(recording: Recording, roles: Roles) -> Recording:
    """Return the recording with velocities and displacements that only accelerations tell of."""
    channels = dict(recording.channels)
    for state, column in roles.derivatives.items():
        if state in channels or column not in channels:
            continue
        rate = channels[column]
        channels[state] = integrate(recording.time, rate)
        for displacement, own in roles.rate_of.items():
            if own == state and displacement not in channels:
                channels[displacement] = integrate(recording.time, rate, order=2)
    return (
        replace(recording, channels=channels)
        if len(channels) > len(recording.channels)
        else recording
    )


def _is_sparse(channels: Sequence[np.ndarray]) -> bool:
    """Tell whether far fewer instants are known of all channels than of the least known one."""
    known = np.array([np.isfinite(values) for values in channels])
    least = int(np.min(np.count_nonzero(known, axis=1)))
    return bool(np.count_nonzero(np.all(known, axis=0)) < _COMPLETE * least)


def _is_smooth(t: np.ndarray, values: np.ndarray) -> bool:
    """Tell whether a cubic between samples is nearer than a straight line."""
    enough = len(t) > _CUBIC and np.ptp(values) > 0.0 and np.all(np.isfinite(values))
    return bool(enough) and choose_method(t, values) == "finite_difference"


def _bridged(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return an input with straight lines over what is missing between near neighbours."""
    known = np.isfinite(values)
    near = reachable(t, known)
    return np.where(near, _filled(t, values), np.nan) if np.any(near & ~known) else values


def _filled(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    good = np.isfinite(values)
    return values if np.all(good) or not np.any(good) else np.interp(t, t[good], values[good])


def hold_back(group: np.ndarray, share: float = 0.25, count: int = 8) -> np.ndarray:
    """Tell which rows to choose by: every fourth of the consecutive blocks of each recording."""
    held = np.zeros(len(group), dtype=bool)
    every = round(1.0 / share)
    place = 0
    for number in np.unique(group):
        rows = np.flatnonzero(group == number)
        if len(rows) < 2 * every:
            continue
        for block in np.array_split(rows, min(count, len(rows) // 2)):
            held[block] = place % every == every - 1
            place += 1
    return held


def thinned(rows: np.ndarray, most: int) -> np.ndarray:
    """Return at most ``most`` of the rows, evenly spaced."""
    if len(rows) <= most:
        return rows
    return rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]
