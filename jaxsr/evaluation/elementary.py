"""Elementary functions for the register machine: polynomials that a compiler can vectorise.

The compiler's own float32 sine runs at a tenth of the speed of its exponential, its inverse
functions slower still. Those here reduce the argument and evaluate minimax polynomials; what is
fast already (exp, log, sqrt) stays the compiler's. Their errors, stated in ``ERRORS`` and tested
over the whole range of the type, are those of the functions themselves: an argument's own
rounding is not counted.

References
----------
The polynomials minimise the largest weighted error of (sin r - r)/r^3, (cos r - 1 + r^2/2)/r^4,
(asin r - r)/r^3, (atan r - r)/r^3 and (sinh r - r)/r^3 as functions of r^2 (Remez exchange);
reduction of large arguments: Payne and Hanek (1983), Radian reduction for trigonometric functions.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
from jax import lax

from jaxsr.expressions.postfix import arity_of
from jaxsr.expressions.primitives import PRIMITIVES

Function = Callable[..., Any]

_SIN = {
    np.float32: (-0.166666549402459597, 0.00833217791846226191, -0.000195172670655433474),
    np.float64: (
        -0.16666666666666632,
        0.00833333333332241926,
        -0.000198412698298124965,
        2.75573136936073542e-6,
        -2.50507583891175943e-8,
        1.58968120428332078e-10,
    ),
}
_COS = {
    np.float32: (0.0416666468607951631, -0.00138873672239681836, 0.0000244384166280810734),
    np.float64: (
        0.0416666666666665995,
        -0.00138888888888741324,
        0.0000248015872894876217,
        -2.75573143539449563e-7,
        2.08757234981462853e-9,
        -1.13596597488692078e-11,
    ),
}
_ATAN = (
    -0.333333018677292893,
    0.19998638649094499,
    -0.142652456373121502,
    0.109575773306983822,
    -0.0841946207144152436,
    0.0582345970489057641,
    -0.0314557460394611367,
    0.0110644640982224248,
    -0.00182721804484448629,
)
_ASIN = (
    0.166667539244092632,
    0.0749524188504484144,
    0.0454770864972836278,
    0.0241476551775560093,
    0.0422184833948248286,
)
_SINH = (
    0.166666664887229376,
    0.00833335059781321595,
    0.000198360662864515229,
    2.81743945474328824e-6,
)

# pi/2 in parts whose products with a whole number below 2^20 are exact in float64.
_HALF_PI = (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_ROUNDER = 1.5 * 2.0**52  # adding it rounds a float64 to a whole number, in its low bits
_NEAR = 1e6  # arguments up to here are reduced by these parts


def horner(z: Any, coefficients: tuple[float, ...]) -> Any:
    """Return the polynomial with the lowest coefficient first."""
    value = jnp.full_like(z, coefficients[-1])
    for c in coefficients[-2::-1]:
        value = value * z + z.dtype.type(c)
    return value


def _kind(x: Any) -> Any:
    return np.float32 if x.dtype == np.float32 else np.float64


def _near(x: Any) -> tuple[Any, Any]:
    """Return the quadrant's number and what is left of x, for moderate arguments."""
    wide = x.astype(jnp.float64)
    shifted = wide * (2.0 / np.pi) + _ROUNDER
    quadrant = lax.bitcast_convert_type(shifted, jnp.int64).astype(jnp.int32)
    n = quadrant.astype(jnp.float64)  # shifted - _ROUNDER, which a compiler would cancel
    left = (wide - n * _HALF_PI[0]) - n * _HALF_PI[1]
    left = jnp.where(jnp.isfinite(x), left, jnp.nan)  # rounding has lost an infinity
    if x.dtype == np.float32:
        return quadrant, left.astype(jnp.float32)
    return quadrant, left - n * _HALF_PI[2]


