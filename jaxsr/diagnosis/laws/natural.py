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

    Every term is :math:`\sigma\,g(x)`, :math:`\sigma` a number: that of a product is a product, a
    sum is divided by that of one side, and functions keep theirs inside.

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
            case "pow", [(factor, a), (_, exponent)] if exponent.is_constant:
                return factor**exponent.value, Term.apply("pow", a, exponent)
            case (("neg" | "abs"), [(factor, a)]):
                return factor, Term.apply(term.op, a)
            case "sign", [(_, a)]:
                return 1.0, Term.apply("sign", a)
            case "sqrt", [(factor, a)]:
                return factor**0.5, Term.apply("sqrt", a)
            case (("add" | "sub"), [(first, a), (second, b)]):
                if self._scaled(a, 1.0 / second):
                    return second, Term.apply(term.op, a, b)
                if self._scaled(b, 1.0 / first) or first == second:
                    return first, Term.apply(term.op, a, b)
            case _:
                pass
        return 1.0, Term.apply(term.op, *(times(factor, part) for factor, part in parts))

    def _scaled(self, part: Term, factor: float) -> bool:
        """Take a factor into a constant that is estimated, where a term is one."""
        if not (part.is_variable and part.name.startswith("{")):
            return False
        self.inner[int(part.name[2:-1]) - 1] *= factor
        return True


def times(factor: float, term: Term) -> Term:
    """Return a number times a term."""
    if factor == 1.0:
        return term
    if factor < 1.0:
        return Term.apply("div", term, Term.constant(1.0 / factor))
    return Term.apply("mul", Term.constant(factor), term)


__all__ = ["Natural", "times"]
