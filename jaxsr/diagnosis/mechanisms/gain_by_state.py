"""Actuators whose gain depends on a state: ground effect, a motor that weakens with its speed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from jaxsr.diagnosis.mechanisms.actuator import columns_of, entering
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import inverse_unit
from jaxsr.expressions import Term
from jaxsr.expressions.canonical import simplify
from jaxsr.models import Model
from jaxsr.models.force_units import compose


def gain_by_state(model: Model, scale: Mapping[str, np.ndarray]) -> Iterator[Candidate]:
    """Yield (1 + g(x))*u in the place of every input u, x the rate or the place that u drives.

    g is a first shape of what the evolution may write in full: a line or a parabola over a place,
    a decay away from its lower end, the size of a rate. 1 + g is nowhere negative on the path.

    Parameters
    ----------
    scale : mapping
        Symbol to quantiles of its values; nothing is known of a symbol without.
    """
    known: set[tuple[str, Term]] = set()
    for u in model.inputs:
        columns = columns_of(model, u)
        if columns is None or len(columns) > 1:
            continue
        ((state, before),) = columns
        whole = simplify(model.term(f"{before}{u}"))
        # What states multiply is a force of motion; of a product of inputs the first one stands.
        if whole.variables & set(model.states) or (state, whole) in known:
            continue
        known.add((state, whole))
        for shape, spec, others, values in _shapes(model, state, scale):
            yield Candidate(
                "input_gain_by_state",
                "actuator",
                f"input:{u}",
                (spec, *others),
                "The gain of the actuator behind {site} depends on the state of the system.",
                terms=entering(columns, f"({shape})*{u}"),
                physical=_never_reversed(spec.name, values),
                source="Cheeseman & Bennett, ARC R&M 3021 (1955), for rotors near the ground",
            )


Shape = tuple[str, ParameterSpec, tuple[ParameterSpec, ...], Callable[..., np.ndarray]]


def _shapes(model: Model, state: str, scale: Mapping[str, np.ndarray]) -> Iterator[Shape]:
    """Yield g as a template, its coefficient, further constants, and g per coefficient."""
    place = model.kinematic_parent(state)
    if place is not None and state in scale:
        per = inverse_unit(model.units.get(state))
        speed = np.abs(scale[state])
        yield f"{{g1}}*Abs({state})", ParameterSpec("g1", per), (), lambda own: speed
    x = place or state
    if x not in scale or not np.ptp(scale[x]) > 0.0:
        return
    unit, values = model.units.get(x), scale[x]
    low, high = float(values[0]), float(values[-1])
    middle = 0.0 if low < 0.0 < high else float(f"{(low + high) / 2:.3g}")
    away, apart = values - middle, f"({x} - ({middle}))" if middle else x
    per = inverse_unit(unit)
    square = compose("1", [unit, unit]) if unit is not None else None
    yield f"{{g1}}*{apart}", ParameterSpec("g1", per), (), lambda own: away
    yield f"{{g2}}*{apart}**2", ParameterSpec("g2", square), (), lambda own: away**2
    end = float(f"{low:.3g}")
    reach = ParameterSpec("h", unit, 0.02 * (high - low), high - low, 0.25 * (high - low), False)
    decay = f"{{g0}}*exp(-({x} - ({end}))/{{h}})"
    yield decay, ParameterSpec("g0", "1"), (reach,), lambda own: np.exp(-(values - end) / own["h"])


def _never_reversed(
    name: str, of: Callable[..., np.ndarray]
) -> Callable[[Mapping[str, float]], bool]:
    """Return a check that 1 + g is nowhere negative."""
    return lambda own: bool(np.all(1.0 + own[name] * of(own) >= 0.0))
