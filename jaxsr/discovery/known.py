"""What is known before the search: given right-hand sides, and units."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

from jaxsr._result import InputError
from jaxsr.expressions import parse
from jaxsr.expressions.editing import edit
from jaxsr.expressions.term import Term
from jaxsr.models.model import Model
from jaxsr.models.reading import read_model


def known_terms(
    known: str | Path | Model | None, time: str, names: Sequence[str]
) -> dict[str, Term]:
    """Return the given right-hand sides with their parameters' values in place."""
    if known is None:
        return {}
    model = known if isinstance(known, Model) else read_model(known)
    if model.inertia:
        raise InputError(
            "a known part with [inertia] cannot be used", model.name, "Solve it for the rates."
        )
    values = {n: Term.constant(p.value) for n, p in model.parameters.items()}
    values[model.time] = Term.variable(time)
    out = {s: term.substitute(values) for s, term in model.equation_terms.items()}
    for state, term in out.items():
        unknown = sorted(term.variables - {time, *names})
        if unknown:
            raise InputError(
                f"{unknown[0]} is neither a state nor an input here",
                f"{model.name} [equations] {state}",
                f"Known: {', '.join((time, *names))}.",
            )
    return {s: term for s, term in out.items() if s in names}


def unit_table(units: str | Path | Mapping[str, str] | None) -> dict[str, str]:
    """Return the unit of each column, from a mapping or the [units] table of a file."""
    if units is None or isinstance(units, Mapping):
        return dict(units or {})
    path = Path(units)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8")).get("units", {})
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"cannot be read: {error}", str(path)) from error
    return {str(k): str(v) for k, v in table.items()}


def guessed_terms(
    guesses: Mapping[str, Sequence[str]] | None, state: str, names: Sequence[str]
) -> tuple[tuple[Term, ...], ...]:
    """Return the sets of terms of a state's guessed expressions."""
    texts = (guesses or {}).get(state, ())
    if isinstance(texts, str):
        texts = (texts,)
    return tuple(edit([parse(text, names, f"guesses of {state}")]) for text in texts)
