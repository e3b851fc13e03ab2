"""Numbers, expressions, diffs and thinning, on which the reports rest."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_report_documents import drive_evidence

from jaxsr.report.diff import diff_tables
from jaxsr.report.evidence import DiffRow
from jaxsr.report.fit_tables import figures_at_a_glance
from jaxsr.report.formatting import estimate, number, odds, percent, unit_text
from jaxsr.report.mathml import equation, expression
from jaxsr.report.mismatch import medians
from jaxsr.report.style import decimate, draw, rms
from jaxsr.report.trajectories import MOST_PANELS, busiest_window, choose

SUPERSCRIPT = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−", "0123456789--")


@given(st.floats(min_value=-1e12, max_value=1e12, allow_subnormal=False), st.integers(2, 6))
def test_number_is_right_to_its_digits(value: float, digits: int) -> None:
    mantissa, _, power = number(value, digits).partition("×10")
    shown = float(mantissa.translate(SUPERSCRIPT)) * 10.0 ** int(power.translate(SUPERSCRIPT) or 0)
    assert shown == pytest.approx(value, rel=0.5001 * 10.0 ** (1 - digits), abs=1e-300)


@pytest.mark.parametrize("value", [None, float("nan"), float("inf"), "text", True])
def test_what_is_no_number_is_a_dash(value: object) -> None:
    assert number(value) == percent(value) == odds(value) == "–"


def test_estimate_shows_two_digits_of_its_interval() -> None:
    assert estimate(20.3974, [20.1142, 20.6931]) == ("20.40", "20.11 … 20.69")
    assert estimate(426.31, [421.2, 431.4]) == ("426", "421 … 431")
    assert estimate(1.5, None) == ("1.5", "–")


def test_odds_are_never_rounded_to_certainty() -> None:
    assert odds(0.9996) == "> 99 %"
    assert odds(0.0004) == "< 1 %"
    assert (odds(1.0), odds(0.0), odds(0.97)) == ("100 %", "0 %", "97 %")


@pytest.mark.parametrize(
    ("unit", "shown"),
    [("N*s/m", "N·s/m"), ("m/s**2", "m/s²"), ("m^-1", "m⁻¹"), ("1", ""), (None, "")],
)
def test_units(unit: object, shown: str) -> None:
    assert unit_text(unit) == shown


def content(text: str) -> str:
    """Return the text of an expression's MathML, which must be well-formed."""
    return "".join(ElementTree.fromstring(expression(text).replace("&#160;", " ")).itertext())


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a - (b - c)", "a−(b−c)"),
        ("a - b - c", "a−b−c"),
        ("(a + b)*c", "(a+b)c"),
        ("a + -2.0*b", "a−2b"),
        ("a - -2.0*b", "a+2b"),
        ("-3.0*exp(-3.0*Abs(v))*sign(v)", "−3e−3|v|sign(v)"),
        ("-(a + b)", "−(a+b)"),
        ("(a/b)**2", "(a/b)2"),
        ("(-a)**2", "(−a)2"),
        ("-a**2", "−a2"),
        ("2.0*omega1", "2ω1"),
        ("1.0e-7*x", "1×10⁻⁷x"),
        ("Piecewise((a, v > 0.1), (b, True))", "{aif v>0.1botherwise"),
    ],
)
def test_mathml_keeps_signs_and_brackets(text: str, shown: str) -> None:
    assert content(text) == shown


def test_expression_outside_the_grammar_is_shown_as_code() -> None:
    assert expression("__import__('os')<b>") == ("<code>__import__(&#39;os&#39;)&lt;b&gt;</code>")
    assert equation("<z>", "open(").count("<z>") == 0


@pytest.mark.parametrize(
    ("explained", "shown"),
    [
        ([0.09, 0.08, 0.02], ["0.1 s", "0.1 s", "10 s"]),  # 90 % left at the headline, 5 % after
        ([0.09, 0.10, 0.20], ["0.1 s", "0.1 s"]),  # 50 % left: no other horizon stands out
        ([0.04, None, 0.30], ["0.1 s", "0.1 s"]),
        ([None, None, 0.02], ["0.1 s", "0.1 s", "10 s"]),
    ],
)
def test_the_horizon_at_which_far_more_was_removed_stands_beside_the_headline(explained, shown):
    rows = {"recalibrated": [0.1, 0.2, 0.4], "explained": explained}
    fit = {"horizons_s": [0.1, 1.0, 10.0], "headline_s": 0.1, "held_out": rows, "train": rows}
    tiles = figures_at_a_glance(fit)
    assert [t["title"].removeprefix("Free run over ") for t in tiles] == shown
    if len(shown) > 2:
        assert tiles[-1]["role"] == "held-out recordings"
        assert (tiles[-1]["before"], tiles[-1]["after"]) == (percent(0.4), percent(0.02))


