"""Mechanisms that act in one mode only: on one side of a switch that the model states."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.expressions import to_numpy, to_text
from jaxsr.expressions.term import Term
from jaxsr.models import Model

SWITCHED = frozenset(
    {
        "viscous_damping",
        "coulomb_friction",
        "quadratic_drag",
        "linear_stiffness",
        "cubic_stiffness",
        "constant_force",
    }
)
LEAST = 0.02
"""Share of the samples that a mode must have for anything to be said about it."""
_RELATIONS = {"gt": "le", "ge": "lt", "lt": "ge", "le": "gt"}


def one_mode(
    model: Model, candidates: Iterable[Candidate], signals: Mapping[str, np.ndarray]
) -> Iterator[Candidate]:
    r"""Yield the plain forces among candidates once more for each mode of the model.

    With a condition g, a term a becomes

    .. math:: \begin{cases} a & g \\ 0 & \text{otherwise.} \end{cases}

    Parameters
    ----------
    model : Model
    candidates : iterable of Candidate
    signals : mapping of str to ndarray, (samples,)
        States, inputs and time in the recordings: modes that are hardly visited are left out.
    """
    modes = [m for m in modes_of(model) if _visited(m, model, signals)]
    for candidate in candidates:
        if candidate.mechanism in SWITCHED and candidate.terms:
            for mode in modes:
                yield _switched(candidate, to_text(mode))


def modes_of(model: Model) -> list[Term]:
    """Return the conditions under which the equations of a model change, and their opposites.

    A condition is a comparison in a ``Piecewise``, or the place where a ``Heaviside`` or a ramp
    ``Max(a, b)``, ``Min(a, b)`` engages. It must hang on a state, an input or time.
    """
    found: dict[Term, None] = {}
    signals = {*model.states, *model.inputs, model.time}
    for equation in model.equation_terms.values():
        for node in equation.distinct():
            condition = _condition(node)
            if condition is not None and condition.variables & signals:
                opposite = Term.apply(_RELATIONS[condition.op], *condition.args)
                if opposite not in found:
                    found.update(dict.fromkeys((condition, opposite)))
    return list(found)


def _condition(node: Term) -> Term | None:
    if node.op in _RELATIONS:
        return node
    if node.op == "heaviside":
        return Term.apply("gt", node.args[0], Term.constant(0.0))
    if node.op in ("max", "min") and len(node.args) == 2:
        return Term.apply("gt", *node.args)
    return None


def _visited(mode: Term, model: Model, signals: Mapping[str, np.ndarray]) -> bool:
    """Tell whether a mode and its opposite both hold long enough to be told apart."""
    values = {n: p.value for n, p in model.parameters.items()}
    known = {**values, **signals}
    if not mode.variables <= known.keys():
        return False
    share = float(np.mean(to_numpy(mode)(known)))
    return LEAST <= share <= 1.0 - LEAST


def _switched(candidate: Candidate, mode: str) -> Candidate:
    terms = tuple((state, _behind(template, mode)) for state, template in candidate.terms)
    sentence = f"{candidate.sentence} It acts only while {mode}."
    return replace(candidate, terms=terms, sentence=sentence)


def _behind(template: str, mode: str) -> str:
    """Return a signed template that holds in a mode only."""
    sign = "-" if template.startswith("-") else "+"
    return f"{sign} Piecewise(({template.lstrip('+- ')}, {mode}), (0, True))"
