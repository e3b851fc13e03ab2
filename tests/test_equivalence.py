"""The judge of right-hand sides: the same law in other words passes, another law does not."""

from __future__ import annotations

import functools
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.equivalence import equivalent
from benchmarks.odebench import SYSTEMS, integrate, judged, load

RNG = np.random.default_rng(0)
DATA = {
    "x": RNG.uniform(0.1, 3.0, size=400),
    "y": RNG.uniform(-1.5, 2.0, size=400),
    "z": RNG.uniform(-2.0, 2.0, size=400),
}


def _read(text: str) -> sympy.Expr:
    return sympy.parse_expr(text, local_dict={n: sympy.Symbol(n, real=True) for n in DATA})


SAME = [
    ("(x + y)*(x - 2*y)", "x**2 - x*y - 2*y**2"),
    ("0.5*x*(1 - x/10)", "0.5*x - 0.05*x**2"),
    ("x*(1.3 - y)*z", "1.3*x*z - x*y*z"),
    ("2*sin(x)*cos(x)", "sin(2*x)"),
    ("1.5*sin(y)*cos(y) - 0.7*sin(y)", "0.75*sin(2*y) - 0.7*sin(y)"),
    ("cos(y)**2 + 4.2*sin(y)**2", "1 + 3.2*sin(y)**2"),
    ("cos(y)**2", "1 - sin(y)**2"),
    ("cos(2*y)", "1 - 2*sin(y)**2"),
    ("cos(2*y)", "2*cos(y)**2 - 1"),
    ("cos(y)**3", "cos(y) - cos(y)*sin(y)**2"),
    ("sin(x - y)", "sin(x)*cos(y) - cos(x)*sin(y)"),
    ("1/(1 + exp(0.5 - 1.3*x))", "exp(1.3*x)/(exp(1.3*x) + exp(0.5))"),
    ("1/(1 + exp(4.89*y - 1.4))", "1 - 1/(1 + exp(1.4 - 4.89*y))"),
    ("x/(x + 1.7)", "1 - 1.7/(x + 1.7)"),
    ("x/(x + 1.7)", "1/(1 + 1.7/x)"),
    ("x**2/(x**2 + 2.25)", "1 - 2.25/(2.25 + x**2)"),
    ("x**2/(x**2 + 2.25)", "(x/1.5)**2/(1 + (x/1.5)**2)"),
    ("0.8*x - 0.3*x/(0.9 + x)", "(0.8*x**2 + 0.42*x)/(x + 0.9)"),
    ("0.4*x*log(2.29*x)", "0.4*x*log(x) + 0.33141*x"),
    ("cot(x)*cos(y)", "cos(x)*cos(y)/sin(x)"),
    ("1.67 - y*Abs(y)", "1.67 - Abs(y)*y"),
    ("(1 - x/9)**1.2*x", "x*(1 - x/9)**1.2"),
    ("exp(-0.7*x)*y", "y/exp(0.7*x)"),
    ("1/(1 + exp(-2.4*x))", "0.5 + 0.5*tanh(1.2*x)"),
    ("1/(1 + exp(0.5 - 1.3*x)) - 0.5", "0.5*tanh(0.65*x - 0.25)"),
    ("exp(1.01*x)", "exp(1.01*x)"),
    ("sin(1.98*x)", "sin(1.98*x)"),
]


@pytest.mark.parametrize(("one", "other"), SAME)
def test_other_words_for_a_law_are_accepted(one: str, other: str) -> None:
    a, b = _read(one), _read(other)
    assert equivalent(a, b, DATA) and equivalent(b, a, DATA)
    assert equivalent(a, a, DATA) and equivalent(b, b, DATA)


NOT_YET = [
    ("1.3*sin(1.3*x)*cos(1.3*x)", "0.65*sin(2.6*x)"),
    ("sin(0.5*x)", "sin(x/2)"),
    ("sign(y)*Abs(y)", "y"),
]


@pytest.mark.xfail(reason="fractions of angles and rates are not expanded", strict=True)
@pytest.mark.parametrize(("one", "other"), NOT_YET)
def test_other_words_not_known_yet(one: str, other: str) -> None:
    assert equivalent(_read(one), _read(other), DATA)
    assert equivalent(_read(other), _read(one), DATA)


LAWS = [
    "0.79*x - 0.0106*x**2",
    "-0.9*sin(y)",
    "x - 0.43*y*(z**2 - 1)",
    "1.7*x/(x + 0.8) - 0.3*y",
    "1.2*x**2/(x**2 + 2.25)",
    "1/(1 + exp(4.89*y - 1.4)) - x",
    "1.67 - sin(x) - 0.64*y*Abs(y)",
    "0.33*sin(x - y) - sin(x)",
    "28.3*x - y - x*z",
    "1.2 - 0.2*x - exp(-1.3*x)",
    "0.032*x*log(2.29*x)",
]


