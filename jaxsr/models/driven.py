"""Driven states: memories whose course the recorded inputs and the known states decide."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsr.models.model import Model
from jaxsr.models.simulator import Simulator
from jaxsr.models.stepping import Step, rk4

if TYPE_CHECKING:
    from jaxsr.models.segments import Prepared

REST = 100
"""Samples at standstill before a recording, its first inputs held: memories come to rest."""


def known_states(
    model: Model, item: Prepared, theta: np.ndarray | None = None, simulator: Any = None
) -> np.ndarray:
    """Return every state along a recording, shape (samples, states).

    The states read from the sensors come first, as `Prepared` has them; driven states follow,
    integrated with those and the inputs inserted (RK4, one step a sample).

    Parameters
    ----------
    model : Model
        A model whose driven states stand last.
    item : Prepared
        Prepared for `model` without its driven states, or for `model` itself.
    theta : ndarray, shape (parameters,), optional
        Parameters of the driven equations; the model's by default.
    """
    known = item.states.values[:, : len(model.states) - len(model.driven)]
    if not model.driven:
        return known
    simulator = simulator or Simulator(model)
    values = simulator.values() if theta is None else theta
    x, u = np.nan_to_num(known), item.inputs
    step = float(np.median(np.diff(item.time)))
    time = np.concatenate([item.time[0] - step * np.arange(REST, 0, -1), item.time])
    x, u = (np.concatenate([np.repeat(a[:1], REST, axis=0), a]) for a in (x, u))
    moving = [model.kinematic_parent(s) is not None for s in model.states[: x.shape[1]]]
    x[:REST, moving] = 0.0
    with jax.enable_x64(True):
        path = np.asarray(_path(simulator, time, x, u, np.asarray(values, dtype=float)))
    return np.concatenate([known, path[REST:]], axis=1)


@partial(jax.jit, static_argnums=0)
def _path(simulator: Simulator, time: Any, x: Any, u: Any, theta: Any) -> Any:
    """Integrate the driven states along known ones, shape (samples, driven)."""
    model = simulator.model
    count, p = len(model.driven), tuple(theta[i] for i in range(theta.shape[0]))
    like, held = 0.0 * time[0], model.input_hold == "zero"

    def advance(z: tuple, piece: tuple) -> tuple:
        t, h, known, drive = piece  # known, drive: values at both ends of the interval

        def field(s: Any, y: tuple, _: tuple) -> tuple:
            share = (s - t) / h
            at = known[0] + share * (known[1] - known[0])
            forced = drive[0] + (0.0 if held else share * (drive[1] - drive[0]))
            states = (*(at[i] for i in range(at.shape[0])), *y)
            rates = simulator.rates(s, states, tuple(forced[i] for i in range(forced.shape[0])), p)
            return rates[-count:]

        z = rk4(field, z, Step(t, h, (), (), ()))
        return z, jnp.stack(z)

    pairs = (jnp.stack([a[:-1], a[1:]], axis=1) for a in (x, u))
    start = (like,) * count
    _, path = jax.lax.scan(advance, start, (time[:-1], jnp.diff(time), *pairs))
    return jnp.concatenate([jnp.zeros((1, count)), path])
