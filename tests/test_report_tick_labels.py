"""Numbers beside the axes of figures."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser

from jaxsr.report.style import draw
from jaxsr.report.tick_labels import plainly_numbered, power


def drawn(low: float, high: float, scale: str = "linear") -> Axes:
    """Return the axes of a line between two values, drawn."""
    figure = Figure()
    canvas, axes = FigureCanvasAgg(figure), figure.subplots()
    axes.plot([0.0, 1.0], [low, high])
    axes.set_yscale(scale)
    plainly_numbered(axes)
    canvas.draw()
    return axes


def told(axes: Axes) -> np.ndarray:
    """Return where the marks are, as their numbers and the end of the axis tell it."""
    axis = axes.yaxis
    words = axis.get_offset_text().get_text().replace("\N{MINUS SIGN}", "-").split()
    raised = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    factor = sum(10.0 ** int(w[3:].translate(raised)) for w in words if w[0] == "×") or 1.0
    shift = sum(float(w) for w in words if w[0] != "×")
    numbers = [t.get_text().replace("\N{MINUS SIGN}", "-") for t in axis.get_majorticklabels()]
    return np.array([float(n) for n in numbers]) * factor + shift


@pytest.mark.parametrize("seed", range(20))
def test_numbers_tell_where_the_marks_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre, width = 10.0 ** rng.uniform(-9, 9), 10.0 ** rng.uniform(-3, 1)
    axes = drawn(-centre * width, centre * (1.0 + width) * rng.choice([-1.0, 1.0]))
    marks = axes.yaxis.get_majorticklocs()
    np.testing.assert_allclose(told(axes), marks, atol=1e-3 * np.ptp(marks))


@pytest.mark.parametrize("low", [1000.0, -1e8])
def test_what_is_to_be_added_stands_apart(low: float) -> None:
    axes = drawn(low, low + 1e-4 * abs(low) / 100.0)
    marks = axes.yaxis.get_majorticklocs()
    np.testing.assert_allclose(told(axes), marks, atol=1e-3 * np.ptp(marks))


def test_powers_of_ten() -> None:
    assert [power(k) for k in (-12, 0, 5)] == ["10⁻¹²", "10⁰", "10⁵"]
    labels = [t.get_text() for t in drawn(1e-6, 1e4, "log").yaxis.get_majorticklabels()]
    assert "10⁻⁴" in labels and "10²" in labels


def test_no_figure_waits_for_mathematics() -> None:
    def paint(figure: Figure) -> None:
        top, bottom = figure.subplots(2, 1)
        top.plot([0.0, 1.0], [0.0, 1e-7])
        bottom.semilogy([0.0, 1.0], [1e-7, 1e7])

    with patch.object(MathTextParser, "parse", side_effect=AssertionError):
        draw((6.0, 4.0), paint)
