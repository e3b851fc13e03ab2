"""Recordings drawn over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from jaxsr._result import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_PANELS = 12
"""Channels that are drawn where none are named."""


class Drawn(Protocol):
    """What is drawn of a recording, which draws itself."""

    @property
    def name(self) -> str: ...
    @property
    def time(self) -> np.ndarray: ...
    @property
    def channels(self) -> Mapping[str, np.ndarray]: ...
    def channel(self, name: str) -> np.ndarray: ...


def plot_recording(recording: Drawn, channels: Sequence[str] | None, figure: Any) -> Figure:
    """Draw channels over time, one above another, see `Recording.plot`."""
    names = list(recording.channels)[:MOST_PANELS] if channels is None else list(channels)
    if not names:
        raise InputError("no channel to draw", recording.name, "Name one")
    if figure is None:
        import matplotlib.pyplot as plt  # only here: it chooses a display

        figure = plt.figure(figsize=(8.0, 1.0 + 1.4 * len(names)), layout="constrained")
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for panel, name in zip(panels, names, strict=True):
        values = recording.channel(name)
        panel.plot(recording.time, np.where(np.isfinite(values), values, np.nan), lw=1.0)
        panel.set_ylabel(name.replace("$", r"\$"))
        panel.grid(alpha=0.3)
    panels[0].set_title(recording.name.replace("$", r"\$"), loc="left")
    panels[-1].set_xlabel("time in s")
    return figure