@functools.cache
def _turns() -> np.ndarray:
    """Return 2/pi times 2^(e - 150) modulo 4 for each exponent e of float32, in two parts."""
    parts = []
    with mpmath.workprec(400):
        for exponent in range(256):
            value = 2 / mpmath.pi * mpmath.mpf(2) ** (max(exponent, 1) - 150)
            value -= 4 * mpmath.floor(value / 4)
            high = int(value * 2**26) / 2.0**26  # times 24 bits of a mantissa: exact
            parts.append((high, float(value - high)))
    return np.array(parts)


def _far(x: Any) -> tuple[Any, Any]:
    """Return the same for any float32, by the bits of 2/pi that matter for its exponent."""
    bits = lax.bitcast_convert_type(x, jnp.int32)
    exponent = (bits >> 23) & 255
    mantissa = (bits & 0x7FFFFF) | jnp.where(exponent > 0, 0x800000, 0)
    high, low = (jnp.asarray(part)[exponent] for part in _turns().T)
    whole = mantissa.astype(jnp.float64) * high
    turn = whole - 4.0 * jnp.floor(whole * 0.25) + mantissa.astype(jnp.float64) * low
    n = jnp.round(turn)
    left = (turn - n) * (np.pi / 2.0)
    negative = bits < 0
    quadrant = n.astype(jnp.int32)
    quadrant = jnp.where(negative, -quadrant, quadrant)
    left = jnp.where(negative, -left, left).astype(jnp.float32)
    return quadrant, jnp.where(jnp.isfinite(x), left, jnp.nan)


def _waves(r: Any) -> tuple[Any, Any]:
    z = r * r
    kind = _kind(r)
    sine = r + r * z * horner(z, _SIN[kind])
    cosine = 1.0 - 0.5 * z + z * z * horner(z, _COS[kind])
    return sine, cosine


def _reduced(x: Any, of: Function, plain: Function) -> Any:
    """Apply ``of`` to quadrant and rest; where a sample is large, by the slow way for all."""
    large = jnp.any((jnp.abs(x) > _NEAR) & jnp.isfinite(x))
    if x.dtype == np.float32:
        return lax.cond(large, lambda x: of(*_far(x)), lambda x: of(*_near(x)), x)
    return lax.cond(large, plain, lambda x: of(*_near(x)), x)


def _quarter(quadrant: Any, r: Any) -> Any:
    sine, cosine = _waves(r)
    value = jnp.where(quadrant & 1 == 0, sine, cosine)
    return jnp.where(quadrant & 2 == 0, value, -value)


def sin(x: Any) -> Any:
    """Return the sine."""
    return _reduced(x, _quarter, jnp.sin)


def cos(x: Any) -> Any:
    """Return the cosine."""
    return _reduced(x, lambda q, r: _quarter(q + 1, r), jnp.cos)


def tan(x: Any) -> Any:
    """Return the tangent."""

    def of(quadrant: Any, r: Any) -> Any:
        sine, cosine = _waves(r)
        odd = quadrant & 1 == 1
        return jnp.where(odd, -cosine, sine) / jnp.where(odd, sine, cosine)

    return _reduced(x, of, jnp.tan)


def _grown(x: Any) -> tuple[Any, Any]:
    """Return exp(|x|/2) twice, one halved: their product does not overflow too early."""
    root = jnp.exp(0.5 * jnp.abs(x))
    return root, 0.5 * root


def sinh(x: Any) -> Any:
    """Return the hyperbolic sine."""
    if x.dtype != np.float32:
        return jnp.sinh(x)
    root, half = _grown(x)
    large = root * half - (0.5 / root) / root
    z = jnp.minimum(x * x, 1.0)
    small = x + x * z * horner(z, _SINH)
    return jnp.where(jnp.abs(x) < 1.0, small, jnp.copysign(large, x))


def cosh(x: Any) -> Any:
    """Return the hyperbolic cosine."""
    if x.dtype != np.float32:
        return jnp.cosh(x)
    root, half = _grown(x)
    return root * half + (0.5 / root) / root


