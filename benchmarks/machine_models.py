"""Model files of machines, from their equations."""

from __future__ import annotations


def model_text(
    states: dict[str, str], inputs: str, readings: dict[str, str], parameters: dict[str, str]
) -> str:
    """A model file of equations, readings and free parameters with their bounds."""
    lines = [
        "[model]",
        f"states = {list(states)}",
        f"inputs = [{inputs}]",
        f"outputs = {list(readings)}",
        "[equations]",
        *(f'{s} = "{rate}"' for s, rate in states.items()),
        "[readings]",
        *(f'{y} = "{reading}"' for y, reading in readings.items()),
        "[parameters]",
        *(f"{p} = {{ {value} }}" for p, value in parameters.items()),
    ]
    return "\n".join(lines).replace("'", '"') + "\n"


def free(value: float, low: float, high: float) -> str:
    """A free parameter as it is declared."""
    return f"value = {value}, bounds = [{low}, {high}]"
