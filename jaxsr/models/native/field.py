"""The rates of a simulator in another process as terms: formulas where they are, else calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions import Term
from jaxsr.models.force_columns import force_columns
from jaxsr.models.model import Model
from jaxsr.models.native.laws import Region, recognised
from jaxsr.models.native.process import Native
from jaxsr.models.native.terms import Rows, asked
from jaxsr.models.segments import Prepared
from jaxsr.models.traced_rates import VectorField
from jaxsr.recordings import Recording

TRIALS = 32
"""Random points at which a rate is compared with a state."""
TURN = np.pi
"""Least half-width of the region in which formulas are looked for, in the unit of the variable:
on a small arc sin(q) and q are the same."""
WIDE = 3.0
"""Half-width of that region, relative to what recordings show."""
EULER, WHOLE = 1, 3
"""Orders of the rates of a map: of the law that Euler's method steps along, and of the flow."""
Ranges = Mapping[str, tuple[float, float]]
"""Symbol to centre and half-width."""


def native_field(
    model: Model,
    native: Native,
    variables: Mapping[str, str],
    recordings: Sequence[Recording] = (),
    step: float = 0.0,
) -> tuple[VectorField, float]:
    """Return what a simulator says of a model's states.

    Parameters
    ----------
    model : Model
        Its states without an equation, its inputs and its parameters stand in the rows that the
        simulator is asked, as far as `variables` has them.
    native : Native
    variables : mapping
        Symbol to the simulator's own name; inputs and parameters that it does not have are those
        of edits.
    recordings : sequence of Recording
        Tell where the simulator is asked.
    step : float
        Of a simulator that takes steps, in s; its rates are known to the third order in it.

    Returns
    -------
    field : VectorField
    apart : float
        How far the steps of a simulator are from the law that they go along, relative to its
        rates, where that law is a formula and stands for them.

    Raises
    ------
    InputError
        The simulator gives no numbers, or ends.
    """
    first, _ = _field(model, native, variables, {}, step, formulas=False)
    found: Ranges = {}
    if recordings:
        found = _ranges(replace(model, vector_field=first), recordings)
    return _field(model, native, variables, found, step, formulas=True)


def _field(
    model: Model,
    native: Native,
    variables: Mapping[str, str],
    ranges: Ranges,
    step: float,
    formulas: bool,
) -> tuple[VectorField, float]:
    states = tuple(s for s in model.states if s not in model.equations)
    inputs = tuple(u for u in model.inputs if u in variables)
    parameters = tuple(p for p in model.parameters if p in variables)
    names = (model.time, *states, *inputs, *parameters)
    usual = np.array(
        [
            0.0,
            *(ranges.get(n, (0.0, 1.0))[0] for n in (*states, *inputs)),
            *(model.parameters[p].value for p in parameters),
        ]
    )
    scales = np.array(
        [
            1.0,
            *(ranges.get(n, (0.0, 1.0))[1] for n in (*states, *inputs)),
            *(abs(model.parameters[p].value) or 1.0 for p in parameters),
        ]
    )
    moving = tuple(range(1, 1 + len(states) + len(inputs)))
    last = tuple(range(1 + len(states) + len(inputs), len(names)))
    region = Region(names, moving, last, usual, scales)
    rows = Rows(native, names, usual, scales)
    rng = np.random.default_rng(0)
    at = region.rows(rng, TRIALS)

    def choose(degree: int) -> np.ndarray:
        native.choose(
            len(states),
            scales,
            states=[variables[s] for s in states],
            inputs=[variables[u] for u in inputs],
            outputs=[],
            parameters=[variables[p] for p in parameters],
            degree=degree,
        )
        return native.rates(at)

    values = choose(WHOLE)
    if not np.isfinite(values).any(axis=0).all():
        bad = states[int(np.argmin(np.isfinite(values).any(axis=0)))]
        remedy = "Run it alone with the recordings' values"
        raise InputError(f"gives no rate of {bad} at any point", native.path.name, remedy)
    others = [_is_state(i, at, values, states, step) for i in range(len(states))]
    texts: dict[int, str | None] = {}
    apart = 0.0
    if formulas:
        open_ = [i for i, other in enumerate(others) if other is None]
        written = choose(EULER) if step else values
        texts = {i: _formula(native, region, i) for i in open_}
        if step and any(text is None for text in texts.values()):
            texts, written = {}, choose(WHOLE)  # the law that is stepped along is none
        change = np.abs(written - values)[:, open_]
        size = np.abs(values)[:, open_].max(axis=0, initial=1e-300)
        apart = float(np.nanmax(change / size, initial=0.0))
    rates: dict[str, Term] = {}
    for i, (state, other) in enumerate(zip(states, others, strict=True)):
        text = texts.get(i)
        if other is not None:
            rates[state] = Term.variable(other)
        elif text is not None:
            rates[state] = model.term(text)
        else:
            rates[state] = asked(rows, f"rate_of_{state}", i, _needed(rows, region, i))
    points = dict(zip(names, at.T, strict=True))
    for n in (*model.states, *model.inputs, *model.parameters):
        usually = model.parameters[n].value if n in model.parameters else 0.0
        points.setdefault(n, usually + rng.uniform(-0.1, 0.1, TRIALS))
    gains, entering, columns = force_columns(model, rates, points)
    return VectorField(rates, gains, entering, columns), apart


def _is_state(
    i: int, at: np.ndarray, values: np.ndarray, states: Sequence[str], step: float
) -> str | None:
    """Return the state that a rate is, None where it is none.

    With steps of length h a rate of v + h a/2 is v: velocities before or after a step.
    """
    rate = values[:, i]
    good = np.isfinite(values).all(axis=1)
    if not good.any():
        return None
    for j, state in enumerate(states):
        if j == i:
            continue
        x, own = at[good, 1 + j], rate[good]
        near = 1e-9 * np.abs(x).max() + 1.01 * step * np.abs(values[good, j])
        if np.all(np.abs(own - x) <= near):
            return state
    return None


def _formula(native: Native, region: Region, i: int) -> str | None:
    """Return a rate as a formula: in a wide region, else where recordings are."""
    wide = region.scales.copy()
    k = list(region.moving)
    wide[k] = np.maximum(WIDE * wide[k], TURN)
    for scales in (wide, region.scales):
        own = replace(region, scales=scales)
        found = recognised(lambda rows: native.rates(rows)[:, i], own, np.random.default_rng(1))
        if found is not None:
            return found
    return None


def _needed(rows: Rows, region: Region, i: int) -> list[str]:
    """Return the symbols that a rate depends on."""
    from jaxsr.models.native.laws import depends

    on = depends(lambda r: rows.rates(r)[:, i], region, np.random.default_rng(2))
    return [region.names[k] for k in on]


def _ranges(model: Model, recordings: Sequence[Recording]) -> Ranges:
    """Return where states and inputs are in recordings."""
    columns = [model.column(y) for y in model.outputs]
    # A recording for a simulation need not hold what the sensors read.
    measured = [r for r in recordings if all(c in r.channels for c in columns)]
    if not measured:
        return {}
    items = [Prepared.build(model, r) for r in measured]
    found: dict[str, tuple[float, float]] = {}
    tables = ((model.states, [i.states.values for i in items]),)
    tables += ((model.inputs, [i.inputs for i in items]),)
    for names, parts in tables:
        values = np.concatenate(parts)
        for k, name in enumerate(names):
            own = values[np.isfinite(values[:, k]), k]
            if own.size and np.ptp(own) > 0:
                found[name] = float((own.max() + own.min()) / 2), float(np.ptp(own) / 2)
    return found
