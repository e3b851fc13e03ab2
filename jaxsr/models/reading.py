"""Model files to models, with errors that name file, key, symbol and remedy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxsr._quoting import quoted
from jaxsr._result import InputError
from jaxsr.models.document import parse_document, read_document
from jaxsr.models.model import FREE, Model
from jaxsr.models.named_rates import with_named_rates
from jaxsr.models.solvability import check_solvable
from jaxsr.models.symbols import check_expressions, check_names
from jaxsr.models.tables import Tables
from jaxsr.models.units import check_units

_TABLES = (
    *("model", "definitions", "equations", "inertia", "readings", "parameters", "per_recording"),
    *("initial", "delays", "clock", "noise", "resolution", "events", "units", "columns"),
    "additions",
)
_MODEL_KEYS = (
    *("name", "time", "states", "inputs", "outputs", "input_hold", "sample_time", "base"),
)
_HOLDS = ("linear", "zero", "bandlimited")


def read_model(path: str | Path) -> Model:
    """Read a model file.

    Parameters
    ----------
    path : path
        A TOML file as docs/model-file.md describes.

    Returns
    -------
    Model

    Raises
    ------
    InputError
        The file is missing, is no TOML, or breaks a rule of docs/model-file.md.
    """
    path = Path(path)
    return build_model(read_document(path), path.name)


def parse_model(text: str, source: str = "model") -> Model:
    """Read a model from the text of a model file; `source` names it in errors."""
    return build_model(parse_document(text.removeprefix("\ufeff"), source), source)


def build_model(document: Mapping[str, Any], source: str = "model") -> Model:
    """Build and check a model from the tables of a model file.

    Raises
    ------
    InputError
        A table breaks a rule of docs/model-file.md.
    """
    tables = Tables(document, source)
    tables.known(document, _TABLES)
    if "model" not in document:
        raise tables.fail("no [model] table", "", "Start with [model] states = [...]")
    model = _model(tables)
    check_names(model, tables)
    try:
        check_expressions(model, tables)
        if model.base is None:
            model = with_named_rates(model)
        check_units(model, source)
        check_solvable(model)
    except InputError as error:
        if error.where.startswith(source):
            raise
        raise InputError(error.what, f"{source} {error.where}", error.remedy) from None
    return model


def _model(tables: Tables) -> Model:
    """Take every value from its table, each of the type that it must have."""
    head = tables.table("model")
    tables.known(head, _MODEL_KEYS, "[model]")
    states = tables.names(head, "states", needed=True)
    hold = head.get("input_hold", "linear")
    if hold not in _HOLDS:
        what = f"input_hold {quoted(hold)}"
        raise tables.fail(what, "[model]", f"Use one of {', '.join(_HOLDS)}")
    step = head.get("sample_time")
    parameters = {n: tables.parameter(n, v) for n, v in tables.table("parameters").items()}
    return Model(
        name=tables.text(head.get("name", tables.source), "[model] name"),
        states=states,
        inputs=tables.names(head, "inputs"),
        outputs=tables.names(head, "outputs", needed=True),
        time=tables.text(head.get("time", "t"), "[model] time"),
        input_hold=hold,
        sample_time=None
        if step is None
        else tables.above_zero(step, "[model] sample_time", "a step"),
        base=tables.text(head["base"], "[model] base") if "base" in head else None,
        additions=tables.expressions("additions"),
        definitions=tables.expressions("definitions"),
        equations=tables.expressions("equations"),
        inertia=tables.inertia(),
        readings=tables.expressions("readings"),
        parameters=parameters,
        per_recording=tables.per_recording(),
        initial={**dict.fromkeys(states, FREE), **tables.initial(FREE)},
        delays=tables.delays(parameters),
        clock=tables.expressions("clock"),
        noise=tables.spreads("noise", "a noise"),
        resolution=tables.spreads("resolution", "a step"),
        events=tables.events(),
        units=tables.texts("units"),
        columns=tables.texts("columns"),
    )
