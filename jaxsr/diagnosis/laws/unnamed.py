"""Laws without a name: where one may stand for named forces, and how it becomes a candidate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce

import numpy as np

from jaxsr.diagnosis.laws.natural import Natural
from jaxsr.diagnosis.laws.poles import ranges_of, without_poles
from jaxsr.diagnosis.mechanisms.candidate import UNLIMITED, UNNAMED, Candidate, ParameterSpec
from jaxsr.evolution.propose import Proposal
from jaxsr.expressions import Term, to_text
from jaxsr.expressions.description import description_length, opened
from jaxsr.models import Model
from jaxsr.models.segments import Prepared

MAX_TERMS = 2
REACH = 10.0
"""Factor within which constants inside a proposed term are estimated."""
CUBIC = 3
"""Highest power that has a name."""
FORCES = frozenset("dissipative elastic coupling periodic memory".split())
"""Families of forces that the shape of another one can imitate."""
ProposedForce = tuple[Candidate, np.ndarray]
"""A candidate and the values of its coefficients."""
Law = tuple[ProposedForce, ...]
"""Forces that are proposed together: one without a name, or the named ones whose sum a law is."""
_LONGEST = 900.0  # bits whose power of two is a number
_POWERS = frozenset({"mul", "div", "pow", "sqrt", "abs", "sign"})


def sizes_of(model: Model, prepared: Sequence[Prepared]) -> dict[str, float]:
    """Rms of every state and input to two digits, by which the search divides."""
    sizes = {}
    states = np.concatenate([item.states.values for item in prepared])
    inputs = np.concatenate([item.inputs for item in prepared])
    columns = [*zip(model.states, states.T, strict=True), *zip(model.inputs, inputs.T, strict=True)]
    for name, values in columns:
        rms = float(np.sqrt(np.nanmean(values**2)))
        sizes[name] = float(f"{rms:.2g}") if np.isfinite(rms) and rms > 0 else 1.0
    return sizes


def as_candidate(
    model: Model, prepared: Sequence[Prepared], state: int, proposal: Proposal
) -> ProposedForce:
    """Write a proposal as a candidate; constants inside its terms are estimated as well."""
    name, natural = model.states[state], Natural(sizes_of(model, prepared))
    factors, terms = zip(*(natural.of(term) for term in proposal.terms), strict=True)
    pieces = [f"{{c{k}}}*({to_text(term, 6)})" for k, term in enumerate(terms, 1)]
    values = proposal.coefficients * np.array(factors)
    most = np.maximum(REACH * np.abs(values), UNLIMITED)  # of cubes of small states
    coefficients = [ParameterSpec(f"c{k}", low=-m, high=m) for k, m in enumerate(most.tolist(), 1)]
    constants = [
        ParameterSpec(
            f"a{k}",
            low=min(value / REACH, value * REACH),
            high=max(value / REACH, value * REACH),
            neutral=value,
            coefficient=False,
        )
        for k, value in enumerate(natural.inner, 1)
    ]
    candidate = Candidate(
        mechanism=UNNAMED,
        family=UNNAMED,
        site=f"equation:{name}",
        parameters=(*coefficients, *constants),
        sentence="A force that matches no named mechanism acts along {site}; the search wrote it.",
        terms=((name, "+ " + " + ".join(pieces)),),
        tried=choices(*map(opened, proposal.terms)),
        physical=without_poles(terms, ranges_of(model, prepared)),
        source="evolutionary sparse regression",
    )
    return candidate, np.array([*values, *natural.inner])


def choices(*terms: Term) -> float:
    """Return among how many laws as long as one it was chosen: 2 to the power of its bits.

    By Kraft's inequality there are no more. What estimated constants take is no part of it, and no
    scale of a state is.
    """
    return 2.0 ** min(sum(map(description_length, terms)), _LONGEST)


def law_of(proposal: Proposal, sizes: Mapping[str, float]) -> Term:
    """Return a proposal over the states themselves, its constants as numbers."""
    scaled = {n: Term("div", (Term.variable(n), Term.constant(s))) for n, s in sizes.items()}
    terms = [
        Term("mul", (Term.constant(float(c)), term.substitute(scaled)))
        for c, term in zip(proposal.coefficients, proposal.terms, strict=True)
    ]
    return reduce(lambda a, b: Term("add", (a, b)), terms)


def estimable(proposal: Proposal) -> bool:
    """Whether it has few terms, and coefficients inside the bounds of coefficients.

    q (q^2 + 47)^-61 is a bell of its own kind, and wants 1e102 of itself.
    """
    few = 0 < len(proposal.terms) <= MAX_TERMS
    return few and bool((np.abs(proposal.coefficients) < UNLIMITED).all())


def has_a_name(proposal: Proposal) -> bool:
    """Whether every term is one that named mechanisms have: powers, drags and ripples."""
    return all(_is_power(t) or _is_ripple(t) for t in proposal.terms)


def _is_power(term: Term) -> bool:
    """Whether a term is a product of powers of one state, with or without signs of it."""
    plain = all(t.op in _POWERS or not t.args for t in term.walk())
    return plain and len(term.variables) <= 1 and 0.0 <= _degree(term) <= CUBIC


def _is_ripple(term: Term) -> bool:
    """Whether a term is a sine of a line."""
    return term.op in ("sin", "cos") and all(
        t.op in ("add", "sub", "mul", "div") or not t.args for t in term.args[0].walk()
    )


def _degree(term: Term) -> float:
    """Degree of a product of powers of one variable."""
    if not term.args:
        return float(term.is_variable)
    first = _degree(term.args[0])
    if term.op == "mul":
        return sum(_degree(a) for a in term.args)
    if term.op == "div":
        return first - _degree(term.args[1])
    if term.op == "pow":
        return first * term.args[1].value if term.args[1].is_constant else np.inf
    return {"sqrt": 0.5, "abs": 1.0, "sign": 0.0}[term.op] * first
