"""A model file beside the true system that it describes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from form_plants import Plant


@dataclass(frozen=True)
class ModelForm:
    """A model file beside the true system that it describes.

    Attributes
    ----------
    plant : Plant
    sensors : dict of str to str
        Output to the text of what it measures, in the plant's states, inputs, and the rates
        ``d_STATE`` of its states.
    laws : str
        The tables [definitions], [equations] and [inertia] of the model file.
    free : tuple of str
        Parameters with bounds; all by default.
    readings : dict of str to str
        Where they are not what `sensors` says.
    inputs : dict of str to str
        Columns of the inputs, as texts like those of `sensors`; the plant's own by default.
    extra : str
        More tables.
    head : dict
        More keys of [model].
    python : str
        Source of a vector field ``f`` in place of the equations.
    values : dict of str to float
        Parameters of the model, where they are not the plant's constants.
    per_recording : tuple of str
        Parameters that differ by file.
    may_refuse : str
        Why exit status 2 would be right too; empty where the form is sound.
    wild : bool
        Whether a free run over the whole recording may leave it for good reasons.
    """

    plant: Plant
    sensors: Mapping[str, str]
    laws: str
    free: tuple[str, ...] | None = None
    readings: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str] | None = None
    extra: str = ""
    head: Mapping[str, object] = field(default_factory=dict)
    python: str = ""
    values: Mapping[str, float] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    per_recording: tuple[str, ...] = ()
    may_refuse: str = ""
    wild: bool = False

    @property
    def recorded(self) -> Mapping[str, str]:
        """Input columns and what they hold."""
        return {u: u for u in self.plant.inputs.split()} if self.inputs is None else self.inputs

    @property
    def parameters(self) -> Mapping[str, float]:
        """Names and true values of the model's parameters."""
        return self.plant.values if self.values is None else self.values

    def text(self, given: Mapping[str, float], files: Sequence[str], columns: str = "") -> str:
        """Return the model file with these parameter values."""
        head: dict[str, object] = {"name": "form", "states": self.plant.states.split()}
        head |= {"inputs": list(self.recorded), "outputs": list(self.sensors), **self.head}
        if self.python:
            head["base"] = "m.py:f"
        lines = ["[model]", *(f"{k} = {json.dumps(v)}" for k, v in head.items())]
        lines += [] if self.python else [self.laws]
        readings = {**self.sensors, **self.readings}
        lines += ["[readings]", *(f'{y} = "{readings[y]}"' for y in self.sensors)]
        lines += ["[parameters]", *(self._row(n, v) for n, v in given.items())]
        if self.per_recording:
            lines.append("[per_recording]")
            for name in self.per_recording:
                row = ", ".join(f'"{file}" = {given[name]!r}' for file in files)
                lines.append(f"{name} = {{ {row} }}")
        lines += [self.extra] if self.extra else []
        if self.units:
            lines += ["[units]", *(f'{k} = "{v}"' for k, v in self.units.items() if k not in given)]
        return "\n".join(lines) + "\n" + columns

    def _row(self, name: str, value: float) -> str:
        parts = [f"value = {value!r}"]
        if name in self.units:
            parts.append(f'unit = "{self.units[name]}"')
        if self.free is None or name in self.free:
            size = abs(self.parameters[name])
            low, high = (size / 5, size * 5) if self.parameters[name] > 0 else (-5.0, 5.0)
            parts.append(f"bounds = [{low:.6g}, {high:.6g}]")
        return f"{name} = {{ {', '.join(parts)} }}"


def laws(
    definitions: Mapping[str, str] | None = None, inertia: str = "", /, **equations: str
) -> str:
    """Return the tables of the laws."""
    lines = []
    if definitions:
        lines += ["[definitions]", *(f'{k} = "{v}"' for k, v in definitions.items())]
    lines += ["[equations]", *(f'{k} = "{v}"' for k, v in equations.items())]
    return "\n".join([*lines, *(["[inertia]", inertia] if inertia else [])])
