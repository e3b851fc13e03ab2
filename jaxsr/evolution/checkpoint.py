"""Searches that outlive their process: a state and its random numbers in one file, and back.

The file is JSON with terms in the model grammar and numbers that read back exactly; nothing in it
is executed. What a search does next depends on the state, the generator and the problem as it was
made, not on what it was asked before; so a search that was stopped and resumed ends with the same
front, bit for bit, as one that was not.
"""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
import math
import time
import typing
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from jaxsr._files import atomic_write_text
from jaxsr._result import InputError
from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.state import SearchState
from jaxsr.expressions import parse, to_text
from jaxsr.expressions.term import Term

SCHEMA = "jaxsr.checkpoint/1"
# of a regression problem, where it has them
_SETTINGS = (
    *("time", "floor", "noise", "ridge", "signs", "threshold", "refinement", "judging"),
    *("group", "admits"),
)
_GENERATORS = ("PCG64", "PCG64DXSM", "MT19937", "Philox", "SFC64")


class Data(Protocol):
    """What tells one regression problem from another."""

    variables: dict[str, np.ndarray]
    target: np.ndarray
    time: str
    timed: bool


class Keeper:
    """Write a search's state every so often, and hand it back to the next run.

    Parameters
    ----------
    path : path
        File; made on the first write.
    problem, config
        What is searched; a file of another problem or other settings is refused.
    every : float
        Seconds between writes, at least; 0 writes after every generation.

    Raises
    ------
    InputError
        ``every`` is negative or not a number.
    """

    def __init__(
        self, path: str | Path, problem: Data, config: SearchConfig, every: float = 60.0
    ) -> None:
        if not every >= 0.0:
            raise InputError(f"every must be 0 or more seconds, got {every}", "checkpoint")
        self.path, self.config, self.every = Path(path), config, every
        self._problem = problem
        self._written = time.monotonic()
        self._last: tuple[SearchState, np.random.Generator] | None = None

    def resume(self, rng: np.random.Generator) -> SearchState | None:
        """Return the state in the file and set ``rng`` to where it was; None without a file.

        Raises
        ------
        InputError
            The file is damaged, or of another search.
        """
        if not self.path.exists():
            return None
        state, saved = load(self.path, self._problem, self.config)
        if type(saved.bit_generator) is not type(rng.bit_generator):
            name = type(saved.bit_generator).__name__
            raise InputError(f"the checkpoint was made with {name}", str(self.path))
        rng.bit_generator.state = saved.bit_generator.state
        return state

    def keep(self, state: SearchState, rng: np.random.Generator) -> None:
        """Take note of a finished generation, and write it where it is time to."""
        # a copy: an interrupt inside the next generation must not move what belongs to this one
        self._last = state, copy.deepcopy(rng)
        if time.monotonic() - self._written >= self.every:
            self.close()

    def close(self) -> None:
        """Write the last generation noted, if it is not written yet."""
        if self._last is None:
            return
        save(self.path, *self._last, self._problem)
        self._last, self._written = None, time.monotonic()


def save(path: str | Path, state: SearchState, rng: np.random.Generator, problem: Data) -> None:
    """Write a search's state and generator to one file, whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    table = _Table()
    body = {
        "problem": fingerprint(problem),
        "config": _config_print(state.config),
        "rng": table.encode(rng.bit_generator.state),
        "state": table.encode(state),
        "terms": table.rows,
    }
    text = json.dumps(body, allow_nan=False)
    whole = {"schema": SCHEMA, "sha256": _digest(text), "body": body}
    atomic_write_text(Path(path), json.dumps(whole, allow_nan=False) + "\n")


def load(
    path: str | Path, problem: Data, config: SearchConfig
) -> tuple[SearchState, np.random.Generator]:
    """Read what :func:`save` wrote.

    Parameters
    ----------
    path : path
    problem, config
        What the search runs on. ``config.generations`` may differ from the file's: a longer
        search goes on from a shorter one.

    Raises
    ------
    InputError
        The file is missing, damaged, or of another problem or other settings.
    """
    body, config = _read(Path(path)), config.suited(problem.timed)
    remedy = "Name another file, or remove this one to start anew."
    if body.get("problem") != fingerprint(problem):
        raise InputError("the checkpoint is of other data", str(path), remedy)
    if body.get("config") != _config_print(config):
        raise InputError("the checkpoint is of other settings", str(path), remedy)
    try:
        decoder = _Decoder(config, body["terms"])
        state = decoder.decode(body["state"])
        saved = decoder.decode(body["rng"])
        if not isinstance(state, SearchState) or saved["bit_generator"] not in _GENERATORS:
            raise ValueError("no search state")
        bits = getattr(np.random, saved["bit_generator"])()
        bits.state = saved
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "the checkpoint was written by another version, or with functions not defined here",
            str(path),
            remedy,
        ) from error
    return state, np.random.Generator(bits)


def _read(path: Path) -> Mapping[str, Any]:
    try:
        whole = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", str(path)) from error
    except (ValueError, RecursionError) as error:
        raise InputError("is no checkpoint, or a damaged one", str(path)) from error
    if not isinstance(whole, dict) or whole.get("schema") != SCHEMA:
        raise InputError("is no checkpoint of a search", str(path))
    body = whole.get("body")
    if not isinstance(body, dict) or whole.get("sha256") != _digest(json.dumps(body)):
        raise InputError("is a damaged checkpoint", str(path))
    return body


def fingerprint(problem: Data) -> str:
    """Return the SHA-256 of target, variables and what else decides about a fit."""
    settings = {name: getattr(problem, name, None) for name in _SETTINGS}
    digest = hashlib.sha256(json.dumps(_described(settings)).encode())
    for name, values in [("", problem.target), *problem.variables.items()]:
        array = np.ascontiguousarray(values, dtype="<f8")
        digest.update(f"|{name}|{array.shape}|".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _config_print(config: SearchConfig) -> str:
    same_end = replace(config, generations=1)
    return _digest(json.dumps(_described(same_end), allow_nan=True))


def _described(value: Any) -> Any:
    """Return settings as JSON; a function is known by its name, an array by its checksum."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = (f.name for f in dataclasses.fields(value) if f.init)
        return {name: _described(getattr(value, name)) for name in fields}
    if isinstance(value, np.ndarray):
        return [str(value.shape), hashlib.sha256(value.tobytes()).hexdigest()]
    if isinstance(value, Mapping):
        return [[_described(k), _described(v)] for k, v in value.items()]
    if isinstance(value, frozenset | set):
        return sorted(map(str, value))
    if isinstance(value, tuple | list):
        return [_described(item) for item in value]
    if callable(value):
        return f"{value.__module__}.{getattr(value, '__qualname__', type(value).__qualname__)}"
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


