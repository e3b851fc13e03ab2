"""What is known before the search: given right-hand sides, units, and signs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxsr._files import sha256
from jaxsr._result import InputError
from jaxsr.discovery.equation import Equation
from jaxsr.discovery.samples import Roles
from jaxsr.expressions import parse
from jaxsr.expressions.editing import edit, split
from jaxsr.expressions.term import Term
from jaxsr.models.document import read_document
from jaxsr.models.model import Model
from jaxsr.models.reading import read_model
from jaxsr.regression import InUnits


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


def known_checksum(known: str | Path | Model | None) -> dict[str, str]:
    """Return the SHA-256 of the file of the known part, by its name."""
    path = Path(known) if isinstance(known, str | Path) else None
    return {} if path is None else {path.name: sha256(path)}


def unit_table(units: str | Path | Mapping[str, str] | None) -> dict[str, str]:
    """Return the unit of each column, from a mapping or the [units] table of a file."""
    if units is None or isinstance(units, Mapping):
        return dict(units or {})
    table = read_document(Path(units)).get("units", {})
    if not isinstance(table, Mapping):
        raise InputError("[units] is no table", Path(units).name, 'Write q = "m" under [units]')
    return {str(k): str(v) for k, v in table.items()}


def guessed_terms(
    guesses: Mapping[str, Sequence[str]] | None, states: Sequence[str], names: Sequence[str]
) -> dict[str, tuple[tuple[Term, ...], ...]]:
    """Return, for each state, the sets of terms of its guessed expressions.

    Raises
    ------
    InputError
        A state is unknown, or an expression is not of the grammar.
    """
    out: dict[str, tuple[tuple[Term, ...], ...]] = {state: () for state in states}
    for state, texts in (guesses or {}).items():
        if state not in states:
            raise InputError(f"{state!r} is no state", "guesses", f"Known: {', '.join(states)}.")
        where, each = f"guesses of {state}", (texts,) if isinstance(texts, str) else texts
        out[state] = tuple(edit([parse(text, names, where, integrals=True)]) for text in each)
    return out


def signed_terms(
    signs: Mapping[str, Mapping[str, int]] | None, states: Sequence[str], names: Sequence[str]
) -> dict[str, dict[Term, int]]:
    """Return, for each state, the terms whose coefficients have a given sign.

    Raises
    ------
    InputError
        A state is unknown, a sign is neither 1 nor -1, or an expression is a sum.
    """
    out: dict[str, dict[Term, int]] = {}
    for state, table in (signs or {}).items():
        if state not in states:
            raise InputError(f"{state!r} is no state", "signs", f"Known: {', '.join(states)}.")
        where = f"signs of {state}"
        if not isinstance(table, Mapping):
            raise InputError("a table of terms and their signs is needed", where)
        for text, sign in table.items():
            parts = split(parse(text, names, where, integrals=True))
            if len(parts) != 1:
                raise InputError(f"{text!r} is not one term", where, "Give each term its sign.")
            if sign not in (1, -1):
                raise InputError(f"the sign of {text!r} must be 1 or -1, got {sign!r}", where)
            scale, term = parts[0]
            out.setdefault(state, {})[term] = int(sign) if scale > 0.0 else -int(sign)
    return out


@dataclass(frozen=True)
class Admitted:
    """Admit terms that have a meaning in units and can be simulated.

    Attributes
    ----------
    units : InUnits or None
        None: units do not bind.
    over : tuple of str
        What an integral may be taken over: states and time, for their rates are known.
    """

    units: InUnits | None
    over: tuple[str, ...]

    def __call__(self, term: Term) -> bool:
        """Tell whether the term may be used."""
        for node in term.walk():
            if node.op == "integral_over" and node.args[1].name not in self.over:
                return False
        return self.units is None or self.units(term)


@dataclass(frozen=True)
class PriorTerms:
    """What is known before the search.

    Attributes
    ----------
    given : mapping of str to Term
        Right-hand sides, or parts of them.
    guesses : mapping of str to tuple of tuple of Term
        For each state, sets of terms to start from.
    signs : mapping of str to mapping of Term to int
        For each state, terms whose coefficients have a sign.
    admits : Admitted or None
        Which terms may be used; None: all.
    """

    given: Mapping[str, Term]
    guesses: Mapping[str, tuple[tuple[Term, ...], ...]]
    signs: Mapping[str, Mapping[Term, int]]
    admits: Admitted | None

    def uses(self, name: str) -> bool:
        """Tell whether anything stated beforehand depends on a variable."""
        stated = [*self.given.values(), *(t for own in self.signs.values() for t in own)]
        stated += [t for sets in self.guesses.values() for terms in sets for t in terms]
        return any(name in term.variables for term in stated)


def admission(units: InUnits | None, part: Roles) -> Admitted:
    """Return what the equations of these roles admit."""
    return Admitted(units, (part.time, *part.states))


def obeys(equation: Equation, signs: Mapping[Term, int]) -> bool:
    """Tell whether no searched term of an equation has the sign it must not have."""
    searched = [t for t in equation.terms if not t.given]
    return all(t.coefficient * signs.get(t.term, 0) >= 0.0 for t in searched)


def binding_units(
    units: Mapping[str, str], bind: bool | None, time: str, names: Sequence[str]
) -> InUnits | None:
    """Return the units that every term must have a meaning in; None where they do not bind.

    Parameters
    ----------
    units : mapping of str to str
    bind : bool, optional
        By default they bind where every one of ``names`` has one.
    time : str
        Counts in seconds unless ``units`` says otherwise.
    names : sequence of str
        States and inputs.

    Raises
    ------
    InputError
        They shall bind and one is missing.
    """
    missing = [name for name in names if name not in units]
    if bind and missing:
        raise InputError(
            f"{missing[0]} has no unit", "bind_units", "Give one for every state and input."
        )
    if bind is False or missing:
        return None
    return InUnits.of({time: "s", **{n: units[n] for n in (time, *names) if n in units}})
