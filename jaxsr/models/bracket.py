"""Where in the text of an equation a force is written: in the bracket, beside the other forces."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions import Term, evaluate, parse, to_text
from jaxsr.models.edits import add_to_equation, signed
from jaxsr.models.force_factor import Factor, random_points
from jaxsr.models.model import Model, Parameter

Array = Any
SAME = 1e-9
"""Relative difference at which two values are the same but for rounding."""
_SUMS = (ast.Add, ast.Sub)


@dataclass(frozen=True)
class Place:
    """A part of an equation's text in which a force stands for itself.

    Attributes
    ----------
    start, end : int
        Of the part, in characters.
    minus : bool
        Whether the bracket as a whole is subtracted.
    summed : bool
        Whether the part is a sum, and stands in brackets already.
    """

    start: int
    end: int
    minus: bool
    summed: bool


def add_force(model: Model, state: str, term: str) -> tuple[tuple[str, str], ...]:
    """Return keys and new texts of the equations with a force along a state added.

    Parameters
    ----------
    model : Model
        Of formulas.
    state : str
    term : str
        Signed text of the force, such as ``- Fc*sign(w)``.

    Notes
    -----
    What is written is compared with the equation plus factor times force at random points; where
    the text offers no place for it, that product is appended.
    """
    factor = model.force_factors.get(state)
    if factor is None:
        return (add_to_equation(model, state, term),)
    if len(factor.rows) > 1:
        return _beside(model, factor, term) or tuple(_appended(model, factor, term))
    row, multiplier = next(iter(factor.rows))
    text, points = model.equations[row], _points(model)
    for place in _places(model, text, multiplier, points):
        new = _with_force(text, place, term)
        if _adds(model, {row: new}, factor, term):
            return ((f"equations.{row}", new),)
    return tuple(_appended(model, factor, term))


def _appended(model: Model, factor: Factor, term: str) -> Iterator[tuple[str, str]]:
    """Yield the equations with the force times its factors at their ends."""
    for row, multiplier in factor.rows:
        yield add_to_equation(model, row, scaled(term, multiplier))


def scaled(term: str, factor: Term) -> str:
    """Return a signed term times a factor, as text."""
    sign, body = _as_product(term)
    if factor.op == "div":
        above, below = factor.args
        under = to_text(below)
        under = under if re.fullmatch(r"[\w.]+", under) else f"({under})"
        if above.is_constant and above.value == 1.0:
            return f"{sign} {body}/{under}"
        return f"{sign} {_in_brackets(above)}*{body}/{under}"
    return f"{sign} {_in_brackets(factor)}*{body}"


def _in_brackets(term: Term) -> str:
    text = to_text(term)
    return text if re.fullmatch(r"[\w.]+", text) else f"({text})"


def _beside(model: Model, factor: Factor, term: str) -> tuple[tuple[str, str], ...]:
    """Return the equations and definitions with the force added to the input beside it."""
    u, changes = factor.beside, dict[str, str]()
    if u is None:
        return ()
    word, force = re.compile(rf"\b{re.escape(u)}\b"), " ".join(signed(term))
    for table in ("definitions", "equations"):
        for key, old in getattr(model, table).items():
            if word.search(old):
                changes[f"{table}.{key}"] = word.sub(partial(_joined, force), old)
    definitions = {k.partition(".")[2]: v for k, v in changes.items() if k.startswith("def")}
    equations = {k.partition(".")[2]: v for k, v in changes.items() if k.startswith("equ")}
    # A definition that a reading shows, or the force itself uses, says what it said before.
    shown = " ".join((*model.readings.values(), *(x for row in model.inertia.values()
                      for x in row.values()), term))  # fmt: skip
    if any(re.search(rf"\b{d}\b", shown) for d in definitions):
        return ()
    good = _adds(model, equations, factor, term, definitions)
    return tuple(changes.items()) if good else ()


def _joined(force: str, met: re.Match[str]) -> str:
    """Return an input with a force added, in brackets where it is no summand of its own."""
    before, after = met.string[: met.start()].rstrip(), met.string[met.end() :].lstrip()
    summand = before[-1:] in ("", "(", "+") and after[:1] in ("", ")", "+", "-")
    return f"{met.group()} {force}" if summand else f"({met.group()} {force})"


def _adds(
    model: Model,
    equations: Mapping[str, str],
    factor: Factor,
    term: str,
    definitions: Mapping[str, str] | None = None,
) -> bool:
    """Whether new texts are the old equations plus factors times the force."""
    sign, body = signed(term)
    names = parse(body).variables - {*model.symbols, *model.definitions}
    points = _points(model, names)
    more = {**model.parameters, **{n: Parameter(1.0) for n in sorted(names)}}
    try:
        new = replace(
            model, parameters=more, definitions={**model.definitions, **(definitions or {})}
        )
        force = _at(model.term(f"{sign.strip('+')}{body}", extra=tuple(names)), points)
        multipliers = dict(factor.rows)
        for state in model.equations:
            text = equations.get(state, model.equations[state])
            before = _at(model.term(model.equations[state]), points)
            after = _at(new.term(text), points)
            added = _at(multipliers[state], points) * force if state in multipliers else 0.0
            if not _same(after, before + added):
                return False
    except InputError:
        return False
    return True


def _same(first: Array, second: Array) -> bool:
    good = np.isfinite(second)
    size = np.abs(second[good]).max(initial=1e-300)
    return bool(good.any() and np.all(np.abs(first[good] - second[good]) <= SAME * size))


def _points(model: Model, more: frozenset[str] | set[str] = frozenset()) -> dict[str, Array]:
    points, rng = random_points(model), np.random.default_rng(1)
    size = points[model.time].shape
    return points | {name: rng.uniform(0.5, 2.0, size) for name in sorted(more)}


def _at(term: Term, points: Mapping[str, Array]) -> Array:
    with np.errstate(all="ignore"):
        value = np.asarray(evaluate(term, points), dtype=float)
    return np.broadcast_to(value, next(iter(points.values())).shape)


def _places(model: Model, text: str, factor: Term, points: Mapping[str, Array]) -> Iterator[Place]:
    """Yield the parts of an equation that are multiplied by the factor, sums first."""
    if "\n" in text or not text.isascii():
        return
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return
    shift = len(text) - len(text.lstrip())
    target = _at(factor, points)

    def value(node: ast.expr) -> Array:
        part = text[node.col_offset + shift : (node.end_col_offset or 0) + shift]
        return _at(model.term(part), points)

    found = list(_walk(tree, np.ones_like(target), value, target, True))
    for summed in (True, False):
        for node, minus, is_sum, free in found:
            if is_sum == summed and (summed or free):
                start, end = node.col_offset + shift, (node.end_col_offset or 0) + shift
                yield Place(start, end, minus, summed)


def _walk(
    node: ast.expr, outer: Array, value: Any, target: Array, free: bool
) -> Iterator[tuple[ast.expr, bool, bool, bool]]:
    """Yield nodes whose multiplier is the target or minus it; `free` where no sum stands outside.

    Parts whose multiplier is 1 are the equation itself.
    """
    is_sum = isinstance(node, ast.BinOp) and isinstance(node.op, _SUMS)
    with np.errstate(all="ignore"):
        for minus in (False, True):
            if _same(outer, -target if minus else target):
                inner = _negated(node)
                negated = inner is not node
                if isinstance(inner, ast.BinOp) and isinstance(inner.op, _SUMS):
                    yield inner, minus != negated, True, free
                else:
                    yield node, minus, False, free
                return
        if (inner := _negated(node)) is not node:
            yield from _walk(inner, -outer, value, target, free)
        if not isinstance(node, ast.BinOp):
            return
        if is_sum:
            sign = -1.0 if isinstance(node.op, ast.Sub) else 1.0
            yield from _walk(node.left, outer, value, target, False)
            yield from _walk(node.right, sign * outer, value, target, False)
        elif isinstance(node.op, ast.Mult):
            yield from _walk(node.left, outer * value(node.right), value, target, free)
            yield from _walk(node.right, outer * value(node.left), value, target, free)
        elif isinstance(node.op, ast.Div):
            yield from _walk(node.left, outer / value(node.right), value, target, free)


def _negated(node: ast.expr) -> ast.expr:
    """Return what a minus sign stands before; the node itself where there is none."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return node.operand
    return node


def _with_force(text: str, place: Place, term: str) -> str:
    """Return the text with the force at its place."""
    sign, body = signed(term)
    if place.minus:
        sign, body = _as_product(term)
        sign = "-" if sign == "+" else "+"
    part = text[place.start : place.end]
    new = f"{part} {sign} {body}"
    return text[: place.start] + (new if place.summed else f"({new})") + text[place.end :]


def _as_product(term: str) -> tuple[str, str]:
    """Return sign and text of a signed term, a sum in brackets with its own sign inside."""
    sign, body = signed(term)
    if parse(body).op not in ("add", "sub"):
        return sign, body
    return "+", f"({sign.strip('+')}{body})"
