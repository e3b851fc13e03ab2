"""One judge for every method: expand a right-hand side and compare its terms with the true ones.

Sums are expanded by SymPy. A sine or cosine of w t + phi is written as S sin(w t) + C cos(w t),
so that cos counts for a shifted sin and a negative frequency for a positive one; S and C of one
frequency are one term, a wave.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy

from jaxsr.expressions import Term, parse, to_sympy

_SAME = 1e-3  # relative distance of frequencies that count as one
_NEAR = 0.05  # relative distance of a frequency from the true one that still names its wave
_LONGEST = 400  # operations of an expression beyond which it is not expanded: clutter at any rate

Formula = sympy.Expr | Term | str


def as_sympy(expression: Formula) -> Any:
    """Return text in the model grammar, or a term, as SymPy."""
    if isinstance(expression, str):
        expression = parse(expression)
    return to_sympy(expression) if isinstance(expression, Term) else expression


@dataclass(frozen=True)
class Wave:
    """sine * sin(w t) + cosine * cos(w t), w in rad/s."""

    w: float
    sine: float
    cosine: float

    @property
    def amplitude(self) -> float:
        """Return A of A sin(w t + phi)."""
        return math.hypot(self.sine, self.cosine)

    @property
    def phase(self) -> float:
        """Return phi of A sin(w t + phi), radians."""
        return math.atan2(self.cosine, self.sine)


@dataclass(frozen=True)
class Form:
    """A sum of monomials with coefficients, and of waves."""

    monomials: Mapping[Any, float] = field(default_factory=dict)
    waves: tuple[Wave, ...] = ()

    @property
    def terms(self) -> int:
        """Return the number of terms."""
        return len(self.monomials) + len(self.waves)


@dataclass(frozen=True)
class Mark:
    """What the judge says of one equation.

    Attributes
    ----------
    exact : bool
        The true terms are there and no others, but for spurious ones below ``clutter``.
    error : float
        Largest error of a constant: relative, of a phase in radians; NaN unless exact.
    terms : int
        Number of terms after expansion, spurious ones included.
    """

    exact: bool
    error: float
    terms: int


def form(expression: Formula, time: str = "t") -> Form | None:
    """Return the expanded form, None where the expression is too long to be worth it."""
    expression = as_sympy(expression)
    if sympy.count_ops(expression) > _LONGEST:
        return None
    t = sympy.Symbol(time, real=True)
    markers: dict[Any, tuple[float, bool]] = {}

    def wave(node: Any) -> Any:
        angle = sympy.expand(node.args[0])
        w, phase = angle.coeff(t, 1), angle.coeff(t, 0)
        if not (w.is_number and phase.is_number) or sympy.expand(angle - w * t - phase) != 0:
            return node
        if w == 0:
            return node
        value, shift = float(w), float(phase)
        shift += 0.0 if node.func == sympy.sin else math.pi / 2.0
        if value < 0.0:  # sin(-a) = sin(a + pi)
            value, shift = -value, math.pi - shift
        sine = _marker(markers, value, True)
        cosine = _marker(markers, value, False)
        return math.cos(shift) * sine + math.sin(shift) * cosine

    marked = sympy.expand(expression).replace(
        lambda node: isinstance(node, sympy.sin | sympy.cos) and node.has(t), wave
    )
    back = {m: (sympy.sin if sine else sympy.cos)(w * t) for m, (w, sine) in markers.items()}
    monomials: dict[Any, float] = {}
    parts: dict[float, list[float]] = {}
    for part in sympy.Add.make_args(sympy.expand(marked)):
        coefficient, rest = part.as_coeff_Mul()
        value = float(coefficient)
        if rest in markers:
            w, is_sine = markers[rest]
            parts.setdefault(w, [0.0, 0.0])[0 if is_sine else 1] += value
        elif value:
            rest = rest.xreplace(back)
            monomials[rest] = monomials.get(rest, 0.0) + value
    waves = tuple(Wave(w, *pair) for w, pair in sorted(parts.items()) if any(pair))
    return Form(monomials, waves)


def _marker(known: dict[Any, tuple[float, bool]], w: float, is_sine: bool) -> Any:
    for symbol, (other, kind) in known.items():
        if kind == is_sine and abs(other - w) <= _SAME * other:
            return symbol
    symbol = sympy.Dummy(f"{'sin' if is_sine else 'cos'}", real=True)
    known[symbol] = (w, is_sine)
    return symbol


def judge(
    found: Formula,
    truth: Formula,
    data: Mapping[str, np.ndarray],
    clutter: float = 0.0,
    time: str = "t",
) -> Mark:
    """Compare a right-hand side with the true one.

    Parameters
    ----------
    found, truth
    data : mapping of str to ndarray, (samples,)
        Where contributions are measured.
    clutter : float
        Spurious terms whose rms is below this share of the true right-hand side's are forgiven.
    """
    right = form(truth, time)
    left = form(found, time)
    assert right is not None, "the truth is too long to expand"
    if left is None:
        return Mark(False, math.nan, -1)
    scale = _rms(truth, data)
    errors, spurious = [], []
    pending = list(right.waves)
    for wave in left.waves:
        close = [p for p in pending if abs(wave.w / p.w - 1.0) <= _NEAR]
        if close:
            pending.remove(close[0])
            errors += _wave_errors(wave, close[0])
        else:
            spurious.append(wave.amplitude / math.sqrt(2.0))
    missing = set(right.monomials) - set(left.monomials)
    for monomial, coefficient in left.monomials.items():
        if monomial in right.monomials:
            errors.append(abs(coefficient / right.monomials[monomial] - 1.0))
        else:
            spurious.append(abs(coefficient) * _rms(monomial, data))
    exact = not missing and not pending and all(s <= clutter * scale for s in spurious)
    return Mark(exact, float(max(errors, default=0.0)) if exact else math.nan, left.terms)


def _wave_errors(found: Wave, true: Wave) -> list[float]:
    turn = (found.phase - true.phase + math.pi) % (2.0 * math.pi) - math.pi
    return [abs(found.w / true.w - 1.0), abs(found.amplitude / true.amplitude - 1.0), abs(turn)]


def values(expression: Formula, data: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return an expression on data (samples,); NaN where it is not finite."""
    written = as_sympy(expression)
    names = sorted(str(s) for s in written.free_symbols)
    function = sympy.lambdify([sympy.Symbol(n, real=True) for n in names], written, "numpy")
    with np.errstate(all="ignore"):
        out = np.asarray(function(*(data[n] for n in names)), dtype=float)
    out = np.broadcast_to(out, np.shape(next(iter(data.values()))))
    return np.where(np.isfinite(out), out, np.nan)


def relative_error(expression: Formula, data: Mapping[str, np.ndarray], y: np.ndarray) -> float:
    """Return rms(prediction - y) / rms(y), infinite where the prediction is not finite."""
    error = float(np.sqrt(np.mean((values(expression, data) - y) ** 2) / np.mean(y**2)))
    return error if math.isfinite(error) else math.inf


def _rms(expression: Formula, data: Mapping[str, np.ndarray]) -> float:
    return float(np.sqrt(np.nanmean(values(expression, data) ** 2)))


def is_rational(expression: Formula) -> bool:
    """Tell whether something that varies stands in a denominator."""
    written = as_sympy(expression)
    return any(p.exp.is_negative and p.base.free_symbols for p in written.atoms(sympy.Pow))
