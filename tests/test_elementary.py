"""Functions of the register machine against double precision, over all of float32."""

import numpy as np
import pytest

from jaxsr.evaluation import elementary
from jaxsr.evaluation.elementary import ERRORS
from jaxsr.expressions.postfix import OPERATORS
from jaxsr.expressions.primitives import PRIMITIVES

UNIT = 2.0**-24
LEAST = 2.0**-126  # smallest normal float32
# Every 4099th float32 there is, from zero to infinity, of both signs.
_BITS = np.arange(0, 2**32, 4099, dtype=np.uint64).astype(np.uint32).view(np.float32)
WHOLE = _BITS[np.isfinite(_BITS) & ((np.abs(_BITS) >= LEAST) | (_BITS == 0))]
ONE = [n for n in ERRORS if PRIMITIVES[n].arity == 1]
TWO = [n for n in ERRORS if PRIMITIVES[n].arity == 2]


def _check(name, *arguments):
    with np.errstate(all="ignore"):
        truth = PRIMITIVES[name].numpy(*(a.astype(np.float64) for a in arguments))
        rounded = truth.astype(np.float32)
    found = elementary.evaluate(name, *arguments).astype(np.float64)
    # one rounding away from overflow either answer is right
    certain = ~(np.abs(truth) > 3.4e38) | ~np.isfinite(truth)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(truth))
    np.testing.assert_array_equal(np.isinf(found)[certain], np.isinf(rounded)[certain])
    normal = np.isfinite(rounded) & (np.abs(truth) >= LEAST) & (np.abs(truth) < 3.4e38)
    assert np.mean(normal) > 0.003
    error = np.abs(found[normal] / truth[normal] - 1.0)
    assert error.max() <= ERRORS[name] * UNIT
    tiny = np.abs(truth) < LEAST
    assert np.all(np.abs(found[tiny]) <= 1.01 * LEAST)


@pytest.mark.parametrize("name", ONE)
def test_stated_error_holds_over_the_whole_range(name):
    _check(name, WHOLE)


@pytest.mark.parametrize("name", ONE)
def test_stated_error_holds_where_arguments_usually_are(name):
    rng = np.random.default_rng(0)
    _check(name, rng.uniform(-20.0, 20.0, 200_000).astype(np.float32))
    _check(name, rng.uniform(-1.0, 1.0, 200_000).astype(np.float32))


@pytest.mark.parametrize("name", TWO)
def test_stated_error_of_two_arguments(name):
    rng = np.random.default_rng(1)
    a = rng.choice(WHOLE, 200_000)
    b = (
        rng.uniform(-5.0, 5.0, len(a)).astype(np.float32)
        if name == "pow"
        else rng.choice(WHOLE, len(a))
    )
    _check(name, np.abs(a) if name == "pow" else a, b)


@pytest.mark.parametrize("name", ["sin", "cos", "tan"])
def test_waves_in_double_precision(name):
    rng = np.random.default_rng(2)
    small, large = rng.uniform(-10.0, 10.0, 20_000), rng.uniform(-7e5, 7e5, 20_000)
    huge = 10.0 ** rng.uniform(6.0, 300.0, 1000)
    for x in (small, large, np.concatenate([small, huge]), 10.0 ** rng.uniform(-300, 0, 1000)):
        found, truth = elementary.evaluate(name, x), PRIMITIVES[name].numpy(x)
        np.testing.assert_allclose(found, truth, rtol=6 * 2.0**-53)


def test_sine_of_whole_multiples_of_pi_keeps_its_digits():
    # the float32 next to k pi: what is left after reduction is far below the argument's rounding
    x = (np.arange(1, 200_000) * np.pi).astype(np.float32)
    truth = np.sin(x.astype(np.float64))
    found = elementary.evaluate("sin", x)
    np.testing.assert_allclose(found, truth, rtol=3 * UNIT, atol=1e-12)


def test_a_large_argument_changes_no_other_sample():
    x = np.linspace(-50.0, 50.0, 1000).astype(np.float32)
    alone = elementary.evaluate("sin", x)
    beside = elementary.evaluate("sin", np.append(x, np.float32(1e30)))[:-1]
    np.testing.assert_allclose(beside, alone, rtol=3 * UNIT)


def test_angles_on_the_axes_and_at_infinity():
    special = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan], np.float32)
    y, x = (part.ravel() for part in np.meshgrid(special, special))
    found, truth = elementary.evaluate("atan2", y, x), np.arctan2(y, x)
    np.testing.assert_allclose(found, truth, rtol=3 * UNIT)
    known = ~np.isnan(truth)
    np.testing.assert_array_equal(np.signbit(found[known]), np.signbit(truth[known]))


@pytest.mark.long
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", ONE)
def test_infinities_and_nan_mean_what_they_mean_in_numpy(name, dtype):
    special = np.array([np.inf, -np.inf, np.nan, 0.0], dtype)
    with np.errstate(all="ignore"):
        expected = PRIMITIVES[name].numpy(special)
    np.testing.assert_allclose(elementary.evaluate(name, special), expected, rtol=3 * UNIT)


def test_every_operator_is_exact_or_has_a_stated_error():
    exact = {"neg", "abs", "sign", "floor", "max", "min", "heaviside", "not"}
    exact |= {"lt", "le", "gt", "ge", "eq", "ne"}
    rng = np.random.default_rng(3)
    a, b = rng.choice(WHOLE, 5000), rng.choice(WHOLE, 5000)
    for name in set(OPERATORS) - set(ERRORS):
        assert name in exact
        arguments = (a, b) if elementary.arity(name) == 2 else (a,)
        expected = PRIMITIVES[name].numpy(*arguments)
        np.testing.assert_array_equal(elementary.evaluate(name, *arguments), expected)
