"""Simulators from short texts and their runs with fixed steps, for the tests of models."""

from __future__ import annotations

import numpy as np

from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping, outputs, states
from jaxsr.models.segments import Prepared, Segments, build_segments
from jaxsr.models.states import StateEstimate, input_table
from jaxsr.recordings import Recording


def model(
    states_: str,
    equations: str,
    parameters: str = "",
    inputs: str = "",
    reading: str = "",
    extra: str = "",
    hold: str = "linear",
) -> Simulator:
    """Build a simulator from short texts; names are separated by spaces, lines by semicolons."""
    names = states_.split()
    listed = ", ".join(f'"{n}"' for n in names)
    given = ", ".join(f'"{n}"' for n in inputs.split())
    return Simulator(
        parse_model(
            f'[model]\nstates = [{listed}]\ninputs = [{given}]\noutputs = ["y"]\n'
            f'input_hold = "{hold}"\n[equations]\n'
            + equations.replace("; ", "\n")
            + f'\n[readings]\ny = "{reading or names[0]}"\n[parameters]\n'
            + parameters.replace("; ", "\n")
            + "\n"
            + extra
        )
    )


def rolled(
    simulator: Simulator, recording: Recording, x0: list[float], stepping: Stepping
) -> np.ndarray:
    """Roll out one recording; states (samples, states)."""
    return states(*_rolling(simulator, recording, x0, stepping))[..., 0].T


def read_off(
    simulator: Simulator, recording: Recording, x0: list[float], stepping: Stepping
) -> np.ndarray:
    """Roll out one recording; outputs (samples, outputs)."""
    return outputs(*_rolling(simulator, recording, x0, stepping))[..., 0].T


def _rolling(
    simulator: Simulator, recording: Recording, x0: list[float], stepping: Stepping
) -> tuple[Simulator, Stepping, Segments, np.ndarray, np.ndarray]:
    time = recording.time
    nothing = np.full((time.size, len(simulator.model.outputs)), np.nan)
    estimate = StateEstimate(np.tile(x0, (time.size, 1)), {}, frozenset())
    item = Prepared(recording, time, input_table(simulator.model, recording), nothing, estimate)
    segments = build_segments(simulator.model, [item], [(0, 0, time.size)], stepping.substeps)
    theta, start = np.array(simulator.values()), np.array(x0, dtype=float)[:, None]
    return simulator, stepping, segments, theta, start


def quiet(duration: float, dt: float, **channels: np.ndarray) -> Recording:
    return Recording("a.csv", np.arange(round(duration / dt) + 1) * dt, channels)


def friction(force: str = "u") -> Simulator:
    return model("q v", f'q = "v"; v = "{force} - Fc*sign(v)"', "Fc = 1.0", inputs="u")


def ball() -> Simulator:
    event = '[[events]]\nwhen = "q"\ndirection = -1\nreset = { v = "-e*v" }\n'
    return model("q v", 'q = "v"; v = "-g"', "g = 9.81; e = 0.8", extra=event)
