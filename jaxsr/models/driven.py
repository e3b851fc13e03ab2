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

NEWTON_STEPS = 3  # one suffices where a memory is linear


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
    with jax.enable_x64(True):
        path = np.asarray(_path(simulator, item.time, x, u, np.asarray(values, dtype=float)))
    return np.concatenate([known, path], axis=1)


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
    start = _at_rest(simulator, time[0], x[0], u[0], p)
    start = tuple(start[i] + like for i in range(count))
    _, path = jax.lax.scan(advance, start, (time[:-1], jnp.diff(time), *pairs))
    return jnp.concatenate([jnp.stack(start)[None], path])


def _at_rest(simulator: Simulator, t: Any, x: Any, u: Any, p: tuple) -> Any:
    """Where the memories have settled if all has stood still with the first sample's values."""
    model = simulator.model
    moving = jnp.array([model.kinematic_parent(s) is not None for s in model.states[: x.shape[0]]])
    known = tuple(jnp.where(moving, 0.0, x))
    drive = tuple(u[i] for i in range(u.shape[0]))

    def rates(z: Any) -> Any:
        states = (*known, *(z[i] for i in range(z.shape[0])))
        return jnp.stack(simulator.rates(t, states, drive, p)[-z.shape[0] :])

    z = jnp.zeros(len(model.driven))
    for _ in range(NEWTON_STEPS):
        # A memory that standstill leaves where it is (a zero row) stays at zero.
        z = z - jnp.linalg.pinv(jax.jacfwd(rates)(z)) @ rates(z)
    return z
