"""Actuator mechanisms: the input acts otherwise than recorded, wherever it enters.

An equation f(u) becomes f(h(u)); written as a term, it gains f(h(u)) - f(u), which is B*(h(u) - u)
where u enters linearly with B = df/du. Terms are forces: where those enter by a factor, B is what
they are of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import UNLIMITED, Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Threshold, inverse_unit
from jaxsr.expressions import affine_slope, to_text
from jaxsr.models import Model
from jaxsr.models.force_factor import as_force

_SOURCE = (
    "Tao & Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (1996)"
)


def actuator(model: Model, signals: Mapping[str, np.ndarray] | None = None) -> Iterator[Candidate]:
    """Yield a wrong gain, a curve, a limit and a dead zone of every input.

    `signals` holds the samples of the inputs; without them thresholds are as for a unit input.
    """
    for u in model.inputs:
        columns = columns_of(model, u)
        if columns is not None:
            yield from _of_input(model, u, columns, None if signals is None else signals[u])


def _of_input(
    model: Model, u: str, columns: list[tuple[str, str]], samples: np.ndarray | None
) -> Iterator[Candidate]:
    site, unit = f"input:{u}", model.units.get(u)
    signal = None if samples is None else np.abs(samples)
    top = 1.0 if signal is None else float(np.max(signal))
    if not top > 0.0:
        return

    def added(change: str) -> tuple[tuple[str, str], ...]:
        return entering(columns, change)

    def limit(change: str, level: float) -> Candidate:
        return Candidate(
            "input_saturation",
            "actuator",
            site,
            (Threshold("us", unit, low=1e-3 * top, neutral=UNLIMITED, seed=level * top),),
            "The actuator behind {site} cannot follow large commands.",
            terms=added(change),
            source=_SOURCE,
        )

    yield Candidate(
        "input_gain",
        "actuator",
        site,
        (ParameterSpec("g", "1", low=0.2, high=5.0, neutral=1.0),),
        "The actuator behind {site} gives more or less than its scale says.",
        terms=added(f"({{g}} - 1)*{u}"),
        source=_SOURCE,
    )
    # Between two levels alone, a limit is a gain.
    if signal is None or np.mean(signal > 0.9 * top) < 0.9:
        # the last one is reached by few commands, wherever the others lie
        rare = 0.95 if signal is None else float(np.quantile(signal, 0.98)) / top
        for level in (0.5, 0.7, 0.85, rare):
            yield limit(f"Max(Min({u}, {{us}}), -{{us}}) - {u}", level)
        for level in (0.7, 1.5):
            yield limit(f"{{us}}*tanh({u}/{{us}}) - {u}", level)
    # A curve is told from a gain by commands of several sizes.
    several = signal is None or np.mean((signal > 0.02 * top) & (signal < 0.98 * top)) > 0.02
    if several:
        yield Candidate(
            "input_curve",
            "actuator",
            site,
            (ParameterSpec("gc", inverse_unit(unit)),),
            "The gain of the actuator behind {site} grows or falls with the size of the command.",
            terms=added(f"{{gc}}*{u}*Abs({u})"),
            source="Fossen, Marine Craft Hydrodynamics and Motion Control (2011), section 9.1",
        )
    # A dead zone is felt where the command passes through zero, and by commands of several sizes.
    if signal is None or several or np.mean(signal < 0.2 * top) > 0.02:
        for level in (0.03, 0.1, 0.25):
            yield Candidate(
                "input_deadzone",
                "actuator",
                site,
                (Threshold("ud", unit, low=0.0, high=top, neutral=0.0, seed=level * top),),
                "The actuator behind {site} does not answer small commands.",
                terms=added(f"-Max(Min({u}, {{ud}}), -{{ud}})"),
                source=_SOURCE,
            )


def entering(columns: list[tuple[str, str]], change: str) -> tuple[tuple[str, str], ...]:
    """Return the terms by which a change of an input enters the equations of its columns."""
    return tuple((s, f"+ {b}({change})" if b else f"+ ({change})") for s, b in columns)


def columns_of(model: Model, u: str) -> list[tuple[str, str]] | None:
    """Return the equations that `u` enters as a force, with the text before it ("" for 1).

    None where it enters nowhere, or not linearly.
    """
    if model.vector_field is not None:  # a change of an input is a force beside it
        columns = model.vector_field.columns.items()
        return [(state, "") for state, entry in columns if entry.beside == u] or None
    beside = {state: f for state, f in model.force_factors.items() if f.beside == u}
    found = [(state, "") for state in beside]
    told = {row for factor in beside.values() for row, _ in factor.rows}
    for state, term in model.equation_terms.items():
        if u not in term.variables or state in told:
            continue
        slope = affine_slope(term, u)
        if slope is None or u in slope.variables:
            return None
        if slope.is_constant and slope.value == 0.0:
            continue
        force = as_force(model.force_factors, state, slope)
        if force is None:
            return None
        text = to_text(force)
        found.append((state, "" if text in ("1", "1.0") else f"({text})*"))
    return found or None