def _changed(law: sympy.Expr, number: sympy.Float, factor: float) -> sympy.Expr:
    """Return the law with one of its numbers changed."""
    return law.subs(number, number * factor)


def _rms(expression: sympy.Expr) -> float:
    names = sorted(map(str, expression.free_symbols))
    values = sympy.lambdify(names, expression, "numpy")(*(DATA[n] for n in names))
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.long
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("spurious", ["y**3", "x**2*z", "sin(3*x)", "exp(-2*z)", "1/(x + 3)"])
def test_a_spurious_term_is_rejected_unless_it_is_nothing(law: str, spurious: str) -> None:
    truth, extra = _read(law), _read(spurious)
    share = sympy.Float(_rms(truth) / _rms(extra))
    assert not equivalent(truth + 0.05 * share * extra, truth, DATA)
    assert not equivalent(truth - 0.5 * share * extra, truth, DATA)
    assert not equivalent(truth, truth + 0.05 * share * extra, DATA)
    if spurious in ("y**3", "x**2*z", "sin(3*x)"):
        assert equivalent(truth + 1e-6 * share * extra, truth, DATA)


@pytest.mark.xfail(reason="it enters the common denominator before it is left out", strict=True)
@pytest.mark.parametrize("spurious", ["exp(-2*z)", "1/(x + 3)"])
def test_nothing_below_the_line_is_nothing(spurious: str) -> None:
    truth = _read("28.3*x - y - x*z")
    assert equivalent(truth + 1e-6 * _read(spurious), truth, DATA)


@pytest.mark.parametrize("share", [3e-4, 3e-3])
def test_nothing_is_a_thousandth_of_the_largest_term(share: float) -> None:
    truth = _read("28.3*x - y - x*z")
    extra = _read("z**2")
    size = sympy.Float(share * _rms(_read("28.3*x")) / _rms(extra))
    assert equivalent(truth + size * extra, truth, DATA) is (share < 1e-3)


@pytest.mark.parametrize("law", LAWS)
def test_a_missing_term_is_rejected(law: str) -> None:
    truth = _read(law)
    parts = sympy.Add.make_args(sympy.expand(truth))
    for part in parts:
        if len(parts) > 1:
            assert not equivalent(truth - part, truth, DATA), part
    assert not equivalent(sympy.Integer(0), truth, DATA)
    assert not equivalent(sympy.Float(1.3), truth, DATA)


@pytest.mark.long
@pytest.mark.parametrize("law", LAWS)
def test_one_per_cent_is_accepted_and_five_are_not(law: str) -> None:
    truth = _read(law)
    for number in truth.atoms(sympy.Float):
        for factor in (0.95, 0.99, 1.01, 1.05):
            found = _changed(truth, number, factor)
            assert equivalent(found, truth, DATA) is (abs(factor - 1.0) < 0.02), (number, factor)


@pytest.mark.parametrize(
    ("found", "truth"),
    [
        ("sin(x)", "cos(x)"),
        ("sin(x)", "sin(y)"),
        ("sin(x)", "-sin(x)"),
        ("x*Abs(x)", "y*Abs(y)"),
        ("y*Abs(y)", "y**2"),
        ("exp(x)", "exp(-x)"),
        ("exp(1.0*x)", "exp(2.0*x)"),
        ("1/(x + 1.2)", "1/(x - 1.2)"),
        ("x/(x + 1.2)", "1/(x + 1.2)"),
        ("x**2", "x**2.5"),
        ("x - x**3/6", "sin(x)"),
        ("sin(2*x)", "sin(x)"),
        ("tanh(x)", "1/(1 + exp(-x))"),
        ("sqrt(x)", "x"),
        ("log(x)", "log(2*x)"),
    ],
)
def test_another_law_is_rejected(found: str, truth: str) -> None:
    assert not equivalent(_read(found), _read(truth), DATA)
    assert not equivalent(_read(truth), _read(found), DATA)


def test_what_sympy_cannot_read_counts_as_wrong() -> None:
    truth = _read("x - y")
    for found in (sympy.nan, sympy.zoo, sympy.oo, sympy.I * _read("x"), _read("floor(x)")):
        assert not judged(found, truth, DATA)
    assert judged(truth, truth, DATA)


# ---------------------------------------------------------------- ODEBench

# (system, constant) whose coefficient of the fraction is a sum with a larger part, or a power of
# the constant: 2 % of the one is not 2 % of the other.
SHARED = {(14, 2), (14, 3), (18, 2), (19, 0), (19, 1), (22, 1)}


