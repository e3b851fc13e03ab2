"""Model files to models, with errors that name file, key, symbol and remedy."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxsr._result import InputError
from jaxsr.expressions import is_identifier
from jaxsr.models.model import FREE, Event, Model, Parameter
from jaxsr.models.units import check_units

_TABLES: list[str] = [
    *("model", "definitions", "equations", "inertia", "readings", "parameters", "per_recording"),
    *("initial", "delays", "clock", "noise", "events", "units", "columns", "additions"),
]
_MODEL_KEYS: list[str] = [
    *("name", "time", "states", "inputs", "outputs", "input_hold", "sample_time", "base"),
]
_HOLDS = ("linear", "zero", "bandlimited")


def read_model(path: str | Path) -> Model:
    """Read a model file.

    Parameters
    ----------
    path : path
        A TOML file as CONTRACT.md, section 1, describes.

    Returns
    -------
    Model

    Raises
    ------
    InputError
        The file is missing, is no TOML, or breaks a rule of the contract.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError("no such model file", str(path), "Check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read ({error})", str(path)) from None
    return parse_model(text, path.name)


def parse_model(text: str, source: str = "model") -> Model:
    """Read a model from the text of a model file; `source` names it in errors."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not valid TOML: {error}", source) from None
    return build_model(document, source)


def build_model(document: Mapping[str, Any], source: str = "model") -> Model:
    """Build and check a model from the tables of a model file."""
    reader = _Tables(document, source)
    head = reader.table("model")
    reader.known(head, _MODEL_KEYS, "model")
    states = reader.names(head, "states", needed=True)
    base = head.get("base")
    hold = head.get("input_hold", "linear")
    if hold not in _HOLDS:
        raise reader.fail(f"input_hold {hold!r}", "model", f"Use one of {', '.join(_HOLDS)}")
    parameters = {n: reader.parameter(n, v) for n, v in reader.table("parameters").items()}
    model = Model(
        name=str(head.get("name", source)),
        states=states,
        inputs=reader.names(head, "inputs"),
        outputs=reader.names(head, "outputs", needed=True),
        time=str(head.get("time", "t")),
        input_hold=hold,
        sample_time=reader.optional_number(head, "sample_time"),
        base=base,
        additions=reader.texts("additions"),
        definitions=reader.texts("definitions"),
        equations=reader.texts("equations"),
        inertia=reader.nested("inertia"),
        readings=reader.texts("readings"),
        parameters=parameters,
        per_recording=reader.nested("per_recording"),
        initial={**dict.fromkeys(states, FREE), **reader.table("initial")},
        delays=dict(reader.table("delays")),
        clock=reader.texts("clock"),
        noise={k: reader.number(v, f"[noise] {k}") for k, v in reader.table("noise").items()},
        events=tuple(reader.event(e) for e in document.get("events", [])),
        units=reader.texts("units"),
        columns=reader.texts("columns"),
    )
    _check(model, reader)
    return model


class _Tables:
    """The tables of one file, with errors that say where."""

    def __init__(self, document: Mapping[str, Any], source: str) -> None:
        self.document, self.source = document, source
        self.known(document, _TABLES, "")
        if "model" not in document:
            raise self.fail("no [model] table", "", "Start with [model] states = [...]")

    def fail(self, what: str, key: str, remedy: str = "") -> InputError:
        place = f" [{key}]" if key and not key.startswith("[") else f" {key}" if key else ""
        return InputError(what, f"{self.source}{place}", remedy)

    def known(self, table: Mapping[str, Any], keys: list[str], where: str) -> None:
        for key in table:
            if key not in keys:
                close = difflib.get_close_matches(key, keys, 1)
                hint = f"Did you mean {close[0]!r}?" if close else f"Known: {', '.join(keys)}"
                raise self.fail(f"unknown key {key!r}", where, hint)

    def table(self, name: str) -> Mapping[str, Any]:
        value = self.document.get(name, {})
        if not isinstance(value, Mapping):
            raise self.fail(f"{name!r} must be a table", name, f"Write [{name}]")
        return value

    def texts(self, name: str) -> dict[str, str]:
        table = self.table(name)
        for key, value in table.items():
            if not isinstance(value, str):
                raise self.fail(f"must be text, got {value!r}", f"[{name}] {key}", 'Write "..."')
        return dict(table)

    def nested(self, name: str) -> dict[str, dict[str, Any]]:
        table = self.table(name)
        for key, value in table.items():
            if not isinstance(value, Mapping):
                raise self.fail(
                    f"must be a table, got {value!r}", f"[{name}] {key}", "Write { name = ... }"
                )
        return {key: dict(value) for key, value in table.items()}

    def names(self, head: Mapping[str, Any], key: str, needed: bool = False) -> tuple[str, ...]:
        value = head.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self.fail(
                f"{key} must be a list of names, got {value!r}", "model", 'Write ["..."]'
            )
        if needed and not value:
            raise self.fail(f"no {key}", "model", f'Write {key} = ["..."]')
        for name in value:
            if value.count(name) > 1:
                raise self.fail(f"{name!r} is listed twice", f"[model] {key}", "Rename one of them")
        return tuple(value)

    def number(self, value: Any, where: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(f"must be a number, got {value!r}", where, "Write e.g. 1.0")
        if not math.isfinite(value):
            raise self.fail(f"must be finite, got {value!r}", where, "Write a plain number")
        return float(value)

    def optional_number(self, table: Mapping[str, Any], key: str) -> float | None:
        return self.number(table[key], f"[model] {key}") if key in table else None

    def parameter(self, name: str, entry: Any) -> Parameter:
        where = f"[parameters] {name}"
        if isinstance(entry, int | float):
            return Parameter(self.number(entry, where))
        if not isinstance(entry, Mapping) or "value" not in entry:
            raise self.fail("needs a value", where, "Write { value = 1.0, bounds = [...] }")
        self.known(entry, ["value", "unit", "bounds"], where)
        value = self.number(entry["value"], where)
        bounds = entry.get("bounds")
        if bounds is None:
            return Parameter(value, entry.get("unit"))
        if not isinstance(bounds, list) or len(bounds) != 2:
            raise self.fail(
                f"bounds must be [low, high], got {bounds!r}", where, "Write two numbers"
            )
        low, high = (self.number(b, where) for b in bounds)
        if not low <= value <= high or low == high:
            raise self.fail(
                f"value {value:g} outside bounds [{low:g}, {high:g}]",
                where,
                "Widen the bounds, or leave them out for a fixed parameter",
            )
        return Parameter(value, entry.get("unit"), (low, high))

    def event(self, entry: Any) -> Event:
        if not isinstance(entry, Mapping) or "when" not in entry or "reset" not in entry:
            raise self.fail(
                "an event needs when and reset", "events", 'Write reset = { v = "-0.8*v" }'
            )
        self.known(entry, ["when", "direction", "reset"], "events")
        direction = entry.get("direction", 0)
        if direction not in (-1, 0, 1):
            raise self.fail(
                f"direction must be -1, 0 or 1, got {direction!r}", "events", "Use -1 for falling"
            )
        return Event(str(entry["when"]), int(direction), dict(entry["reset"]))


def _check(model: Model, reader: _Tables) -> None:
    """Check names and parse every expression once, so that errors come at reading."""
    seen: set[str] = set()
    for name in (*model.symbols, *model.definitions):
        if not is_identifier(name):
            raise reader.fail(f"{name!r} cannot name a symbol", "model", "Use ASCII letters")
        if name in seen:
            raise reader.fail(f"{name!r} is declared twice", "model", "Rename one of them")
        seen.add(name)
    try:
        _check_expressions(model, reader)
    except InputError as error:
        if error.where.startswith(reader.source):
            raise
        raise InputError(error.what, f"{reader.source} {error.where}", error.remedy) from None
    check_units(model, reader.source)


def _check_expressions(model: Model, reader: _Tables) -> None:
    _ = model.definition_terms, model.reading_terms, model.inertia_terms
    if model.base is None:
        for state in model.states:
            if state not in model.equations:
                raise reader.fail(
                    f"no equation for state {state!r}", "equations", f'Write {state} = "..."'
                )
    _ = model.equation_terms
    _known_roles(model, reader)
    for output in model.outputs:
        if output not in model.readings:
            raise reader.fail(
                f"no reading for output {output!r}", "readings", f'Write {output} = "..."'
            )
    for state, value in model.initial.items():
        if value != FREE:
            where = f"[initial] {state}"
            if isinstance(value, str):
                raise reader.fail(f"{value!r} is no start", where, f'Write a number or "{FREE}"')
            reader.number(value, where)
    for name, value in model.delays.items():
        where = f"[delays] {name}"
        if isinstance(value, str) and value not in model.parameters:
            raise reader.fail(f"unknown parameter {value!r}", where, "Declare it in [parameters]")
        if not isinstance(value, str) and reader.number(value, where) < 0:
            raise reader.fail(f"a delay of {value} s", where, "Write zero or more seconds")
    for name, text in model.clock.items():
        model.term(text, f"[clock] {name}")
    for name, value in model.noise.items():
        if value <= 0:
            raise reader.fail(f"a noise of {value}", f"[noise] {name}", "Write more than zero")
    for event in model.events:
        model.term(event.when, "[[events]] when")
        for state, text in event.reset.items():
            model.term(text, f"[[events]] reset {state}")
    for name, values in model.per_recording.items():
        for file, value in values.items():
            reader.number(value, f"[per_recording] {name} {file}")


def _known_roles(model: Model, reader: _Tables) -> None:
    """Refuse keys that name nothing: a misspelt one would be ignored in silence."""
    states, inputs, outputs = list(model.states), list(model.inputs), list(model.outputs)
    parameters = list(model.parameters)
    everything = [model.time, *states, *inputs, *outputs]
    tables = {
        "equations": (model.equations, states),
        "additions": (model.additions, states),
        "inertia": (model.inertia, states),
        "readings": (model.readings, outputs),
        "initial": (model.initial, states),
        "delays": (model.delays, [*inputs, *outputs]),
        "clock": (model.clock, outputs),
        "noise": (model.noise, outputs),
        "per_recording": (model.per_recording, parameters),
        "units": (model.units, [*everything, *parameters, *model.definitions]),
        "columns": (model.columns, everything),
    }
    for name, (table, keys) in tables.items():
        reader.known(table, keys, name)
    for row, entries in model.inertia.items():
        reader.known(entries, states, f"[inertia] {row}")
    for event in model.events:
        reader.known(event.reset, states, "[[events]] reset")