def test_diff_of_added_and_removed_entries() -> None:
    rows = [
        DiffRow("parameters.Fc", None, {"value": 20.4, "unit": "N", "bounds": [0, 100]}),
        DiffRow("delays.force", 0.01, None),
        DiffRow("parameters.M", 95.0, 95.0),
    ]
    tables = diff_tables(rows)
    assert [(table.name, len(table.lines)) for table in tables] == [
        ("parameters", 1),
        ("delays", 1),
    ]
    added, removed = tables[0].lines[0], tables[1].lines[0]
    assert (added.sign, removed.sign) == ("+", "−")
    assert added.pieces[0][0] == 'Fc = { value = 20.4, unit = "N", bounds = [0, 100] }'


@given(st.text(alphabet="abFv*+-()0123456789. ", max_size=30), st.text(max_size=30))
def test_diff_pieces_join_to_the_whole_line(before: str, after: str) -> None:
    for table in diff_tables([DiffRow("equations.v", before, after)]):
        lines = ["".join(text for text, _ in line.pieces) for line in table.lines]
        assert lines == [f'v = "{before}"', f'v = "{after}"']


def test_thinning_keeps_peaks_order_and_ends_within_a_step() -> None:
    rng = np.random.default_rng(0)
    for length in (100, 5_001, 123_456):
        time = np.sort(rng.uniform(0, 10, length))
        values = rng.standard_normal(length)
        values[rng.integers(length, size=length // 10)] = np.nan
        thin_time, thin = decimate(time, values)
        assert len(thin_time) <= max(2_500, 0) or length == len(thin_time)
        assert np.nanmax(thin) == np.nanmax(values) and np.nanmin(thin) == np.nanmin(values)
        assert np.all(np.diff(thin_time) > 0)


def test_rms_of_huge_and_missing_values() -> None:
    assert rms(np.array([3e200, 4e200, np.nan])) == pytest.approx(3.5355339e200)
    assert rms(np.array([np.nan])) == 0.0


def test_medians_follow_a_step() -> None:
    state = np.linspace(-1, 1, 2000)
    middle, residual = medians(state, np.sign(state) + 0.0)
    assert np.all(residual[middle < -0.1] == -1) and np.all(residual[middle > 0.1] == 1)


def test_window_lies_where_the_error_is() -> None:
    run = drive_evidence().trajectories[0]
    assert busiest_window(run) is None
    time = np.arange(0, 100, 0.01)
    measured = np.sin(2 * np.pi * 5 * time)
    wrong = measured + np.exp(-((time - 70.0) ** 2))
    dense = replace(run, time=time, measured=measured, recalibrated=wrong, explained=measured)
    window = busiest_window(dense)
    assert window is not None and window[0] < 70 < window[1]


def test_choice_puts_held_out_first_and_leaves_room_for_training() -> None:
    run = drive_evidence().trajectories[0]
    many = [
        replace(run, role="held_out", recording=f"h{i}", output=o) for i in range(3) for o in "ab"
    ]
    many += [replace(run, role="train", recording=f"t{i}") for i in range(5)]
    roles = [t.role for t in choose(many, run.horizon_s)]
    assert roles == ["held_out"] * 4 + ["train"] * 2 and len(roles) == MOST_PANELS
    # Recordings take turns before a second output of any is drawn.
    assert {t.recording for t in choose(many, run.horizon_s)[:3]} == {"h0", "h1", "h2"}


def test_drawing_leaves_the_users_settings_alone() -> None:
    before = dict(matplotlib.rcParams)
    png = draw((2, 2), lambda figure: figure.subplots().plot([0, 1]) and None)
    assert png.startswith(b"\x89PNG") and dict(matplotlib.rcParams) == before