@functools.cache
def _rows() -> dict[int, dict[str, Any]]:
    if not SYSTEMS.is_file():
        pytest.skip("ODEBench's systems are absent: ../shared/odebench")
    return {row["id"]: row for row in json.loads(SYSTEMS.read_text(encoding="utf-8"))}


@functools.cache
def _runs() -> dict[int, tuple[list[sympy.Expr], dict[str, np.ndarray]]]:
    """Return the equations and a trajectory of each system."""
    _rows()
    out = {}
    for number, system in load().items():
        names = system["names"]
        x = integrate(system["equations"], names, system["starts"][0])
        assert x is not None, number
        out[number] = system["equations"], dict(zip(names, x.T, strict=True))
    return out


def _with(row: dict[str, Any], place: int, factor: float) -> list[sympy.Expr | None]:
    """Return the equations that hold a constant, it being changed, and None for the others."""
    known: dict[str, Any] = {f"x_{k}": sympy.Symbol(f"x_{k}", real=True) for k in range(row["dim"])}
    values = [c * factor if k == place else c for k, c in enumerate(row["consts"][0])]
    known |= {f"c_{k}": sympy.Float(c, 17) for k, c in enumerate(values)}
    out = []
    for part in row["eq"].split("|"):
        text = re.sub(r"\babs\b", "Abs", part.replace("^", "**"))
        held = re.search(rf"\bc_{place}\b", part)
        out.append(sympy.parse_expr(text, local_dict=known) if held else None)
    return out


def _wrong(number: int, place: int) -> list[str]:
    """Return the verdicts on changes of one constant that are not what they should be."""
    truth, data = _runs()[number]
    out = []
    for factor in (0.95, 0.99, 1.01, 1.05):
        pairs = zip(_with(_rows()[number], place, factor), truth, strict=True)
        verdicts = [equivalent(found, right, data) for found, right in pairs if found is not None]
        if verdicts != [abs(factor - 1.0) < 0.02] * len(verdicts) or not verdicts:
            out.append(f"{number}: c_{place} x {factor}: {verdicts}")
    return out


@pytest.mark.long
def test_every_system_is_itself() -> None:
    assert len(_runs()) == 63
    for number, (equations, data) in _runs().items():
        for equation in equations:
            assert equivalent(equation, equation, data), number
            assert equivalent(sympy.expand(equation), equation, data), number
            assert equivalent(_together(equation), equation, data), number


@pytest.mark.slow
def test_every_constant_may_be_off_by_one_per_cent_and_not_by_five() -> None:
    count, wrong = 0, []
    for number, row in _rows().items():
        for place in range(len(row["consts"][0])):
            if (number, place) not in SHARED:
                count += 1
                wrong += _wrong(number, place)
    assert not wrong and count > 140


@pytest.mark.xfail(reason="coefficients of the fraction are compared, not constants", strict=True)
@pytest.mark.parametrize(("number", "place"), sorted(SHARED))
def test_constants_that_share_a_coefficient(number: int, place: int) -> None:
    assert not _wrong(number, place)


@pytest.mark.long
def test_a_spurious_term_is_seen_in_every_system() -> None:
    for number, (equations, data) in _runs().items():
        names = sorted(data)
        for equation in equations:
            for extra in (sympy.Symbol(names[0], real=True) ** 6, sympy.sin(7 * _last(names))):
                found = equation + _share(equation, extra, data, 0.3) * extra
                assert not equivalent(found, equation, data), (number, extra)


def test_no_equation_passes_for_another() -> None:
    rng = np.random.default_rng(1)
    laws = [(e, data) for es, data in _runs().values() for e in es]
    told = 0
    for _ in range(150):
        a, b = rng.choice(len(laws), 2, replace=False)
        (found, _), (truth, data) = laws[a], laws[b]
        if {str(s) for s in found.free_symbols} <= set(data) and found != truth:
            told += 1
            assert not equivalent(found, truth, data), (found, truth)
    assert told > 60


def _together(law: sympy.Expr) -> sympy.Expr:
    """Return the law over one denominator."""
    top, bottom = sympy.fraction(sympy.together(law))
    return top / bottom


def _last(names: list[str]) -> sympy.Symbol:
    return sympy.Symbol(names[-1], real=True)


def _share(
    law: sympy.Expr, extra: sympy.Expr, data: dict[str, np.ndarray], share: float
) -> sympy.Float:
    sizes = []
    for e in (law, extra):
        values = sympy.lambdify(sorted(data), e, "numpy")(*(data[n] for n in sorted(data)))
        sizes.append(float(np.sqrt(np.mean(np.square(values)))))
    return sympy.Float(share * sizes[0] / sizes[1])
