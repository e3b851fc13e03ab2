"""SymPy's printers, with what models need beside: shortest numbers, steps, open arrays."""

from __future__ import annotations

from typing import Any, ClassVar

import sympy
from sympy.printing.c import C99CodePrinter
from sympy.printing.codeprinter import CodePrinter
from sympy.printing.numpy import JaxPrinter, NumPyPrinter
from sympy.printing.octave import OctaveCodePrinter
from sympy.printing.precedence import PRECEDENCE
from sympy.printing.str import StrPrinter


class _Numbers:
    """Print floats with the fewest digits that read back to the same one."""

    def _print_Float(self, expr: Any) -> str:
        return repr(float(expr))


class C(_Numbers, C99CodePrinter):
    """C99 with ``math.h``."""


class Matlab(_Numbers, OctaveCodePrinter):
    """MATLAB and Octave; branches are statements."""

    def __init__(self) -> None:
        super().__init__({"inline": False})

    def _print_Heaviside(self, expr: Any) -> str:
        inner = self._print(expr.args[0])
        return f"(0.5*(1 + sign({inner})))"


class _Reduced:
    """Combine conditions of different shapes, which NumPy's own reductions refuse."""

    _module: str

    def _reduced(self, name: str, expr: Any) -> str:
        printed = [self._print(arg) for arg in expr.args]  # type: ignore[attr-defined]
        joined = printed[0]
        for other in printed[1:]:
            joined = f"{self._module}.{name}({joined}, {other})"
        return joined

    def _print_And(self, expr: Any) -> str:
        return self._reduced("logical_and", expr)

    def _print_Or(self, expr: Any) -> str:
        return self._reduced("logical_or", expr)

    def _print_Max(self, expr: Any) -> str:
        return self._reduced("maximum", expr)

    def _print_Min(self, expr: Any) -> str:
        return self._reduced("minimum", expr)

    def _print_Heaviside(self, expr: Any) -> str:
        return f"{self._module}.heaviside({self._print(expr.args[0])}, 0.5)"  # type: ignore[attr-defined]


class Numpy(_Numbers, _Reduced, NumPyPrinter):
    """NumPy, imported as ``numpy``."""

    _module = "numpy"


class Jax(_Numbers, _Reduced, JaxPrinter):
    """JAX, imported as ``jax.numpy``."""

    _module = "jax.numpy"


class Plain(_Numbers, StrPrinter):
    """SymPy's own notation."""


class Modelica(_Numbers, CodePrinter):
    """Modelica 3.6: section 3.4 (operators), 3.6.5 (if), 3.7.1 (functions)."""

    printmethod = "_modelica"
    language = "Modelica"
    _operators: ClassVar = {"and": "and", "or": "or", "not": "not "}

    def _print_Function(self, expr: Any) -> str:
        arguments = ", ".join(self._print(arg) for arg in expr.args)
        return f"{expr.func.__name__.lower()}({arguments})"  # Abs is abs there

    def _print_Heaviside(self, expr: Any) -> str:
        return f"(0.5*(1 + sign({self._print(expr.args[0])})))"

    def _print_Max(self, expr: Any) -> str:
        return self._nested("max", expr.args)

    def _print_Min(self, expr: Any) -> str:
        return self._nested("min", expr.args)

    def _nested(self, name: str, args: Any) -> str:
        first, *rest = args
        return (
            f"{name}({self._print(first)}, {self._nested(name, rest)})"
            if rest
            else self._print(first)
        )

    def _print_Pow(self, expr: Any) -> str:
        base, exponent = expr.args
        if exponent == sympy.Rational(1, 2):
            return f"sqrt({self._print(base)})"
        rank = PRECEDENCE["Pow"]
        if exponent == -1:
            return f"1/{self.parenthesize(base, rank, strict=True)}"
        rank = PRECEDENCE["Atom"]
        left, right = (self.parenthesize(e, rank, strict=True) for e in (base, exponent))
        return f"{left}^{right}"

    def _print_Rational(self, expr: Any) -> str:
        return f"{expr.p}/{expr.q}"

    def _print_Piecewise(self, expr: Any) -> str:
        *branches, last = expr.args
        tests = "".join(f"if {self._print(w)} then {self._print(v)} else " for v, w in branches)
        return f"({tests}{self._print(last.args[0])})"

    def _print_Relational(self, expr: Any) -> str:
        sign = {"==": "==", "!=": "<>"}.get(expr.rel_op, expr.rel_op)
        return f"{self._print(expr.lhs)} {sign} {self._print(expr.rhs)}"

    def _print_NaN(self, expr: Any) -> str:
        return "(0.0/0.0)"

    def _print_BooleanTrue(self, expr: Any) -> str:
        return "true"

    def _print_BooleanFalse(self, expr: Any) -> str:
        return "false"

    def _format_code(self, lines: list[str]) -> list[str]:
        return lines
