"""Expressions of the model grammar as MathML, which browsers draw without scripts or fonts."""

from __future__ import annotations

import math
from html import escape

from markupsafe import Markup

from jaxsr._result import InputError
from jaxsr.expressions import Term, parse
from jaxsr.expressions.term import BOOLEAN
from jaxsr.report.formatting import number

_GREEK: dict[str, str] = dict(
    zip(
        "alpha beta gamma delta epsilon zeta eta theta kappa lambda mu nu xi rho sigma tau phi chi "
        "psi omega Gamma Delta Theta Lambda Sigma Phi Psi Omega pi".split(),
        "αβγδεζηθκλμνξρστφχψωΓΔΘΛΣΦΨΩπ",
        strict=True,
    )
)
_COMPARE = {"lt": "<", "le": "≤", "gt": ">", "ge": "≥", "eq": "=", "ne": "≠"}
_LEFT = '<mtd style="text-align:left">'
_TALL = frozenset({"div", "pow", "exp", "piecewise"})  # too small to read in an exponent
_LOGIC = {"and": "and", "or": "or"}
_RANK = {"add": 1, "sub": 1, "neg": 2, "mul": 3, "div": 5, "pow": 4}
_ATOM = 6
_OPEN = '<math displaystyle="true">'
_LONGEST = 1500  # characters; a longer expression is easier to read as code


def expression(text: object, digits: int = 4) -> Markup:
    """Return an expression as MathML, or as code where it cannot be read or is very long.

    Parameters
    ----------
    text : str or None
        In the model grammar.
    digits : int
        Significant digits of its constants.
    """
    if not isinstance(text, str) or not text.strip():
        return Markup("")
    if len(text) <= _LONGEST:
        try:
            return Markup(f"{_OPEN}{_math(parse(text), digits)}</math>")
        except InputError:
            pass
    return Markup("<code>{}</code>").format(text)


def equation(state: str, text: object, digits: int = 4) -> Markup:
    """Return ``d(state)/dt = text`` as MathML, the rate as a fraction."""
    right = expression(text, digits)
    rate = f"<mrow><mi>d</mi>{name_markup(state)}</mrow><mrow><mi>d</mi><mi>t</mi></mrow>"
    left = f"{_OPEN}<mfrac>{rate}</mfrac><mo>=</mo>"
    if right.startswith(_OPEN):
        return Markup(left) + right[len(_OPEN) :]
    return Markup(f"{left}</math> ") + right


def name_markup(name: str) -> str:
    """Return a name with its index below: z1, Fc and d_q get subscripts, greek names letters."""
    head, _, tail = name.partition("_")
    if not tail:
        stem = head.rstrip("0123456789")
        head, tail = (stem, head[len(stem) :]) if stem else (head, "")
    base = f"<mi>{escape(_GREEK.get(head, head))}</mi>"
    return f"<msub>{base}<mi>{escape(tail)}</mi></msub>" if head and tail else base


def _math(term: Term, digits: int) -> str:
    return f"<mrow>{_node(term, digits)[0]}</mrow>"


def _node(term: Term, digits: int) -> tuple[str, int]:
    """Return the markup and its rank: what binds less tightly than its place gets brackets."""
    if term.is_constant:
        if term.value == math.pi:
            return "<mi>π</mi>", _ATOM
        rank = _RANK["neg"] if term.value < 0 else _ATOM
        return f"<mn>{number(term.value, digits)}</mn>", rank
    if term.is_variable:
        return name_markup(term.name), _ATOM
    if term.op in ("add", "sub"):
        return _sum(term, digits), _RANK["add"]
    if term.op == "mul":
        positive = _negated(term)
        if positive is not None:
            return _node(Term.apply("neg", positive), digits)
        left, right = (_within(arg, digits, 3) for arg in term.args)
        dot = "<mo>·</mo>" if term.args[1].is_constant else '<mspace width="0.17em"/>'
        return f"{left}{dot}{right}", _RANK["mul"]
    if term.op == "div":
        positive = _negated(term)
        if positive is not None:
            return _node(Term.apply("neg", positive), digits)
        top, bottom = (_math(arg, digits) for arg in term.args)
        return f"<mfrac>{top}{bottom}</mfrac>", _RANK["div"]
    if term.op == "pow":
        base = _base(term.args[0], digits)
        return f"<msup><mrow>{base}</mrow>{_math(term.args[1], digits)}</msup>", _RANK["pow"]
    if term.op == "neg":
        return f'<mo form="prefix">−</mo>{_within(term.args[0], digits, 3)}', _RANK["neg"]
    if term.op in _COMPARE:
        left, right = (_within(arg, digits, 1) for arg in term.args)
        return f"{left}<mo>{escape(_COMPARE[term.op])}</mo>{right}", 0
    return _call(term, digits), _ATOM


def _base(term: Term, digits: int) -> str:
    """Return the base of a power; a quotient on one line, as brackets may not grow."""
    if term.op != "div":
        return _within(term, digits, _ATOM)
    left, right = _within(term.args[0], digits, 3), _within(term.args[1], digits, 4)
    return _brackets(f"{left}<mo>/</mo>{right}")


def _negated(term: Term) -> Term | None:
    """Return a where `term` is -a, also as a product or quotient: (-a)*b reads as -(a b)."""
    if term.op == "neg":
        return term.args[0]
    if term.op in ("mul", "div"):
        positive = _negated(term.args[0])
        return None if positive is None else Term.apply(term.op, positive, term.args[1])
    return Term.constant(-term.value) if term.is_constant and term.value < 0 else None


def _sum(term: Term, digits: int) -> str:
    left = _within(term.args[0], digits, 1)
    right, sign = term.args[1], "+" if term.op == "add" else "−"
    positive = _negated(right)
    if positive is not None:
        right, sign = positive, "−" if sign == "+" else "+"
    return f"{left}<mo>{sign}</mo>{_within(right, digits, 3)}"


def _within(term: Term, digits: int, least: int) -> str:
    markup, rank = _node(term, digits)
    return markup if rank >= least else _brackets(markup)


def _brackets(markup: str, left: str = "(", right: str = ")") -> str:
    return f"<mrow><mo>{left}</mo>{markup}<mo>{right}</mo></mrow>"


def _condition(when: Term, digits: int) -> str:
    if when.op == BOOLEAN and when.value:
        return "<mtext>otherwise</mtext>"
    return f"<mtext>if&#160;</mtext>{_math(when, digits)}"


def _call(term: Term, digits: int) -> str:
    args = [_math(arg, digits) for arg in term.args]
    if term.op == "piecewise":
        rows = "".join(
            f"<mtr>{_LEFT}{value}</mtd>{_LEFT}{_condition(when, digits)}</mtd></mtr>"
            for value, when in zip(args[::2], term.args[1::2], strict=True)
        )
        return f"<mrow><mo>{{</mo><mtable>{rows}</mtable></mrow>"
    if term.op == BOOLEAN:
        return f"<mtext>{'always' if term.value else 'never'}</mtext>"
    if term.op == "abs":
        return _brackets(args[0], "|", "|")
    if term.op == "sqrt":
        return f"<msqrt>{args[0]}</msqrt>"
    if term.op == "exp" and not term.args[0].uses(_TALL):
        return f"<msup><mi>e</mi>{args[0]}</msup>"
    if term.op in _LOGIC:
        return _brackets(f"<mtext>&#160;{_LOGIC[term.op]}&#160;</mtext>".join(args))
    return f"<mi>{escape(term.op)}</mi>{_brackets('<mo>,</mo>'.join(args))}"
