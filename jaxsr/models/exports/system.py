"""What is exported of a model: its rates and readings as formulas, and words about the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from jaxsr._result import InputError
from jaxsr.expressions import Term
from jaxsr.models.model import Model


@dataclass(frozen=True)
class System:
    r"""A model as :math:`\dot x = f(t, x, u, p)`, :math:`y = g(t, x, u, p)`.

    Attributes
    ----------
    model : Model
    rates, readings : mapping of str to Term
        By state, any mass matrix solved, and by output, delays and clocks left out.
    """

    model: Model
    rates: Mapping[str, Term]
    readings: Mapping[str, Term]

    @property
    def values(self) -> dict[str, float]:
        """Return the parameters' values."""
        return {name: float(p.value) for name, p in self.model.parameters.items()}

    @property
    def remarks(self) -> list[str]:
        """Return what the two functions do not hold, a line each."""
        model = self.model
        lines = [
            f"{name} {'acts' if name in model.inputs else 'is read'} {delay} s late"
            for name, delay in model.delays.items()
            if delay != 0.0
        ]
        lines += [f"{name} is read at the time {text}" for name, text in model.clock.items()]
        for event in model.events:
            jumps = ", ".join(f"{state} becomes {text}" for state, text in event.reset.items())
            lines.append(f"where {event.when} crosses zero, {jumps}")
        files = [f"{p} differs by recording" for p in model.per_recording]
        return [f"Not in here: {line}." for line in (*lines, *files)]


def system_of(model: Model) -> System:
    """Return the formulas of a model.

    Raises
    ------
    InputError
        The model stands on a Python function that was not loaded.
    """
    if not model.formulas:
        what = f"the model stands on {model.base}, which was not loaded"
        remedy = f"Name {model.base} in the call: Simulator.from_file"
        raise InputError(what, model.name, remedy)
    rates = {state: model.rate_terms[state] for state in model.states}
    return System(model, rates, {output: model.reading_terms[output] for output in model.outputs})


def one_line(text: str, longest: int = 80) -> str:
    """Return text for a comment of any language: on one line, ending nothing."""
    plain = "".join(c if c.isprintable() else " " for c in text)
    plain = plain.replace("*/", "* /").replace('"', "'").replace("\\", "/")
    return plain if len(plain) <= longest else plain[: longest - 3] + "..."


def legend(model: Model, names: tuple[str, ...]) -> str:
    """Return names with their units in a line."""
    units = {**model.units, **{n: p.unit for n, p in model.parameters.items() if p.unit}}
    return ", ".join(f"{n} ({units[n]})" if units.get(n, "1") != "1" else n for n in names) or "-"
