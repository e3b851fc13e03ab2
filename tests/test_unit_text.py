"""Unit texts: what pint makes of them where it can be asked, and one line where not."""

from __future__ import annotations

import numpy as np
import pint
import pytest

from jaxsr._result import InputError
from jaxsr.expressions.dimensionality import DIMENSIONS, SI, Dimensionality
from jaxsr.expressions.unit_text import dimensionality

NAMES = ["m", "kg", "s", "N", "rad", "V", "A", "Hz", "mm", "µs", "degC", "rpm", "J", "%", "inch"]


def test_products_and_powers_are_those_of_pint() -> None:
    registry = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
    rng = np.random.default_rng(0)
    for _ in range(300):
        text = str(rng.choice([*NAMES, "1"]))
        for _ in range(int(rng.integers(0, 5))):
            power = str(rng.choice(["", "**2", "^3", "**-1", "**(-2)", "^0.5", " ** 2"]))
            text += str(rng.choice(["*", "/", " * ", " / ", " "])) + str(rng.choice(NAMES)) + power
        if rng.random() < 0.3:
            text = f"({text})**2"
        expected = registry.Unit(text.replace("^", "**")).dimensionality
        assert dict(dimensionality(text)) == pytest.approx(dict(expected)), text


def test_units_that_stand_in_the_table_are_those_of_pint() -> None:
    registry = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
    for name, found in DIMENSIONS.items():
        assert dict(found) == dict(registry.Unit(name).dimensionality), name
    assert set(DIMENSIONS) >= SI
    for name in SI:
        assert registry.Quantity(1.0, name).to_base_units().magnitude == 1.0, name


def test_dimensions_multiply_cancel_and_are_written_as_pint_does() -> None:
    length, time = Dimensionality.of({"[length]": 1}), Dimensionality.of({"[time]": 1})
    assert length / time * time == length and hash(length / time * time) == hash(length)
    assert not length / length and (length ** (1 / 3)) ** 3 == length
    assert (
        str(length / time**2) == "[length] / [time] ** 2" and str(time**-0.5) == "1 / [time] ** 0.5"
    )
    assert str(time / time) == "dimensionless" and str(length * time) == "[length] * [time]"


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("m/s**2", "m/s^2"),
        ("m/s²", "m/s^2"),
        ("s⁻¹", "1/s"),
        ("N·m", "N*m"),
        ("Nm", "N*m"),
        ("kg m^2", "kg*m^2"),
        ("m**(1/2)", "m^0.5"),
        ("m**0", "1"),
        ("°", "deg"),
        ("°C", "K"),
        ("1", ""),
    ],
)
def test_two_ways_to_write_one_unit(text: str, same: str) -> None:
    assert dimensionality(text) == dimensionality(same)


BROKEN = [
    *(
        "m*",
        "m/",
        "*m",
        "m**",
        "m^",
        "m**-",
        "()",
        "(",
        ")",
        "m)",
        "(m",
        "1/0",
        "0**-1",
        "5",
        "10*m",
    ),
    *("m**9**9**9", "m**(9**9**9)", "m**1e9", "m**99", "m**m", "m**(1/0)", "m**--2", "m.__class__"),
    *("__import__('os')", "hello", "kgg", "🙂", "m\x00", "m;s", "m" * 5000, "m*" * 3000 + "m"),
    *("(" * 50 + "m" + ")" * 50, "None", "lambda: 0", "m²²", "²", "m**½"),
]


@pytest.mark.parametrize("text", BROKEN, ids=lambda text: ascii(text[:12]))
def test_what_is_no_unit_gives_one_line(text: str) -> None:
    with pytest.raises(InputError) as caught:
        dimensionality(text, "m.toml [units] q")
    message = str(caught.value)
    assert message.startswith("m.toml [units] q: ") and "Write e.g. m/s" in message
    assert message.isprintable() and len(message) < 250
