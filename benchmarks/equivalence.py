"""Tell whether a found right-hand side is the true one, up to algebra.

Both are written as a fraction P/Q of sums of monomials in generators (variables, and functions of
them such as exp(1.04 x)). They are equivalent if P and Q hold the same monomials with coefficients
within a tolerance, monomials that contribute nothing on the data left out.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import sympy

Monomials = dict[sympy.Expr, float]
_NEGLIGIBLE = 1e-3  # rms of a monomial over that of the largest, below which it is absent


def equivalent(
    found: sympy.Expr,
    truth: sympy.Expr,
    data: Mapping[str, np.ndarray],
    tolerance: float = 0.02,
) -> bool:
    """Return whether ``found`` has the terms of ``truth`` and no others.

    Parameters
    ----------
    found, truth : sympy expression in the names of ``data``
    data : mapping of str to ndarray, (samples,)
        Where contributions are measured.
    tolerance : float
        Relative, for outer and inner constants.
    """
    right = _fraction(truth)
    left = _fraction(_renamed(found, truth, tolerance))
    parts = []
    for ours, theirs in zip(left, right, strict=True):
        parts.append((_present(ours, data), _present(theirs, data)))
    if any(set(a) != set(b) for a, b in parts):
        return False
    lead = max(parts[1][1], key=lambda m: _rms(m, data) * abs(parts[1][1][m]))
    scale = parts[1][0][lead] / parts[1][1][lead]
    return all(
        abs(ours[m] / scale - theirs[m]) <= tolerance * abs(theirs[m])
        for ours, theirs in parts
        for m in theirs
    )


def _plain(expression: sympy.Expr) -> sympy.Expr:
    """Expand products, angle sums and exponents; Abs and sign of a variable are generators."""
    out = expression.replace(sympy.cot, lambda x: sympy.cos(x) / sympy.sin(x))
    out = sympy.expand(out.replace(sympy.tan, lambda x: sympy.sin(x) / sympy.cos(x)), trig=False)
    out = sympy.expand_trig(out.replace(sympy.tanh, lambda u: 1 - 2 / (1 + sympy.exp(2 * u))))
    out = _as_generators(out)
    # twelve digits, so that equal numbers are equal whatever they were computed from
    out = out.xreplace({n: sympy.Float(f"{float(n):.12g}") for n in out.atoms(sympy.Float)})
    out = sympy.expand(out, power_base=True, log=True, force=True)
    # one of cos^2 and sin^2 goes, so that equal functions of an angle look equal
    for wave in out.atoms(sympy.cos):
        out = sympy.expand(_without_squares(out, wave))
    return out


def _as_generators(expression: sympy.Expr) -> sympy.Expr:
    """Write exp(a - b x) as exp(a) / G(b x): one generator for a rate, its inverse below."""
    generator = sympy.Function("G")

    def product(power: sympy.Expr) -> sympy.Expr:
        out = sympy.Integer(1)
        for part in sympy.Add.make_args(sympy.expand(power.args[0])):
            coefficient, rest = part.as_coeff_Mul()
            if rest == 1:
                out *= sympy.exp(coefficient)
            else:
                argument = generator(sympy.Abs(coefficient) * rest)
                out *= argument if coefficient > 0 else 1 / argument
        return out

    return expression.replace(lambda e: isinstance(e, sympy.exp), product)


def _without_squares(expression: sympy.Expr, wave: sympy.Expr) -> sympy.Expr:
    def lowered(power: sympy.Expr) -> sympy.Expr:
        exponent = int(power.exp)
        return wave ** (exponent % 2) * (1 - sympy.sin(wave.args[0]) ** 2) ** (exponent // 2)

    return expression.replace(
        lambda e: e.is_Pow and e.base == wave and e.exp.is_Integer and e.exp > 1, lowered
    )


def _fraction(expression: sympy.Expr) -> tuple[Monomials, Monomials]:
    top, bottom = sympy.fraction(sympy.together(_plain(expression)))
    return _monomials(_plain(top)), _monomials(_plain(bottom))


def _monomials(expression: sympy.Expr) -> Monomials:
    out: Monomials = {}
    for part in sympy.Add.make_args(sympy.expand(expression)):
        coefficient, rest = part.as_coeff_Mul()
        out[rest] = out.get(rest, 0.0) + float(coefficient)
    return out


def _rms(monomial: sympy.Expr, data: Mapping[str, np.ndarray]) -> float:
    names = sorted(str(s) for s in monomial.free_symbols)
    function = sympy.lambdify(names, monomial, [{"G": np.exp}, "numpy"])
    with np.errstate(all="ignore"):
        values = np.asarray(function(*(data[n] for n in names)), dtype=complex)
    return float(np.sqrt(np.nanmean(np.abs(values) ** 2)))


def _present(monomials: Monomials, data: Mapping[str, np.ndarray]) -> Monomials:
    sizes = {m: abs(c) * _rms(m, data) for m, c in monomials.items()}
    largest = max(sizes.values(), default=0.0)
    return {m: monomials[m] for m, size in sizes.items() if size > _NEGLIGIBLE * largest}


def _renamed(found: sympy.Expr, truth: sympy.Expr, tolerance: float) -> sympy.Expr:
    """Give inner constants the true values that they lie next to."""
    known = [1.0, 2.0, 3.0]
    known += [float(n) for n in _plain(truth).atoms(sympy.Number) | truth.atoms(sympy.Number)]

    def nearest(number: sympy.Expr) -> sympy.Expr:
        value = float(number)
        near = [n for n in known if n and abs(value - n) <= tolerance * abs(n)]
        if near:
            other = min(near, key=lambda n: abs(value - n) / abs(n))
            whole = float(other).is_integer()
            return sympy.Integer(int(other)) if whole else sympy.Float(f"{other:.12g}")
        return number

    def inside(node: sympy.Expr) -> sympy.Expr:
        numbers = {n: nearest(n) for n in node.atoms(sympy.Float)}
        return node.xreplace(numbers)

    plain = _as_generators(sympy.expand(found))
    functions = [f for f in plain.atoms(sympy.Function) if f.atoms(sympy.Float)]
    powers = [p for p in plain.atoms(sympy.Pow) if p.exp.is_Float]
    return plain.xreplace({f: inside(f) for f in [*functions, *powers]})
