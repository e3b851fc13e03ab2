"""What a sensor may do to a reading besides its noise."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.effects import Effect
from benchmarks.concealed.units import TIME, Dims


def scaled_reading(sensor: int, gain: float = 1.0) -> Effect:
    """Return a wrong gain of a sensor."""
    return Effect(
        "sensor_gain",
        "output",
        sensor,
        {"g": gain},
        {},
        ("g",),
        linear=False,
        about=1.0,
        reading=lambda y, e: e["g"] * y,
    )


def sensing(
    rng: np.random.Generator,
    mechanism: str,
    sensor: int,
    dims: Dims,
    clean: np.ndarray,
    omega: float,
) -> Effect:
    """Return a sensor's effect; `clean` is its undisturbed reading in SI."""
    side = float(rng.choice([-1.0, 1.0]))
    top = float(np.abs(clean).max())
    if mechanism == "sensor_gain":
        return scaled_reading(sensor, 1.0 + 0.05 * side)
    if mechanism == "sensor_bias":
        return Effect(
            mechanism,
            "output",
            sensor,
            {"y0": side * float(clean.std())},
            {"y0": dims},
            ("y0",),
            reading=lambda y, e: y + e["y0"],
        )
    if mechanism == "sensor_delay":
        return Effect(
            mechanism,
            "output",
            sensor,
            {"tau": 0.05 / omega},
            {"tau": TIME},
            ("tau",),
            linear=False,
            delay="tau",
        )
    if mechanism == "clipping":
        return Effect(
            mechanism,
            "output",
            sensor,
            {"ymax": 0.9 * top},
            {"ymax": dims},
            ("ymax",),
            linear=False,
            rising=False,
            reading=lambda y, e: np.clip(y, -e["ymax"], e["ymax"]),
        )
    if mechanism == "quantisation":
        return Effect(
            mechanism,
            "output",
            sensor,
            {"step": 0.1 * float(clean.std())},
            {"step": dims},
            ("step",),
            linear=False,
            reading=lambda y, e: e["step"] * np.round(y / e["step"]),
        )
    return Effect(
        "clock_skew",
        "output",
        sensor,
        {"s": 1e-3 * side},
        {},
        ("s",),
        linear=False,
        clock="s",
    )
