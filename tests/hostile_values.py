"""Values that no model file should hold, for every kind of place in one."""

# fmt: off
from __future__ import annotations

import math
from dataclasses import dataclass

LONG = "Zq" * 4_000
"""A value of which a message may quote 80 characters."""

EXPRESSIONS = (
    *("", " ", "(", ")", "q +", "q q", "1/0", "1/(k - k)", "q/0", "0**-1", "0**0", "9**9**9**9"),
    *("q**1e7", "q**(2**60)", "1e999", "-1e999*q", "log(0)", "log(-1)*q", "sqrt(-1)", "nan", "inf"),
    *("d(v)", "d(q)", "q.real", "__import__('os')", "lambda: 0", "q if q else 0", "q := 1", "q;q"),
    *("Max()", "Piecewise()", "Piecewise(q)", "Piecewise((q, q))", "And(q, q)", "not q", "q == q"),
    *("True", "pi", "pi(q)", "sin", "sin()", "sin(q, q)", "sin(q))", "q,", "'q'", '"q"', "q\nq"),
    *("\x00", "\x1b[31mq", "q\u0301", "𝐪", "🙂", "q\u200b", "٣", "1_000", "0x10", "1e", "."),
    *("..", "1j"),
    *("integral(q)", "q**q**q**q", "unknown", "q" * 3_000, "1" * 5_000, LONG),
    "+".join(["q"] * 240),
    *("q+" * 6_000 + "q", "(" * 99 + "q" + ")" * 99, "(" * 200 + "q" + ")" * 200),
    "-" * 3_000 + "q",
    *("sin(" * 95 + "q" + ")" * 95, "q**" * 300 + "q", "q*" * 240 + "q"),
    "Max(" + "q," * 4_000 + ")",
    *("q<" * 200 + "q", "atan2(" * 90 + "q" + ",1)" * 90, "[" * 50, "not " * 400 + "q"),
    "q" + " " * 9_000,
)
UNITS = (
    *("", " ", "m*", "m/", "*m", "m**0", "m^", "m**", "m**-", "()", "(", ")", "m)", "(m"),
    *("1/0", "0"),
    *("0**-1", "m**9**9**9", "m**(9**9**9)", "m^9^9", "m**1e9", "m**99999", "m**-99"),
    *("m**0.5", "m²"),
    *("N·m", "Nm", "kg m^2", "m**(1/2)", "m**(1/0)", "m**m", "5", "-1", "1", "10*m", "°"),
    *("°C", "%"),
    *("degC", "dB", "count", "USD", "m.m", "__import__('os')", "m;m", "🙂", "m\x00", "m" * 5_000),
    *("m*" * 40 + "m", "m*" * 3_000 + "m", "(" * 200 + "m" + ")" * 200, "(" * 9 + "m" + ")^9" * 9),
    *("m s", "m  /  s", "kkkkm", "None", "in", "as", "e", "pi", "c", "m**+2", "m**--2"),
    *("m/s/s/s/s", LONG),
)
NUMBERS = (
    *(0, 1, -1, 0.0, -0.0, 5, math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 10**400),
    *(-(10**30), 2**63, True, False, 1e-300, 1e300),
)
OTHERS = (
    *("", " ", "x", "q", "free", "tau", "🙂", "\x7f", "\x00", "𝐯", "Ω", "a.b", "a b"),
    *("lambda", "sin"),
    *([], {}, [[]], [{}], {"": 1}, {"a": {}}, [1, 2], [2, 1], [1, 1], [1, 2, 3], ["q", "q"]),
    ["q", 5],
    *([""], ["🙂"], ["sin"], ["pi"], [math.nan, 1], [10**400, 1], {"v": "1"}, {"q": 5}),
    *({"v": []}, LONG),
    *([LONG], {LONG: LONG}, ["x"] * 500, [[[[[1]]]]], {"value": 1}, {"value": []}),
    {"a.csv": math.nan},
    *({"value": 1, "unit": 5}, {"value": 1, "unit": ""}, {"value": 1, "bounds": 5}, "driven"),
    *("t", "y"),
)
KEYS = (
    *("", " ", "q", "v", "x", "unknown", "🙂", "a b", "a.b", '"', "\n", "\x7f", "é", "sin", LONG),
    "𝐯",
)


@dataclass(frozen=True)
class Raw:
    """Text that stands for itself in a TOML file: a value that is none."""

    text: str


RAW = tuple(
    Raw(text)
    for text in (
        *("1" * 4_301, "0x" + "f" * 9_000, "[" * 3_000, "[" * 600 + "]" * 600, "{a=" * 500),
        *("{a=" * 400 + "1" + "}" * 400, "1979-05-27T07:32:00Z", "1979-05-27", "07:32:00"),
        *("", "=", "q", "'" * 3, '"' * 3, "[1,", "{", '"\\ud800"', '"\\q"', "'\x00'", "1_", "+1"),
        *("'" + "a" * 9_000 + "'", "1e400", "-inf", "nan", "9999-99-99", '"\\U0010ffff"', "[,]"),
        *("{,}", "0o7"),
    )
)
