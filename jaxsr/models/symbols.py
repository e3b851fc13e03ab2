"""Checks of a model's names and expressions, made once when a file is read."""

from __future__ import annotations

import keyword
import re

from jaxsr._quoting import quoted
from jaxsr._result import InputError
from jaxsr.expressions import Term, is_identifier
from jaxsr.expressions.parsing import MAX_LEVELS, levels
from jaxsr.models.model import Model
from jaxsr.models.tables import MAX_NAME, Tables, event_place, place

_ASCII_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_REMEDY = "Use ASCII letters, digits and _, no keyword of Python and no function's name"


def check_names(model: Model, tables: Tables) -> None:
    """Check that every name can stand in an expression, and that every key names something.

    Raises
    ------
    InputError
        A name is no identifier or declared twice, or a key of a table names nothing.
    """
    declared = {
        "[model] time": (model.time,),
        "[model] states": model.states,
        "[model] inputs": model.inputs,
        "[parameters]": model.parameters,
        "[definitions]": model.definitions,
    }
    seen: dict[str, str] = {}
    for where, names in declared.items():
        for name in names:
            if len(name) > MAX_NAME or not is_identifier(name):
                raise tables.fail(f"{quoted(name)} cannot name a symbol", where, _REMEDY)
            if name in seen:
                what = f"{quoted(name)} is declared twice, in {seen[name]} too"
                raise tables.fail(what, where, "Rename one of them")
            seen[name] = where
    for name in model.outputs:
        plain = _ASCII_NAME.fullmatch(name) and not keyword.iskeyword(name)
        if len(name) > MAX_NAME or not plain:
            remedy = "Use ASCII letters, digits and _; [columns] may name any column"
            raise tables.fail(f"{quoted(name)} cannot name an output", "[model] outputs", remedy)
    _check_keys(model, tables)


def _check_keys(model: Model, tables: Tables) -> None:
    states, inputs, outputs = model.states, model.inputs, model.outputs
    everything = (model.time, *states, *inputs, *outputs)
    roles = {
        "equations": (model.equations, states),
        "additions": (model.additions, states),
        "inertia": (model.inertia, states),
        "readings": (model.readings, outputs),
        "initial": (model.initial, states),
        "delays": (model.delays, (*inputs, *outputs)),
        "clock": (model.clock, outputs),
        "noise": (model.noise, outputs),
        "resolution": (model.resolution, outputs),
        "per_recording": (model.per_recording, tuple(model.parameters)),
        "units": (model.units, (*everything, *model.parameters, *model.definitions)),
        "columns": (model.columns, everything),
    }
    for name, (table, keys) in roles.items():
        tables.known(table, keys, place(name))
    state = dict.fromkeys(states)
    for row, entries in model.inertia.items():
        tables.known(entries, state, place("inertia", row))
    for number, event in enumerate(model.events, 1):
        tables.known(event.reset, state, event_place(number, "reset"))


def check_expressions(model: Model, tables: Tables) -> None:
    """Parse every expression once, so that its errors come when the file is read.

    Raises
    ------
    InputError
        An expression is none of the grammar, or one that must be there is missing.
    """
    for what, keys, table, needed in (
        ("equation for state", model.states, "equations", model.base is None),
        ("reading for output", model.outputs, "readings", True),
    ):
        missing = [key for key in keys if key not in getattr(model, table)] if needed else []
        if missing:
            remedy = f'Write {missing[0]} = "..."'
            raise tables.fail(f"no {what} {missing[0]!r}", place(table), remedy)
    _ = model.equation_terms, model.reading_terms, model.inertia_terms
    _check_levels(model)
    moving = {*model.states, *model.inputs}
    for name, text in model.clock.items():
        if model.term(text, place("clock", name)).variables & moving:
            what, remedy = "a clock on states or inputs", "Use time and parameters alone"
            raise tables.fail(what, place("clock", name), remedy)
    for number, event in enumerate(model.events, 1):
        model.term(event.when, event_place(number, "when"))
        for state, text in event.reset.items():
            model.term(text, event_place(number, f"reset {state}"))


def _check_levels(model: Model) -> None:
    """Refuse what is too deep with its definitions written out: some walks are recursive."""
    places = [(place("definitions", d), term) for d, term in model.definition_terms.items()]
    places += [(place("equations", s), term) for s, term in model.equation_terms.items()]
    places += [(place("readings", y), term) for y, term in model.reading_terms.items()]
    for i, row in model.inertia_terms.items():
        places += [(place("inertia", i, j), term) for j, term in row.items()]
    met: dict[Term, int] = {}
    for where, term in places:
        if (found := levels(term, met)) > MAX_LEVELS:
            what = f"has {found} levels of operators, its definitions written out"
            remedy = f"At most {MAX_LEVELS} are read: nest fewer in each other"
            raise InputError(what, where, remedy)
