"""What a user gives for a simulator."""

from __future__ import annotations

from pathlib import Path

from jaxsr.models.model import Model
from jaxsr.models.simulator import Simulator


def simulator_of(given: Simulator | Model | str | Path) -> Simulator:
    """Return a simulator as it is, that of a model, or that of a file.

    Raises
    ------
    InputError
        The file cannot be read (`Simulator.from_file`).
    """
    if isinstance(given, Simulator):
        return given
    return Simulator(given) if isinstance(given, Model) else Simulator.from_file(given)
