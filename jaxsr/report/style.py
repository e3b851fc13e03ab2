"""The look that all figures share, and how a figure becomes a small PNG."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from jaxsr._progress import Budget
from jaxsr.report.formatting import shorten
from jaxsr.report.tick_labels import plainly_numbered

# Okabe and Ito's palette, told apart by colour-blind readers; the same colours stand in style.css.
MEASURED = "#1f2328"
GIVEN = "#8c959f"
BEFORE = "#d55e00"
AFTER = "#0072b2"
SHADE = "#f0e442"
FAINT = "#d0d7de"
MODES = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#999999")

_DPI = 150
_COLOURS = 128  # of the PNG's palette: a third of the bytes, no visible loss on line drawings
SETTINGS: dict[Any, Any] = {
    "font.family": ["DejaVu Sans"],
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.5,
    "axes.labelcolor": MEASURED,
    "axes.edgecolor": GIVEN,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": False,
    "grid.color": "#eaeef2",
    "grid.linewidth": 0.8,
    "xtick.color": "#57606a",
    "ytick.color": "#57606a",
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "lines.linewidth": 1.5,
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "path.simplify": True,
    "text.usetex": False,
}


@dataclass(frozen=True)
class Drawing:
    """A finished figure.

    Parameters
    ----------
    name : str
        File name, ``*.png``.
    png : bytes
    caption : str
        Title for the reader and text for those who cannot see it.
    note : str
        What else to know, e.g. which part of a recording is drawn.
    wide : bool
        Whether it takes the page's whole width.
    """

    name: str
    png: bytes
    caption: str
    note: str = ""
    wide: bool = True


class Pace:
    """Draw figures as long as there is time, by what those before took.

    Parameters
    ----------
    budget : Budget, optional
    """

    _FIRST = 0.6  # seconds that the first figure of a process may take

    def __init__(self, budget: Budget | None = None) -> None:
        self._budget, self._longest = budget or Budget(), self._FIRST
        self.left_out = False

    def drawn(self, make: Callable[[], list[Drawing]], panels: float = 1.0) -> list[Drawing]:
        """Return the figures that ``make`` draws, or none where there is no time for them."""
        began = self._budget.elapsed
        if self._budget.remaining <= panels * self._longest:
            self.left_out = True
            return []
        drawings = make()
        if drawings:
            spent = (self._budget.elapsed - began) / panels
            self._longest = max(0.7 * self._longest, spent)
        return drawings


def draw(size: tuple[float, float], paint: Callable[[Figure], None]) -> bytes:
    """Return the PNG of a figure of `size` inches that `paint` fills.

    The settings of the user's own figures are neither read nor changed.
    """
    with matplotlib.rc_context(SETTINGS):
        figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        paint(figure)
        for axes in figure.axes:
            plainly_numbered(axes)
        canvas.draw()  # once: `savefig` goes through all artists twice
        pixels = Image.fromarray(np.asarray(canvas.buffer_rgba()))
    image = pixels.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE)
    small = io.BytesIO()
    image.save(small, format="PNG")  # what `optimize` finds is a tenth, for eight times the time
    return small.getvalue()


def plain(text: str, longest: int = 44) -> str:
    """Return a name for a figure: shortened, and with no dollar that would start mathematics."""
    return shorten(text, longest).replace("$", r"\$")


def labelled(name: str, unit: str) -> str:
    """Return an axis label, "v in m/s"."""
    return plain(f"{name} in {unit}" if unit else name)


def decimate(time: np.ndarray, values: np.ndarray, most: int = 2400) -> tuple:
    """Thin a series to the least and the greatest value of each of `most` / 2 stretches of time.

    What a line drawing shows stays as it was: no peak is lost. A stretch with a missing sample
    keeps a gap only if all of it is missing.

    Parameters
    ----------
    time, values : ndarray, shape (samples,)
    most : int
        Points that stay, about.

    Returns
    -------
    tuple of ndarray
        Time and values.
    """
    time, values = np.asarray(time, float), np.asarray(values, float)
    if len(time) <= most:
        return time, values
    step = int(np.ceil(2 * len(time) / most))
    full = len(time) // step * step
    stretches = values[:full].reshape(-1, step)
    rows = np.arange(len(stretches)) * step
    low = rows + np.argmin(np.where(np.isnan(stretches), np.inf, stretches), axis=1)
    high = rows + np.argmax(np.where(np.isnan(stretches), -np.inf, stretches), axis=1)
    rest = np.arange(full, len(time))
    chosen = np.unique(np.concatenate([low, high, rest]))
    return time[chosen], values[chosen]


def line(ax: Axes, time: np.ndarray, values: np.ndarray, **style: Any) -> None:
    """Draw a thinned series; infinities become gaps."""
    values = np.where(np.isfinite(values), values, np.nan)
    ax.plot(*decimate(time, values), **style)


def limits(*series: np.ndarray, share: float = 0.002, pad: float = 0.08) -> tuple | None:
    """Return axis limits that hold all but the outermost `share` of finite values."""
    flat = np.concatenate([np.asarray(s, float).ravel() for s in series])
    flat = flat[np.isfinite(flat)]
    if flat.size == 0:
        return None
    low, high = np.quantile(flat, [share, 1 - share])
    margin = pad * (high - low) or 0.5 * abs(high) or 1.0
    return low - margin, high + margin


def rms(values: np.ndarray) -> float:
    """Return the root mean square of the finite values, 0 when there are none."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return 0.0
    # Scaled, as a diverged run may hold values whose squares overflow.
    scale = float(np.max(np.abs(finite)))
    return scale * float(np.sqrt(np.mean((finite / scale) ** 2))) if scale > 0 else 0.0
