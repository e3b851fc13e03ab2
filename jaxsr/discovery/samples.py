"""Recordings to the rows of a regression: variables, derivatives, and who may see which row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxsr._result import InputError
from jaxsr.discovery.treatment import estimated_derivative
from jaxsr.expressions import is_identifier
from jaxsr.recordings import Recording, noise_level

_EDGE = 4  # samples at each end at which an estimated derivative is one-sided


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
    """

    states: tuple[str, ...]
    derivatives: dict[str, str]
    rate_of: dict[str, str]
    inputs: tuple[str, ...]
    time: str
    autonomous: bool = False


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
    """

    variables: dict[str, np.ndarray]
    targets: dict[str, np.ndarray]
    group: np.ndarray
    estimated: frozenset[str]
    errors: dict[str, np.ndarray] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)

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
    group = np.concatenate([np.full(len(p), k) for k, p in enumerate(parts)])
    variables = {n: np.concatenate([p.variables[n] for p in parts]) for n in parts[0].variables}
    targets = {n: np.concatenate([p.targets[n] for p in parts]) for n in roles.states}
    complete = np.all([np.isfinite(v) for v in (*variables.values(), *targets.values())], axis=0)
    if not np.any(complete):
        names = ", ".join(recording.name for recording in recordings)
        raise InputError("no sample has every state, input and derivative", names)
    estimated = frozenset().union(*(p.estimated for p in parts))
    known = set.intersection(*(set(p.errors) for p in parts))
    errors = {n: np.concatenate([p.errors[n] for p in parts]) for n in sorted(known)}
    noise = {n: float(np.median([p.noise[n] for p in parts])) for n in parts[0].noise}
    whole = Samples(variables, targets, group, estimated, errors, noise)
    return whole.take(np.flatnonzero(complete))


def _of_one(recording: Recording, roles: Roles) -> Samples:
    t = recording.time
    displacement = {rate: q for q, rate in roles.rate_of.items()}
    computed = {r for r in displacement if r not in recording.channels}
    values = {roles.time: t}
    for name in (*roles.states, *roles.inputs):
        source = displacement[name] if name in computed else name
        signal = recording.channel(source)
        values[name] = estimated_derivative(t, signal)[0] if name in computed else signal
    targets, errors, noise = {}, {}, {}
    for state in roles.states:
        if state in roles.rate_of:
            targets[state] = values[roles.rate_of[state]]
        elif state in roles.derivatives:
            targets[state] = recording.channel(roles.derivatives[state])
            noise[state] = noise_level(t, targets[state])
        else:
            twice = state in computed
            signal = values[displacement[state] if twice else state]
            targets[state], errors[state] = estimated_derivative(t, signal, 2 if twice else 1)
    known = {n: e for n, e in errors.items() if e is not None}
    part = Samples(values, targets, np.zeros(len(t), int), frozenset(errors), known, noise)
    rough = len(known) < len(errors) or computed
    return part.take(np.arange(_EDGE, len(t) - _EDGE)) if rough and len(t) > 10 * _EDGE else part


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
