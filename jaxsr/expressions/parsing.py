"""Text to terms, without ever executing text: Python's `ast` is walked, nodes are built here."""

from __future__ import annotations

import ast
import difflib
import keyword
import math
import re
from collections.abc import Collection

from jaxsr._result import InputError
from jaxsr.expressions.primitives import FUNCTIONS_BY_TEXT, INTEGRALS
from jaxsr.expressions.term import Term

MAX_CHARACTERS = 10_000
MAX_NESTING = 100
MAX_LEVELS = 250  # of operators: a flat sum nests to the left, and walks are recursive
MAX_POWER = 1e6
_BINARY = {
    ast.Add: "add",
    ast.Sub: "sub",
    ast.Mult: "mul",
    ast.Div: "div",
    ast.Pow: "pow",
}
_COMPARISON = {
    ast.Lt: "lt",
    ast.LtE: "le",
    ast.Gt: "gt",
    ast.GtE: "ge",
    ast.Eq: "eq",
    ast.NotEq: "ne",
}
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*", re.ASCII)


def is_identifier(name: str) -> bool:
    """Whether `name` may name a symbol: ASCII, no Python keyword, no function of the grammar."""
    return (
        bool(_IDENTIFIER.fullmatch(name))
        and not keyword.iskeyword(name)
        and name not in FUNCTIONS_BY_TEXT
        and name != "pi"
    )


def parse(
    text: str,
    symbols: Collection[str] | None = None,
    where: str = "",
    *,
    integrals: bool = False,
) -> Term:
    """Read an expression of the model grammar.

    Parameters
    ----------
    text : str
        The expression, e.g. ``"force - Fv*v - Fc*sign(v)"``.
    symbols : collection of str, optional
        Names that may occur; any identifier when None.
    where : str
        File and key for error messages.
    integrals : bool
        Whether ``integral(f)`` and ``integral_over(f, g)`` may occur: terms of a search may hold
        them, a model file may not.

    Returns
    -------
    Term

    Raises
    ------
    InputError
        The text is too long, nested too deeply, no expression, or uses a symbol, function or
        construct outside the grammar.
    """
    if not isinstance(text, str):
        raise InputError(f"an expression must be text, got {text!r}", where, 'Write "..."')
    if len(text) > MAX_CHARACTERS:
        raise InputError(
            f"expression of {len(text)} characters", where, f"At most {MAX_CHARACTERS} are read"
        )
    if _nesting(text) > MAX_NESTING:
        raise InputError(f"expression nested deeper than {MAX_NESTING}", where, "Split it")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = getattr(error, "msg", None) or type(error).__name__
        raise InputError(
            f"cannot read {_short(text)!r} ({reason})", where, "Use + - * / ** and functions"
        ) from None
    try:
        return _Reader(symbols, where, integrals).read(tree.body, 0)
    except OverflowError:
        raise InputError(f"a number in {_short(text)!r} is too large", where) from None


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def _nesting(text: str) -> int:
    depth = deepest = 0
    for character in text:
        depth += (character == "(") - (character == ")")
        deepest = max(deepest, depth)
    return deepest