class _Table:
    """Turn values into JSON; every distinct term is written once and named by its row."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self._row: dict[Term, int] = {}

    def encode(self, value: Any) -> Any:
        if isinstance(value, SearchConfig):
            return {"config": True}
        if isinstance(value, Term):
            if value not in self._row:
                self._row[value] = len(self.rows)
                self.rows.append(_term_row(value))
            return {"term": self._row[value]}
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            fields = {
                f.name: self.encode(getattr(value, f.name)) for f in dataclasses.fields(value)
            }
            return {"class": type(value).__name__, "fields": fields}
        if isinstance(value, np.ndarray):
            return {"array": value.tolist(), "dtype": value.dtype.str}
        if isinstance(value, np.generic):
            return self.encode(value.item())
        if isinstance(value, frozenset):
            return {"set": sorted((self.encode(item) for item in value), key=json.dumps)}
        if isinstance(value, tuple):
            return [self.encode(item) for item in value]
        if isinstance(value, Mapping):
            return {"map": [[self.encode(k), self.encode(v)] for k, v in value.items()]}
        if isinstance(value, float) and not math.isfinite(value):
            return {"float": repr(value)}
        if value is None or isinstance(value, str | int | float):
            return value
        raise TypeError(f"no form in a checkpoint for {type(value).__name__}")


class _Decoder:
    """Turn JSON back into values, dataclasses by their names."""

    def __init__(self, config: SearchConfig, rows: list[Any]) -> None:
        self._config = config
        self._terms = [_term_of(row) for row in rows]
        self._classes = {c.__name__: c for c in _parts_of(SearchState, set())}

    def decode(self, value: Any) -> Any:
        if isinstance(value, list):
            return tuple(self.decode(item) for item in value)
        if not isinstance(value, dict):
            return value
        match value:
            case {"config": True}:
                return self._config
            case {"term": int() as row} if row >= 0:
                return self._terms[row]
            case {"class": str() as name, "fields": dict() as fields}:
                return self._classes[name](**{k: self.decode(v) for k, v in fields.items()})
            case {"array": list() as items, "dtype": str() as dtype}:
                return np.array(items, dtype=dtype)
            case {"set": list() as items}:
                return frozenset(self.decode(item) for item in items)
            case {"map": list() as items}:
                return {self.decode(k): self.decode(v) for k, v in items}
            case {"float": str() as text}:
                return float(text)
        raise ValueError(f"unknown entry {sorted(value)}")


def _parts_of(kind: type, seen: set[type]) -> Iterator[type]:
    """Yield a dataclass and every dataclass that its fields may hold."""
    if kind in seen or kind is Term:
        return
    seen.add(kind)
    yield kind
    stack = list(typing.get_type_hints(kind).values())
    while stack:
        hint = stack.pop()
        stack += typing.get_args(hint)
        if isinstance(hint, type) and dataclasses.is_dataclass(hint):
            yield from _parts_of(hint, seen)


def _term_row(term: Term) -> Any:
    """Return a term as text, or node by node where the grammar would read something else."""
    text = to_text(term)
    try:
        if parse(text) == term:
            return text
    except InputError:
        pass
    return [term.op, term.name, repr(term.value), [_term_row(arg) for arg in term.args]]


def _term_of(row: Any) -> Term:
    if isinstance(row, str):
        return parse(row)
    op, name, value, args = row
    parts = tuple(_term_of(arg) for arg in args)
    if parts:
        return Term.apply(op, *parts)
    return Term(op, (), name, float(value))
