"""Text to terms, without ever executing text: tokens, then precedence climbing."""

from __future__ import annotations

import functools
import keyword
import math
import re
from collections.abc import Collection

from jaxsr._quoting import closest, hint, quoted
from jaxsr._result import InputError
from jaxsr.expressions.primitives import FUNCTIONS_BY_TEXT, INTEGRALS
from jaxsr.expressions.printing import to_text
from jaxsr.expressions.term import Term

LONGEST = 10_000
"""Characters of an expression that is read from a file or a user."""
MAX_CHARACTERS = 100_000
"""Characters of one that the package itself puts together, such as all mechanisms at once."""
MAX_NESTING = 100
MAX_LEVELS = 250  # of operators: a flat sum nests to the left, and walks are recursive
MAX_POWER = 1e6
_REMEMBERED = 4096  # names and numbers whose terms are kept; one population repeats them
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_NUMBER = r"(?:[0-9][0-9_]*(?:\.[0-9_]*)?|\.[0-9][0-9_]*)(?:[eE][+-]?[0-9]+)?"
# Any other character is a token of its own, so that nothing is passed over but white space.
_TOKENS = re.compile(rf"[^\W\d]\w*|{_NUMBER}|\*\*|//|:=|[<>=!]=|\S")
_END = ""
_OPERATORS = {"+": "add", "-": "sub", "*": "mul", "/": "div", "**": "pow"}
_COMPARISONS = {"<": "lt", "<=": "le", ">": "gt", ">=": "ge", "==": "eq", "!=": "ne"}
_COMPARE, _SUM, _PRODUCT, _SIGN, _POWER = 1, 2, 3, 4, 5
_BINDING = {
    **dict.fromkeys(_COMPARISONS, _COMPARE),
    **{"+": _SUM, "-": _SUM, "*": _PRODUCT, "/": _PRODUCT, "**": _POWER},
}
_WORDS = {
    "pi": Term.constant(math.pi),
    "True": Term.boolean(True),
    "False": Term.boolean(False),
}
_INSTEAD = {
    "#": "A comment stands outside the expression",
    "^": "Write ** for a power",
    "=": "Write == to compare",
    "and": "Write And(a, b)",
    "&": "Write And(a, b)",
    "or": "Write Or(a, b)",
    "|": "Write Or(a, b)",
    "not": "Write Not(a)",
    "~": "Write Not(a)",
    "if": "Write Piecewise((a, condition), (b, True))",
}
_GRAMMAR = "The grammar has numbers, symbols, + - * / **, comparisons and the listed functions"


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
    longest: int = LONGEST,
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
    longest : int
        Characters that are read.

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
        raise InputError(f"an expression must be text, got {quoted(text)}", where, 'Write "..."')
    if len(text) > longest:
        what = f"expression of {len(text)} characters"
        raise InputError(what, where, f"At most {longest} are read")
    if text.count("(") > MAX_NESTING and _nesting(text) > MAX_NESTING:
        raise InputError(f"expression nested deeper than {MAX_NESTING}", where, "Split it")
    return _Reader(text, symbols, where, integrals).whole()


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def _near(text: str, at: int) -> str:
    """Return the text around a character, all of it where it is short."""
    if len(text) <= 60:
        return text
    start, stop = max(at - 27, 0), at + 27
    return ("..." if start else "") + text[start:stop] + ("..." if stop < len(text) else "")


def _nesting(text: str) -> int:
    depth = deepest = 0
    for character in text:
        depth += (character == "(") - (character == ")")
        deepest = max(deepest, depth)
    return deepest


def levels(term: Term, met: dict[Term, int] | None = None) -> int:
    """Return the levels of a term below its root, without recursion.

    Parameters
    ----------
    term : Term
    met : dict, optional
        Levels of subtrees met before; filled on the way.
    """
    met = {} if met is None else met
    for node in term.upward(met):
        met[node] = 1 + max(met.get(arg, 0) for arg in node.args)
    return met.get(term, 0)


