"""Laws over the states themselves, from laws over states in units of their sizes.

A search divides states by their sizes, so that constants are near one; people read
``x**2*y/(x + a)``. What the sizes do to a term is a factor, which goes into its coefficient, and
factors of the constants inside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from jaxsr.expressions import Term


@dataclass
class Natural:
    r"""Terms over states in place of z = x / size, and constants inside them.

    Every term is :math:`\sigma\,g(x)`, :math:`\sigma` a number: that of a product is a product, and
    a sum is divided by that of one side. What stays, of the other side and inside a function, is a
    constant that is estimated: :math:`e^{z^2}` is :math:`e^{a x^2}`, for sizes are of the motion
    and not of the law.

    Attributes
    ----------
    sizes : mapping of str to float
    inner : list of float
        Constants that are estimated, ``{a1}`` the first; whole numbers stay but where they are
        added to something: exponents are no estimates.
    """

    sizes: Mapping[str, float]
    inner: list[float] = field(default_factory=list)

    def of(self, term: Term, within: str = "") -> tuple[float, Term]:
        """Return the factor and the term that are together a term of the search.

        Parameters
        ----------
        term : Term
            Over z.
        within : str
            The operation that it is an argument of.
        """
        if term.is_variable:
            return 1.0 / self.sizes[term.name], term
        if term.is_constant:
            if term.value == round(term.value) and within not in ("add", "sub"):
                return 1.0, term
            self.inner.append(term.value)
            return 1.0, Term.variable(f"{{a{len(self.inner)}}}")
        parts = [self.of(arg, term.op) for arg in term.args]
        match term.op, parts:
            case "mul", [(first, a), (second, b)]:
                for own, other in ((a, second), (b, first)):
                    if self._scaled(own, other):
                        return 1.0, Term.apply("mul", a, b)
                return first * second, Term.apply("mul", a, b)
            case "div", [(first, a), (second, b)]:
                return first / second, Term.apply("div", a, b)
            case "pow", [(factor, a), (1.0, exponent)] if exponent.is_constant or _is_inner(
                exponent
            ):
                power = exponent.value if exponent.is_constant else self.inner[_place(exponent)]
                return factor**power, Term.apply("pow", a, exponent)
            case (("neg" | "abs"), [(factor, a)]):
                return factor, Term.apply(term.op, a)
            case "sign", [(_, a)]:
                return 1.0, Term.apply("sign", a)
            case "sqrt", [(factor, a)]:
                return factor**0.5, Term.apply("sqrt", a)
            case (("add" | "sub"), [(first, a), (second, b)]):
                if self._scaled(a, 1.0 / second):
                    return second, Term.apply(term.op, a, b)
                if not self._scaled(b, 1.0 / first):
                    b = self._times(second / first, b)
                return first, Term.apply(term.op, a, b)
            case _:
                pass
        return 1.0, Term.apply(term.op, *(self._times(factor, part) for factor, part in parts))

    def _times(self, factor: float, part: Term) -> Term:
        """Return a term times a constant that is estimated; alone where that is 1."""
        if factor == 1.0 or self._scaled(part, factor):
            return part
        self.inner.append(factor)
        return Term.apply("mul", Term.variable(f"{{a{len(self.inner)}}}"), part)

    def _scaled(self, part: Term, factor: float) -> bool:
        """Take a factor into a constant that is estimated, where a term is one or a product."""
        if _is_inner(part):
            self.inner[_place(part)] *= factor
            return True
        return part.op == "mul" and any(self._scaled(arg, factor) for arg in part.args)


def _is_inner(term: Term) -> bool:
    """Whether a term is a constant that is estimated."""
    return term.is_variable and term.name.startswith("{")


def _place(term: Term) -> int:
    """Return its place among those."""
    return int(term.name[2:-1]) - 1


__all__ = ["Natural"]