def atan(x: Any) -> Any:
    """Return the arc tangent."""
    if x.dtype != np.float32:
        return jnp.arctan(x)
    size = jnp.abs(x)
    inverted = size > 1.0
    t = jnp.where(inverted, 1.0 / size, size)
    z = t * t
    value = t + t * z * horner(z, _ATAN)
    return jnp.copysign(jnp.where(inverted, np.float32(np.pi / 2) - value, value), x)


def atan2(y: Any, x: Any) -> Any:
    """Return the angle of the point (x, y)."""
    if x.dtype != np.float32:
        return jnp.arctan2(y, x)
    a, b = jnp.abs(y), jnp.abs(x)
    steep = a > b
    low, high = jnp.minimum(a, b), jnp.maximum(a, b)
    # two equal infinities, two zeros: their quotient is no number, the angle is
    ratio = jnp.where((low == high) & (high > 0.0), 1.0, low / jnp.where(high == 0.0, 1.0, high))
    z = ratio * ratio
    value = ratio + ratio * z * horner(z, _ATAN)
    value = jnp.where(steep, np.float32(np.pi / 2) - value, value)
    value = jnp.where(jnp.signbit(x), np.float32(np.pi) - value, value)
    value = jnp.copysign(value, y)
    return jnp.where(jnp.isnan(x) | jnp.isnan(y), jnp.nan, value)


def _asin(size: Any) -> tuple[Any, Any, Any]:
    """Return whether |x| > 1/2, and the arc sine of |x| or of sqrt((1 - |x|)/2)."""
    large = size > 0.5
    z = jnp.where(large, 0.5 * (1.0 - size), size * size)
    s = jnp.where(large, jnp.sqrt(z), size)
    return large, s + s * z * horner(z, _ASIN), z


def asin(x: Any) -> Any:
    """Return the arc sine."""
    if x.dtype != np.float32:
        return jnp.arcsin(x)
    large, value, _ = _asin(jnp.abs(x))
    return jnp.copysign(jnp.where(large, np.float32(np.pi / 2) - 2.0 * value, value), x)


def acos(x: Any) -> Any:
    """Return the arc cosine."""
    if x.dtype != np.float32:
        return jnp.arccos(x)
    large, value, _ = _asin(jnp.abs(x))
    near = jnp.where(x < 0.0, np.float32(np.pi) - 2.0 * value, 2.0 * value)
    return jnp.where(large, near, np.float32(np.pi / 2) - jnp.copysign(value, x))


FAST: dict[str, Function] = {
    f.__name__: f for f in (sin, cos, tan, sinh, cosh, atan, atan2, asin, acos)
}


ERRORS: dict[str, float] = {
    "sin": 2.5,
    "cos": 2.5,
    "tan": 4.5,
    "sinh": 4.0,
    "cosh": 4.0,
    "tanh": 5.0,
    "exp": 5.0,
    "log": 2.5,
    "sqrt": 1.0,
    "asin": 5.0,
    "acos": 3.0,
    "atan": 3.0,
    "atan2": 3.5,
    "pow": 2.0,
    "add": 1.0,
    "sub": 1.0,
    "mul": 1.0,
    "div": 1.0,
}
"""Largest relative error in float32, in units of 2^-24; what is not listed is exact.

Holds for arguments and results of any size that are normal numbers (from 2^-126 on); smaller ones
count as zero.
"""


def function(name: str) -> Function:
    """Return the function that the register machine uses for a primitive."""
    return FAST.get(name) or PRIMITIVES[name].jax


def arity(name: str) -> int:
    """Return the number of arguments of a primitive in postfix code."""
    return arity_of(name)


def evaluate(name: str, *args: Any) -> Any:
    """Evaluate a primitive on NumPy arrays as the register machine does, in their type."""
    with jax.enable_x64(True):
        arrays = [jnp.asarray(arg) for arg in args]
        return np.asarray(jax.jit(function(name))(*arrays))
