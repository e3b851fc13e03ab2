"""Units of coefficients as text."""

from __future__ import annotations

import itertools

import pytest

from jaxsr.diagnosis.mechanisms.site import compose
from jaxsr.models.units import dimension


@pytest.mark.parametrize(
    ("above", "below", "expected"),
    [
        ("N*m", ["rad/s"], "N*m*s/rad"),
        ("N", ["m/s"], "N*s/m"),
        ("N", ["m", "m", "m"], "N/m^3"),
        ("N*m", ["rad/s", "rad/s"], "N*m*s^2/rad^2"),
        ("N*m", ["rad"], "N*m/rad"),
        ("m/s^2", ["m"], "1/s^2"),
        ("N", ["1"], "N"),
        ("V", ["V"], "1"),
    ],
)
def test_unit_text_of_coefficients(above, below, expected):
    text = compose(above, below)
    assert text == expected
    product = dimension(text)
    for unit in below:
        product = product * dimension(unit)
    assert product == dimension(above)


def test_unit_text_is_right_for_any_short_units():
    units = ["N", "N*m", "m/s", "rad/s^2", "kg*m^2", "1", "V/s", "N*s/m"]
    for above, below in itertools.product(units, repeat=2):
        text = compose(above, [below])
        assert text is not None
        assert dimension(text) * dimension(below) == dimension(above)
