"""Units of the forces along states, as text that a reader knows."""

from __future__ import annotations

from typing import Any

from jaxsr._result import InputError
from jaxsr.expressions.unit_text import factors_of
from jaxsr.models.force_factor import rate_dimension
from jaxsr.models.model import Model
from jaxsr.models.units import dimension, known_dimensions, unit_of

COMMON = ("N", "N*m", "m/s^2", "rad/s^2", "V/s^2", "V/s", "m/s", "A", "V", "W", "m^3/s", "kg/s")
"""Units that are called by their usual names."""
_BASE = {
    "[mass]": "kg",
    "[length]": "m",
    "[time]": "s",
    "[current]": "A",
    "[temperature]": "K",
    "[substance]": "mol",
    "[luminosity]": "cd",
}


def force_unit(model: Model, state: str) -> str | None:
    """Return a short text of the unit in which a force along a state is told.

    That of the terms in the bracket where a factor stands before it, of the generalised force in a
    row of [inertia], and of the rate where nothing tells a factor. None where units are missing.
    """
    entry = None if model.vector_field is None else model.vector_field.columns.get(state)
    if entry is not None and entry.beside is not None:
        return model.units.get(entry.beside)
    found, plain = force_dimension(model, state)
    if found is None:
        return _of_rate(model, state) if plain else None
    known = known_dimensions(model)
    for symbol in model.inputs:
        if known.get(symbol) == found:
            return model.units[symbol]
    for text in COMMON:
        if dimension(text) == found:
            return text
    return (_of_rate(model, state) if plain else None) or in_base_units(found)


def force_dimension(model: Model, state: str) -> tuple[Any, bool]:
    """Return the dimension of a force along a state, None where units are missing.

    Returns
    -------
    dimension
    plain : bool
        Whether it is that of the rate.
    """
    entry = None if model.vector_field is None else model.vector_field.columns.get(state)
    known, factor = known_dimensions(model), model.force_factors.get(state)
    plain = entry is None and factor is None and state not in model.inertia
    try:
        if plain or factor is not None:
            found = rate_dimension(model, state, model.equation_terms[state], known)
        else:
            found = unit_of(model.equation_terms[state], known)
        if entry is not None and found is not None:
            ((_, text),) = entry.rows
            by = unit_of(model.term(text or "1"), known)
            return (None if by is None else found / by), False
        if factor is None:
            return found, plain
        by = unit_of(dict(factor.rows)[state], known)
    except InputError:
        return None, False
    if found is None or by is None:  # what stands beside an input is told in its unit
        return None if factor.beside is None else known.get(factor.beside), False
    return found / by, False


def _of_rate(model: Model, state: str) -> str | None:
    return compose(model.units[state], ["s"]) if state in model.units else None


def compose(numerator: str, denominators: list[str]) -> str | None:
    """Return numerator / (product of denominators) as short unit text, factors in their order.

    None where a text is no unit.
    """
    powers: dict[str, float] = {}
    try:
        for text, sign in ((numerator, 1.0), *((d, -1.0) for d in denominators)):
            for name, power in factors_of(text).items():
                powers[name] = powers.get(name, 0.0) + sign * power
    except InputError:
        return None
    return _written(powers)


def in_base_units(found: Any) -> str:
    """Return a dimension in SI base units."""
    return _written({_BASE[base]: float(found[base]) for base in _BASE if base in found})


def _written(powers: dict[str, float]) -> str:
    above = "*".join(_factor(n, p) for n, p in powers.items() if p > 0)
    below = "".join(f"/{_factor(n, -p)}" for n, p in powers.items() if p < 0)
    return (above or "1") + below


def _factor(name: str, power: float) -> str:
    if power == 1.0:
        return name
    return f"{name}^{power:g}" if power == round(power) else f"{name}^({power:g})"
