"""Recordings as they were read, and which of their rows serve what."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxsr._deadline import OutOfTime, limited, never
from jaxsr._result import InputError
from jaxsr.discovery.naming import Naming, quoted
from jaxsr.discovery.samples import Roles, Samples, Trace, hold_back, samples
from jaxsr.recordings import (
    DataCheck,
    Recording,
    check_recording,
    check_time_units,
    read_recording,
    unwrap,
)

_LARGEST = 1e30  # of a signal: higher powers of it are terms
_FEWEST = 4  # samples of which anything can be said
_RATES = 100.0  # ratio of sample times that is worth a word

Source = Recording | str | Path


@dataclass(frozen=True)
class Experiments:
    """What a discovery may look at before its equations are final.

    Attributes
    ----------
    roles : Roles
    recordings : tuple of Recording
    rows : Samples
        Of all the recordings, for the final estimates.
    train, judge : Samples
        Rows to regress on, and rows to choose by.
    unseen : tuple of Trace
        Other recordings for roll-outs to choose by.
    """

    roles: Roles
    recordings: tuple[Recording, ...]
    rows: Samples
    train: Samples
    judge: Samples
    unseen: tuple[Trace, ...] = ()


def read_experiments(
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    roles: Roles,
    *,
    whole: bool = False,
) -> Experiments:
    """Treat recordings, and hold some of their rows back where no others are to choose by.

    Parameters
    ----------
    recordings, validation : sequence of Recording
    roles : Roles
    whole : bool
        Whether every fourth recording is held back, and not blocks of rows.
    """
    rows = samples(recordings, roles)
    known = tuple(recordings)
    if validation:
        judge = samples(validation, roles)
        return Experiments(roles, known, rows, rows, judge, judge.traces)
    held = rows.group % 4 == 3 if whole else hold_back(rows.group)
    if not np.any(held) or np.all(held):
        return Experiments(roles, known, rows, rows, rows)
    train, judge = rows.take(np.flatnonzero(~held)), rows.take(np.flatnonzero(held))
    return Experiments(roles, known, rows, train, judge)


def checksums(recordings: Sequence[Recording]) -> dict[str, str]:
    """Return the SHA-256 of recordings that came from files, by name."""
    return {r.name: r.sha256 for r in recordings if r.sha256}


def opened(
    sources: Sequence[Source], part: Roles, naming: Naming, time: str | None
) -> list[Recording]:
    """Return recordings, read where they are paths, their channels named by symbols.

    Parameters
    ----------
    sources : sequence of Recording or path
    part : Roles
    naming : Naming
    time : str, optional
        Column of time.

    Raises
    ------
    InputError
        A recording cannot be read, or lacks a column that is needed.
    """
    out = []
    for source in sources:
        recording = naming.renamed(_read(source, time))
        error = naming.missing(recording, part.needed(recording.channels))
        if error is not None:
            raise error
        _check_sizes(recording, naming, [*part.states, *part.derivatives.values(), *part.inputs])
        out.append(recording)
    check_time_units(out)
    return out


def remarks(
    recordings: Sequence[Recording],
    part: Roles,
    expired: Callable[[], bool] = never,
) -> list[DataCheck]:
    """Return what is to be said of recordings, each by itself and beside the others.

    Those for which no time is left are named.
    """
    out: list[DataCheck] = []
    for recording in recordings:
        named = [*part.states, *part.derivatives.values(), *part.inputs]
        known = [n for n in dict.fromkeys(named) if n in recording.channels]
        usable = [n for n in known if _is_told(recording.channels[n])]
        if len(recording) >= _FEWEST:
            try:
                with limited(expired):
                    out += check_recording(recording, usable, part.inputs)
            except OutOfTime:
                text = f"no time was left to check the readings of {recording.name}"
                out.append(DataCheck(recording.name, "file", "unchecked", text))
    if len(recordings) > 1:
        fine, *_, coarse = sorted(recordings, key=lambda r: r.sample_time)
        ratio = coarse.sample_time / fine.sample_time
        if ratio > _RATES:
            text = (
                f"samples are {coarse.sample_time:.4g} s apart, those of {fine.name} "
                f"{fine.sample_time:.4g} s, {ratio:.3g} times less: is time in one unit in both?"
            )
            out.append(DataCheck(coarse.name, "time", "time_unit", text, ratio))
    return out


def _is_told(values: np.ndarray) -> bool:
    return bool(np.any(np.isfinite(values))) and not bool(np.any(np.isinf(values)))


def _check_sizes(recording: Recording, naming: Naming, symbols: Sequence[str]) -> None:
    """Raise where values are so large that their powers are no numbers."""
    for symbol in symbols:
        values = recording.channels.get(symbol, np.zeros(1))
        largest = float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))
        if largest > _LARGEST:
            raise InputError(
                f"column {quoted(naming.column(symbol))} reaches {largest:.1e}",
                recording.name,
                f"Give it in a unit in which it stays below {_LARGEST:.0e}",
            )


def _read(source: Source, time: str | None) -> Recording:
    """Return a recording, read from its file where it is a path; wrapped angles are counted on."""
    if isinstance(source, Recording):
        return unwrap(source)
    try:
        return unwrap(read_recording(source, time=time))
    except InputError as error:
        if "sample_time" not in error.remedy:
            raise
        # a model file may state the interval; here there is none
        remedy = (
            "Name the column of time, in seconds, with --time NAME; add one where there is none"
        )
        raise InputError(error.what, error.where, remedy) from error