class _Reader:
    """Walk the syntax tree and build terms."""

    def __init__(self, symbols: Collection[str] | None, where: str, integrals: bool) -> None:
        self.symbols, self.where, self.integrals = symbols, where, integrals

    def fail(self, what: str, remedy: str = "") -> InputError:
        return InputError(what, self.where, remedy)

    def read(self, node: ast.expr, depth: int) -> Term:
        if depth > MAX_LEVELS:
            raise self.fail(f"expression of more than {MAX_LEVELS} levels of operators", "Split it")
        match node:
            case ast.Constant(value=bool() as value):
                return Term.boolean(value)
            case ast.Constant(value=int() | float() as value):
                number = float(value)
                if not math.isfinite(number):
                    raise self.fail(f"number {value!r} is not finite")
                return Term.constant(number)
            case ast.Name(id=name):
                return self.symbol(name)
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as value)):
                return Term.constant(-float(value))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return Term.apply("neg", self.read(operand, depth + 1))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.read(operand, depth + 1)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                return self.binary(_BINARY[type(op)], left, right, depth)
            case ast.Compare(left=left, ops=ops, comparators=comparators):
                return self.comparison(left, ops, comparators, depth)
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
                return self.call(name, args, depth)
            case _:
                raise self.fail(
                    f"{_short(ast.unparse(node))!r} is not part of the grammar",
                    "Use numbers, symbols, + - * / **, comparisons and the listed functions",
                )

    def symbol(self, name: str) -> Term:
        if name == "pi":
            return Term.constant(math.pi)
        if self.symbols is None and is_identifier(name):
            return Term.variable(name)
        if self.symbols is not None and name in self.symbols:
            return Term.variable(name)
        known = list(self.symbols or ())
        close = difflib.get_close_matches(name, known, 1)
        hint = f"Did you mean {close[0]!r}?" if close else "Declare it in [parameters]"
        raise self.fail(f"unknown symbol {name!r}", hint)

    def binary(self, op: str, left: ast.expr, right: ast.expr, depth: int) -> Term:
        a, b = self.read(left, depth + 1), self.read(right, depth + 1)
        if op == "pow" and b.is_constant and a.is_constant:
            self.bounded_power(a.value, b.value)
        if op == "pow" and b.is_constant and abs(b.value) > MAX_POWER:
            raise self.fail(f"power {b.value:g} is too large", f"At most {MAX_POWER:g}")
        if op == "pow" and not b.is_constant and not b.variables:
            raise self.fail(f"power {ast.unparse(right)!r} is not a plain number", "Write it out")
        return Term.apply(op, a, b)

    def bounded_power(self, base: float, exponent: float) -> None:
        if base and abs(exponent) * abs(math.log(abs(base))) > 690:
            raise self.fail(f"power {base:g}**{exponent:g} overflows", "Write the number")

    def comparison(
        self, left: ast.expr, ops: list[ast.cmpop], comparators: list[ast.expr], depth: int
    ) -> Term:
        terms = [self.read(part, depth + 1) for part in (left, *comparators)]
        pairs = []
        for op, a, b in zip(ops, terms[:-1], terms[1:], strict=True):
            if type(op) not in _COMPARISON:
                raise self.fail("only <, <=, >, >=, ==, != compare")
            pairs.append(Term.apply(_COMPARISON[type(op)], a, b))
        return pairs[0] if len(pairs) == 1 else Term.apply("and", *pairs)

    def call(self, name: str, args: list[ast.expr], depth: int) -> Term:
        primitive = FUNCTIONS_BY_TEXT.get(name)
        if primitive is None and name in INTEGRALS:
            if not self.integrals:
                remedy = "Make it a state with an equation of its own"
                raise self.fail(f"{name} is not part of the grammar", remedy)
            primitive = INTEGRALS[name]
        if primitive is None:
            close = difflib.get_close_matches(name, FUNCTIONS_BY_TEXT, 1)
            hint = f"Did you mean {close[0]!r}?" if close else ""
            raise self.fail(
                f"unknown function {name!r}", hint or f"Known: {', '.join(FUNCTIONS_BY_TEXT)}"
            )
        if name == "Piecewise":
            return self.piecewise(args, depth)
        if primitive.arity not in (-1, len(args)) or not args:
            raise self.fail(f"{name} takes {primitive.arity} arguments, got {len(args)}")
        return Term.apply(primitive.name, *(self.read(arg, depth + 1) for arg in args))

    def piecewise(self, args: list[ast.expr], depth: int) -> Term:
        flat: list[Term] = []
        for arg in args:
            if not (isinstance(arg, ast.Tuple) and len(arg.elts) == 2):
                raise self.fail("Piecewise takes pairs", "Piecewise((value, condition), ...)")
            flat.extend(self.read(element, depth + 1) for element in arg.elts)
        if not flat:
            raise self.fail("Piecewise needs a branch", "Piecewise((value, condition), ...)")
        return Term.apply("piecewise", *flat)