@functools.lru_cache(maxsize=_REMEMBERED)
def _leaf(token: str) -> Term | None:
    """Return the term of a number or a name; None for a bracket, an operator or a keyword."""
    if token in _WORDS:
        return _WORDS[token]
    if token.isidentifier():
        return None if keyword.iskeyword(token) else Term.variable(token)
    try:
        return Term.constant(float(token))
    except ValueError:
        return None


class _Reader:
    """Take tokens from the front and build terms.

    ``level`` counts the operators and brackets around a place: Python's own stack is not
    unlimited.
    """

    __slots__ = ("integrals", "symbols", "text", "tokens", "where")

    def __init__(
        self, text: str, symbols: Collection[str] | None, where: str, integrals: bool
    ) -> None:
        self.text, self.symbols, self.where, self.integrals = text, symbols, where, integrals
        self.tokens = _TOKENS.findall(text)
        self.tokens.append(_END)
        self.tokens.reverse()  # the front is the cheap end of a list to take from

    def whole(self) -> Term:
        term = self.expression(0, 0)
        if self.tokens[-1] != _END:
            raise self.unexpected("an operator")
        if term.size > MAX_LEVELS and levels(term) > MAX_LEVELS:
            raise self.too_deep()
        return term

    def expression(self, least: int, level: int) -> Term:
        """Read operands and the operators that bind tighter than `least`."""
        if level > MAX_LEVELS:
            raise self.too_deep()
        tokens = self.tokens
        left = self.operand(level)
        while (binding := _BINDING.get(tokens[-1], 0)) > least:
            if binding == _COMPARE:
                left = self.comparison(left, level + 1)
            elif binding == _POWER:
                tokens.pop()
                # to the right, and a sign may stand in the exponent
                left = self.power(left, self.expression(_SIGN, level + 1))
            else:
                op = _OPERATORS[tokens.pop()]
                left = Term(op, (left, self.expression(binding, level + 1)))
        return left

    def operand(self, level: int) -> Term:
        """Read a number, a name, a call, a bracket, or any of them with a sign."""
        tokens = self.tokens
        leaf = _leaf(tokens[-1])
        if leaf is None:
            return self.bracket_or_sign(level)
        token = tokens.pop()
        if leaf.op == "variable":
            if tokens[-1] == "(":
                return self.call(token, level)
            if token not in self.symbols if self.symbols is not None else not is_identifier(token):
                raise self.unknown_symbol(token)
        elif leaf.op == "constant" and not math.isfinite(leaf.value):
            raise self.fail(f"number {_short(token)} is not finite")
        return leaf

    def bracket_or_sign(self, level: int) -> Term:
        token = self.tokens[-1]
        if token == "(":
            self.tokens.pop()
            inner = self.expression(0, level + 1)
            self.take(")")
            return inner
        if token not in ("-", "+"):
            raise self.unexpected("a number, a symbol or a function")
        self.tokens.pop()
        inner = self.expression(_SIGN, level + 1)
        if token == "+":
            return inner
        plain = inner.is_constant and math.copysign(1.0, inner.value) > 0.0
        return Term.constant(-inner.value) if plain else Term("neg", (inner,))

    def power(self, base: Term, exponent: Term) -> Term:
        if exponent.is_constant:
            if base.is_constant:
                self.bounded_power(base.value, exponent.value)
            if abs(exponent.value) > MAX_POWER:
                what = f"power {exponent.value:g} is too large"
                raise self.fail(what, f"At most {MAX_POWER:g}")
        elif not exponent.variables:
            what = f"power {_short(to_text(exponent))!r} is not a plain number"
            raise self.fail(what, "Write it out")
        return Term("pow", (base, exponent))

    def bounded_power(self, base: float, exponent: float) -> None:
        if base and abs(exponent) * abs(math.log(abs(base))) > 690:
            raise self.fail(f"power {base:g}**{exponent:g} overflows", "Write the number")

    def comparison(self, left: Term, level: int) -> Term:
        """Read ``a < b`` or a chain: ``a < b < c`` is ``And(a < b, b < c)``."""
        pairs = []
        while self.tokens[-1] in _COMPARISONS:
            op = _COMPARISONS[self.tokens.pop()]
            right = self.expression(_COMPARE, level)
            pairs.append(Term(op, (left, right)))
            left = right
        return pairs[0] if len(pairs) == 1 else Term("and", tuple(pairs))

    def call(self, name: str, level: int) -> Term:
        primitive = FUNCTIONS_BY_TEXT.get(name)
        if primitive is None and name in INTEGRALS:
            if not self.integrals:
                remedy = "Make it a state with an equation of its own"
                raise self.fail(f"{name} is not part of the grammar", remedy)
            primitive = INTEGRALS[name]
        if primitive is None:
            raise self.unknown_function(name)
        if name == "Piecewise":
            return self.piecewise(level + 1)
        args = self.arguments(level + 1)
        if not args or primitive.arity not in (-1, len(args)):
            count = "some" if primitive.arity == -1 else primitive.arity
            raise self.fail(f"{name} takes {count} arguments, got {len(args)}")
        return Term(primitive.name, tuple(args))

    def arguments(self, level: int) -> list[Term]:
        self.take("(")
        args: list[Term] = []
        while self.tokens[-1] != ")":
            args.append(self.expression(0, level))
            if self.tokens[-1] != ",":
                break
            self.tokens.pop()
        self.take(")")
        return args

    def piecewise(self, level: int) -> Term:
        remedy = "Piecewise((value, condition), ...)"
        flat: list[Term] = []
        self.take("(")
        while self.tokens[-1] != ")":
            pair = self.arguments(level) if self.tokens[-1] == "(" else []
            if len(pair) != 2 or self.tokens[-1] not in (",", ")"):
                raise self.fail("Piecewise takes pairs", remedy)
            flat += pair
            if self.tokens[-1] == ",":
                self.tokens.pop()
        self.take(")")
        if not flat:
            raise self.fail("Piecewise needs a branch", remedy)
        return Term("piecewise", tuple(flat))

    def take(self, token: str) -> None:
        if self.tokens[-1] != token:
            raise self.unexpected(repr(token))
        self.tokens.pop()

    def fail(self, what: str, remedy: str = "") -> InputError:
        return InputError(what, self.where, remedy)

    def too_deep(self) -> InputError:
        what = f"expression of more than {MAX_LEVELS} levels of operators and brackets"
        return self.fail(what, "Split it")

    def unexpected(self, wanted: str) -> InputError:
        """Return the error for a token at the front that the grammar has no place for."""
        token = self.tokens[-1]
        starts = [match.start() for match in _TOKENS.finditer(self.text)]
        place = len(starts) - len(self.tokens) + 1
        if token == _END:
            found = "ends" if starts else "is empty"
            what = f"cannot read {_short(self.text)!r} ({found} where {wanted} is expected)"
            return self.fail(what, "Use + - * / ** and functions")
        at = starts[place]
        what = (
            f"cannot read {_near(self.text, at)!r} (character {at + 1}: "
            f"{wanted} expected, got {_short(token)!r})"
        )
        return self.fail(what, _INSTEAD.get(token, _GRAMMAR))

    def unknown_symbol(self, name: str) -> InputError:
        near = closest(name, self.symbols or ())
        remedy = f"Did you mean {near!r}?" if near else "Declare it in [parameters]"
        return self.fail(f"unknown symbol {_short(name)!r}", remedy)

    def unknown_function(self, name: str) -> InputError:
        if name == "d":
            remedy = "Write d(STATE) in [readings], with the name of a state"
            return self.fail("d(...), the rate of a state, cannot be read here", remedy)
        return self.fail(f"unknown function {_short(name)!r}", hint(name, FUNCTIONS_BY_TEXT))
