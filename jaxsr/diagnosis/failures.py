"""What breaks on the way: steps of the search that are given up, and models that never run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import jax
import numpy as np

from jaxsr._deadline import OutOfTime
from jaxsr._progress import Progress
from jaxsr._result import InputError
from jaxsr.models import Simulator
from jaxsr.models.segments import Prepared

Found = TypeVar("Found")


@dataclass
class Failures:
    """Steps of a diagnosis that broke and were given up, each in one line.

    Attributes
    ----------
    progress : Progress
        Told of each.
    lines : list of str
    """

    progress: Progress
    lines: list[str] = field(default_factory=list)

    def attempt(self, step: str, job: Callable[[], Found], otherwise: Found) -> Found:
        """Run a step of the search; where it breaks, go on with what was found before it.

        Bad input and Ctrl-C pass: the one is the user's to mend, the other is asked for. What time
        ended (`jaxsr._deadline.limited`) did not break.
        """
        try:
            return job()
        except InputError:
            raise
        except OutOfTime:
            return otherwise
        except Exception as error:  # whatever it is, what was found before must not be lost
            self.note(step, error)
            return otherwise

    def note(self, step: str, error: Exception) -> None:
        """Keep that a step broke, and tell it."""
        reason = " ".join(str(error).split())[:80] or "no reason given"
        line = f"{step} broke off ({type(error).__name__}: {reason}); what was found before stands"
        self.lines.append(line)
        self.progress.stage(line)


def unsimulable(simulator: Simulator, prepared: Sequence[Prepared]) -> InputError:
    """Say why no set of mechanisms can be simulated along the recordings."""
    model = simulator.model
    for item in prepared:
        found = _first_undefined(simulator, item)
        if found is not None:
            state, row = found
            return InputError(
                f"d({state})/dt is not a number at row {row + 1} (t = {item.time[row]:.6g} s), "
                f"with the values that the sensors and [parameters] give",
                f"{model.name}, equation {state}, on {item.recording.name}",
                "Check the law's domain (sqrt, log, powers, divisions), columns and start values",
            )
    return InputError(
        "no simulation along the recordings stays finite, with the given values or others",
        f"{model.name} on {', '.join(p.recording.name for p in prepared[:3])}",
        "Check units, signs, start values and bounds; `jaxsr simulate` shows a run",
    )


def _first_undefined(simulator: Simulator, item: Prepared) -> tuple[str, int] | None:
    """Return the state and the sample at which the given model has no rate."""
    states = tuple(item.states.values.T)
    inputs = tuple(item.inputs.T)
    with jax.enable_x64(True), np.errstate(all="ignore"):
        try:
            rates = simulator.rates(
                item.time, states, inputs, simulator.values(), simulator.default_widths
            )
        except ArithmeticError:
            return None
    for state, rate in zip(simulator.model.states, rates, strict=True):
        bad = np.flatnonzero(~np.isfinite(np.broadcast_to(np.asarray(rate), item.time.shape)))
        if bad.size:
            return state, int(bad[0])
    return None
