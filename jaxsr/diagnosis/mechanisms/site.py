"""Sites: where in a model a mechanism may act, with the symbols and units met there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import ParameterSpec
from jaxsr.diagnosis.mechanisms.motion import Motion
from jaxsr.expressions import Term, evaluate
from jaxsr.models import Model
from jaxsr.models.force_units import compose, force_unit


@dataclass(frozen=True)
class Threshold(ParameterSpec):
    """A constant at whose `neutral` value (0, or beyond all data) a nonlinear effect vanishes.

    Attributes
    ----------
    seed : float
        The value that the screening tries, and that the estimation in free run starts from.
    """

    seed: float = 0.0


@dataclass(frozen=True)
class Site:
    """An equation of motion as mechanisms see it.

    Attributes
    ----------
    state : str
        The rate whose equation it is (v).
    position : str or None
        The state whose derivative `state` is (q).
    turning : bool
        Whether the position is an angle.
    force_unit : str or None
        Unit of the terms of the equation.
    scale : mapping
        Symbol to the quantiles 0, 5, ..., 100 % of its values in the recordings.
    others : tuple of Site
        The other equations of motion.
    motion : Motion or None
        Signals and residual forces; None where the equations cannot be read off the sensors.
    """

    model: Model
    state: str
    position: str | None
    turning: bool
    force_unit: str | None
    scale: Mapping[str, np.ndarray] = field(default_factory=dict)
    others: tuple[Site, ...] = ()
    motion: Motion | None = None

    @property
    def may_turn(self) -> bool:
        """Whether the position is an angle, or has no unit that says that it is none."""
        return self.turning or (self.position is not None and self.position not in self.model.units)

    @property
    def name(self) -> str:
        """Name in a diagnosis."""
        return f"equation:{self.state}"

    def signal(self, symbol: str | None) -> np.ndarray | None:
        """Samples of a state, of an input or of time, over all recordings."""
        if self.motion is None or symbol is None:
            return None
        return self.motion.signals.get(symbol)

    @property
    def reverses(self) -> bool:
        """Whether the motion goes both ways for at least a twentieth of the time.

        In a motion that never returns, position and velocity tell the same story, and a spring
        cannot be told from a resistance.
        """
        speeds = self.scale.get(self.state)
        return speeds is None or bool(speeds[1] < 0.0 < speeds[-2])

    @property
    def driven(self) -> bool:
        """Whether an input enters the equation itself."""
        return bool(self.model.equation_terms[self.state].variables & set(self.model.inputs))

    @property
    def mass(self) -> float:
        """What the equation's rate is multiplied by, at the given values amid the recordings."""
        term = self.model.inertia_terms.get(self.state, {}).get(self.state)
        if self.state in self.model.force_factors:
            rows = dict(self.model.force_factors[self.state].rows)
            term = Term.apply("div", Term.constant(1.0), rows[self.state])
        if term is None:
            return 1.0
        values = {s: float(q[len(q) // 2]) for s, q in self.scale.items()}
        values |= {n: p.value for n, p in self.model.parameters.items()}
        if not term.variables <= values.keys():
            return 1.0
        return float(evaluate(term, values))

    def per(self, *symbols: str) -> str | None:
        """Unit of a coefficient that makes a force with the product of `symbols`."""
        if self.force_unit is None:
            return None
        units = self.model.units
        if any(s not in units for s in symbols):
            return None
        return compose(self.force_unit, [units[s] for s in symbols])


def inverse_unit(unit: str | None) -> str | None:
    """Return the unit of 1/quantity."""
    return compose("1", [unit]) if unit is not None else None


def sites_of(
    model: Model, scale: Mapping[str, np.ndarray], motion: Motion | None = None
) -> tuple[Site, ...]:
    """Return every equation of motion of a model."""
    plain = []
    for state in model.dynamic_states:
        position = model.kinematic_parent(state)
        turning = position is not None and _is_angle(model, position)
        plain.append(Site(model, state, position, turning, force_unit(model, state), scale))
    return tuple(
        Site(
            s.model,
            s.state,
            s.position,
            s.turning,
            s.force_unit,
            scale,
            tuple(o for o in plain if o.state != s.state),
            motion,
        )
        for s in plain
    )


def _is_angle(model: Model, position: str) -> bool:
    """Whether a position is an angle: by its unit, which may be 1, or else by a sine of it."""
    unit = model.units.get(position)
    if unit is not None:
        return unit.strip() in ("rad", "deg", "1")
    waves = [
        t for e in model.equation_terms.values() for t in e.distinct() if t.op in ("sin", "cos")
    ]
    return any(position in wave.variables for wave in waves)
