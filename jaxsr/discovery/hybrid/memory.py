"""The function memory: terms of submodels already found, offered to the next ones (section 5)."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxsr.discovery.choose import Candidate
from jaxsr.discovery.equation import Equation
from jaxsr.evaluation import ColumnCache
from jaxsr.expressions.editing import ONE, edit
from jaxsr.expressions.term import Term

_PAIRED = 4  # states of a kind whose differences are looked at
_TINY = 4  # nodes of a term of states that a scan uses
_QUOTIENTS = frozenset({"div", "exp", "log"})
_SMALL = 5  # terms of a candidate whose terms are worth to be remembered
_PLAIN = 9  # nodes of a term worth to be remembered
_DEPENDENT = 1e-6  # part of a column that others do not give, below which it adds nothing


@dataclass
class FunctionMemory:
    """Distinct terms, oldest first, with the constants that they carry.

    A term enters in every form that is the same where it was found: where a state kept its sign,
    ``exp(-3*v)`` is also ``exp(-3*Abs(v))`` and ``sign(v)*exp(-3*Abs(v))``, of which one may hold
    on both sides of zero.
    """

    terms: dict[Term, None] = field(default_factory=dict)

    def add(self, terms: Iterable[Term]) -> None:
        """Remember terms; known ones are kept once."""
        self.terms.update(dict.fromkeys(terms))

    def learn(self, terms: Iterable[Term], variables: Mapping[str, np.ndarray]) -> None:
        """Remember terms found on samples, and their continuations to the other sign.

        Variables are states and inputs: time has no other sign.
        """
        keeps = [n for n, v in variables.items() if np.all(v > 0.0) or np.all(v < 0.0)]
        for term in terms:
            for form in continuations(term, keeps):
                self.add(edit([form]))

    def __iter__(self):
        return iter(self.terms)

    def __len__(self) -> int:
        return len(self.terms)


def continuations(term: Term, names: Sequence[str]) -> list[Term]:
    """Return the term, and what equals it or its negative where a name keeps its sign.

    For each name x: f(x), f(|x|), sign(x) f(|x|) and sign(x) f(x).
    """
    forms = {term: None}
    for name in names:
        x = Term.variable(name)
        size, sign = Term.apply("abs", x), Term.apply("sign", x)
        new: list[Term] = []
        for form in forms:
            if name in form.variables:
                even = form.substitute({name: size})
                new += [even, Term.apply("mul", sign, even)]
            elif form == ONE:
                new.append(sign)
        forms.update(dict.fromkeys(new[:64]))
    return list(forms)


def front_terms(equations: Sequence[Equation]) -> list[Term]:
    """Return the plain terms of the best candidates of every small size, smallest first."""
    out: dict[Term, None] = {}
    for equation in equations:
        best: dict[int, Candidate] = {}
        for candidate in equation.front:
            size = len(candidate.fit.terms)
            if size not in best or candidate.train_mse < best[size].train_mse:
                best[size] = candidate
        for size in sorted(best)[: _SMALL + 1]:
            out.update(dict.fromkeys(t for t in best[size].fit.terms if t.size <= _PLAIN))
    return list(out)


def scanned_terms(memory: Iterable[Term], states: Sequence[str], time: str) -> list[Term]:
    """Return the remembered terms that a scan needs beside the usual ones.

    Terms of time alone, for no power of a state stands in for a force; and of states the smallest,
    without quotients, for many of those together fit anything.
    """
    out = []
    for term in memory:
        timed = term.variables == {time}
        if timed or (term.size <= _TINY and not term.uses(_QUOTIENTS)):
            out.append(term)
    return out


def usual_terms(
    states: Sequence[str], inputs: Sequence[str], kinds: Sequence[Sequence[str]] = ()
) -> list[Term]:
    """Return what local laws are made of: low powers, products, sizes and signs.

    Of two states of one kind also the sign of their difference, which tells the sides of a gap.
    """
    variables = [Term.variable(name) for name in (*states, *inputs)]
    moving = [Term.variable(name) for name in states]
    out = [ONE, *variables]
    for names in kinds:
        pairs = itertools.combinations([Term.variable(n) for n in names[:_PAIRED]], 2)
        out += [Term.apply("sign", Term.apply("sub", a, b)) for a, b in pairs]
    for x in moving:
        size = Term.apply("abs", x)
        out += [Term.apply("mul", x, x), Term.apply("mul", size, x), size]
        out += [Term.apply("sign", x), Term.apply("pow", x, Term.constant(3.0))]
    out += [Term.apply("mul", a, b) for a, b in itertools.combinations(variables, 2)]
    return [edit([term])[0] for term in out]


def independent_columns(
    terms: Iterable[Term], variables: Mapping[str, np.ndarray], most: int
) -> tuple[list[Term], np.ndarray]:
    """Return terms, in order, whose columns earlier ones do not give, and the columns.

    Returns
    -------
    terms : list of Term
        At most ``most``.
    columns : ndarray, (samples, terms)
        Scaled to a mean square of one.
    """
    cache = ColumnCache(variables, time=next(iter(variables)))
    kept: list[Term] = []
    columns: list[np.ndarray] = []
    basis = np.zeros((len(next(iter(variables.values()))), 0))
    for term in terms:
        if len(kept) == most:
            break
        column = np.broadcast_to(cache.column(term), basis.shape[:1]).astype(float)
        size = float(np.sqrt(np.mean(column**2))) if np.all(np.isfinite(column)) else 0.0
        if not size > 0.0:
            continue
        column = column / size
        left = column - basis @ (basis.T @ column)
        left -= basis @ (basis.T @ left)
        norm = float(np.linalg.norm(left))
        if norm < _DEPENDENT * np.sqrt(len(column)):
            continue
        kept.append(term)
        columns.append(column)
        basis = np.column_stack([basis, left / norm])
    return kept, np.column_stack(columns) if columns else basis


def harmonics(terms: Iterable[Term], time: str) -> list[Term]:
    """Return sines and cosines of the frequencies in terms, and of their doubles.

    A product of a sine and a cosine is a sine of the doubled frequency, which is plainer.
    """
    found: dict[float, None] = {}
    for term in terms:
        for node in term.walk():
            if node.op not in ("sin", "cos") or node.variables != {time}:
                continue
            w = frequency(node.args[0], time)
            if w is not None:
                found.setdefault(w)
    out: dict[Term, None] = {}
    for w in list(found)[:6]:
        for factor in (1.0, 2.0):
            angle = Term.apply("mul", Term.constant(factor * w), Term.variable(time))
            for wave in ("sin", "cos"):
                out.update(dict.fromkeys(edit([Term.apply(wave, angle)])))
    return list(out)


def frequency(angle: Term, time: str) -> float | None:
    """Return w where an angle is w*t, else None."""
    if angle == Term.variable(time):
        return 1.0
    if angle.op == "mul" and angle.args[0].is_constant and angle.args[1] == Term.variable(time):
        return angle.args[0].value
    return None
