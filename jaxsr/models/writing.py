"""Models to model files: the inverse of reading."""

from __future__ import annotations

import json
import numbers
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxsr._files import atomic_write_text
from jaxsr._quoting import quoted
from jaxsr._result import InputError
from jaxsr.models.model import FREE, Model, Parameter

_BARE = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-")


def model_text(model: Model) -> str:
    """Return the text of the model file; `parse_model(model_text(m)) == m`.

    Raises
    ------
    InputError
        A name holds half a surrogate pair, as names of files do whose bytes are no text.
    """
    head: dict[str, Any] = {"name": model.name, "time": model.time, "states": list(model.states)}
    head["inputs"], head["outputs"] = list(model.inputs), list(model.outputs)
    head["input_hold"] = model.input_hold
    if model.sample_time is not None:
        head["sample_time"] = model.sample_time
    if model.base is not None:
        head["base"] = model.base
    parts = [table_text("model", head)]
    parts.append(table_text("definitions", model.definitions))
    parts.append(table_text("equations", model.equations))
    parts.append(table_text("additions", model.additions))
    parts.append(table_text("inertia", model.inertia))
    parts.append(table_text("readings", model.readings))
    parts.append(table_text("parameters", {n: _parameter(p) for n, p in model.parameters.items()}))
    parts.append(table_text("per_recording", model.per_recording))
    fixed = {s: v for s, v in model.initial.items() if v != FREE}
    parts.append(table_text("initial", {**dict.fromkeys(model.states, FREE), **fixed}))
    parts.append(table_text("delays", model.delays))
    parts.append(table_text("clock", model.clock))
    parts.append(table_text("noise", model.noise))
    parts.append(table_text("resolution", model.resolution))
    for event in model.events:
        table = {"when": event.when, "direction": event.direction, "reset": dict(event.reset)}
        parts.append(table_text("events", table, array=True))
    parts.append(table_text("units", {name: _unit(text) for name, text in model.units.items()}))
    parts.append(table_text("columns", model.columns))
    return "\n".join(part for part in parts if part)


def write_model(model: Model, path: str | Path) -> None:
    """Write a model file, whole or not at all."""
    atomic_write_text(Path(path), model_text(model))


def _parameter(parameter: Parameter) -> dict[str, Any]:
    entry: dict[str, Any] = {"value": parameter.value}
    if parameter.unit is not None:
        entry["unit"] = _unit(parameter.unit)
    if parameter.bounds is not None:
        entry["bounds"] = list(parameter.bounds)
    return entry


def _unit(text: str) -> str:
    # No unit is dimensionless to those who build a model in Python; a file says so by 1.
    return text if text.strip() else "1"


def table_text(name: str, table: Mapping[str, Any], array: bool = False) -> str:
    """Return a table of plain values as lines of TOML, nothing for an empty one."""
    if not table:
        return ""
    lines = [f"[[{name}]]" if array else f"[{name}]"]
    lines += [f"{_key(key)} = {_value(value)}" for key, value in table.items()]
    return "\n".join(lines) + "\n"


def _key(key: str) -> str:
    return key if key and set(key) <= _BARE else _quoted(key)


def _quoted(text: str) -> str:
    """Return a basic string of TOML: JSON's, but for one control character and any half pair."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        what = f"{quoted(text)} holds characters that no text file can"
        raise InputError(what, "model", "Rename what it names") from None
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        return repr(float(value))
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    return "[" + ", ".join(_value(v) for v in value) + "]"
