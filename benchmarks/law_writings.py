"""Ways of writing one law: those of a hand, and those of a generator that knows rules alone."""

from __future__ import annotations

import numpy as np

from jaxsr.expressions import Term, parse

STEPS = 6
"""Rewritings of one law."""
LONGEST = 60
"""Nodes from which a law is not rewritten any more."""


def rewritten(rng: np.random.Generator, law: Term) -> Term:
    """Return a law written otherwise: equal wherever no sign's argument is zero."""
    for _ in range(int(rng.integers(2, STEPS + 1))):
        if law.size > LONGEST:
            break
        nodes = list(law.walk())
        at = int(rng.integers(len(nodes)))
        if _in_condition(law, at):
            continue
        rules = [*_RULES.get(nodes[at].op, ()), *_ANY]
        template = rules[int(rng.integers(len(rules)))]
        law = law.replace_at(at, _applied(rng, template, nodes[at]))
    return law


def _in_condition(law: Term, at: int) -> bool:
    """Whether a node is part of a condition, or an exponent: those are left alone."""
    position, node = 0, law
    while position != at:
        position += 1
        for number, arg in enumerate(node.args):
            if position <= at < position + arg.size:
                if node.op == "pow" and number == 1:
                    return True
                if node.op in ("lt", "le", "gt", "ge") or arg.op == "boolean":
                    return True
                node = arg
                break
            position += arg.size
    return node.op in ("lt", "le", "gt", "ge", "boolean")


def _applied(rng: np.random.Generator, template: str, node: Term) -> Term:
    """Put the arguments x, y of a node, or the node z itself, and a constant k, into a rule."""
    k = Term.constant(float(f"{rng.uniform(0.3, 9.0):.2g}"))
    parts = dict(zip("xy", node.args, strict=False))
    return parse(template).substitute({**parts, "z": node, "k": k})


_ANY = ("k*(z/k)", "z*k/k", "(z + k) - k", "-(-z)", "(k*z)/k", "z/1.0")
_RULES: dict[str, tuple[str, ...]] = {
    "abs": (
        *("sqrt(x**2)", "x*sign(x)", "Max(x, -x)", "x**2/Abs(x)"),
        "Piecewise((x, x > 0), (-x, True))",
    ),
    "sign": (
        *("x/Abs(x)", "Abs(x)/x", "x/sqrt(x**2)"),
        *("2*Heaviside(x) - 1", "sign(k*x)", "-sign(-x)"),
    ),
    "max": (
        *("(x + y + Abs(x - y))/2", "x + Max(y - x, 0)", "-Min(-x, -y)", "Max(y, x)"),
        "y + (x - y)*Heaviside(x - y)",
    ),
    "min": (
        *("(x + y - Abs(x - y))/2", "x + Min(y - x, 0)", "-Max(-x, -y)", "Min(y, x)"),
        "Piecewise((x, x < y), (y, True))",
    ),
    "sin": ("cos(x - pi/2)", "-sin(-x)", "cos(pi/2 - x)", "sin(x + 2*pi)"),
    "cos": ("sin(x + pi/2)", "cos(-x)", "-cos(x - pi)"),
    "exp": ("1/exp(-x)", "exp(x/2)**2", "exp(x/2)*exp(x/2)"),
    "add": ("y + x", "-(-x - y)", "x - (-y)"),
    "sub": ("-(y - x)", "x + (-y)"),
    "mul": ("y*x", "x/(1/y)", "-(x*(-y))"),
    "div": ("x*(1/y)", "(-x)/(-y)", "1/(y/x)"),
}

__all__ = ["rewritten"]
