"""Edits: a diagnosis is a minimal edit of a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from jaxsr.models.model import Model, Parameter


@dataclass(frozen=True)
class Edit:
    """Every key changed or added, with dotted names, e.g. ``equations.v`` -> new text.

    ``parameters.NAME`` holds a `Parameter`; ``model.states`` and ``model.outputs`` a tuple.
    """

    changes: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return the edit as plain values for ``diagnosis.json``."""
        plain: dict[str, Any] = {}
        for key, value in self.changes.items():
            if isinstance(value, Parameter):
                entry: dict[str, Any] = {"value": value.value, "unit": value.unit}
                if value.bounds is not None:
                    entry["bounds"] = list(value.bounds)
                plain[key] = entry
            else:
                plain[key] = list(value) if isinstance(value, tuple) else value
        return plain


def apply_edit(model: Model, edit: Edit) -> Model:
    """Return the model with every change of `edit` made."""
    tables: dict[str, Any] = {}
    for key, value in edit.changes.items():
        table, _, name = key.partition(".")
        if table == "model":
            tables[name] = value
            continue
        current = dict(tables.get(table, getattr(model, table)))
        head, _, tail = name.partition(".")
        if tail:
            current[head] = {**current.get(head, {}), tail: value}
        else:
            current[head] = value
        tables[table] = current
    return replace(model, **tables)


def difference(before: Model, after: Model) -> Edit:
    """Return the edit that turns `before` into `after`."""
    changes: dict[str, Any] = {}
    for item in fields(Model):
        old, new = getattr(before, item.name), getattr(after, item.name)
        if old == new or not item.compare:
            continue
        if not isinstance(new, Mapping):
            changes[f"model.{item.name}"] = new
            continue
        for name, value in new.items():
            if item.name == "inertia":
                for column, entry in value.items():
                    if old.get(name, {}).get(column) != entry:
                        changes[f"inertia.{name}.{column}"] = entry
            elif old.get(name) != value:
                changes[f"{item.name}.{name}"] = value
    return Edit(changes)


def with_values(model: Model, values: Mapping[str, float]) -> Model:
    """Return the model with parameter values replaced (and bounds widened to hold them)."""
    parameters = dict(model.parameters)
    for name, value in values.items():
        old = parameters[name]
        bounds = old.bounds
        if bounds is not None:
            bounds = (min(bounds[0], value), max(bounds[1], value))
        parameters[name] = replace(old, value=float(value), bounds=bounds)
    return replace(model, parameters=parameters)


def add_to_equation(
    model: Model, state: str, term: str, beside: str = "additions"
) -> tuple[str, str]:
    """Return key and new text of the equation of `state` with `term` (signed text) appended.

    The equations of a Python function stay as they are: the term goes to the table `beside` them,
    "additions" to the rate or "forces". Forces that enter an equation by a factor are kept there
    as well.
    """
    own = model.base is None or state in model.equations
    if beside == "forces" and state in model.force_factors:
        own = False
    table = "equations" if own else beside
    old = getattr(model, table).get(state, "")
    if not old or old.strip() in ("0", "0.0"):
        sign, body = signed(term)
        return f"{table}.{state}", f"{sign.strip('+')}{body}"
    return f"{table}.{state}", f"{old} {term}"


def signed(term: str) -> tuple[str, str]:
    """Return the sign before a term's text, "+" where there is none, and the rest."""
    return (term[0], term[2:]) if term[:2] in ("+ ", "- ") else ("+", term)
