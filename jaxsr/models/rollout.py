"""Roll-outs: segments simulated side by side, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxsr._deadline import ask
from jaxsr.models.delays import cubic
from jaxsr.models.model import Model
from jaxsr.models.segments import Segments
from jaxsr.models.simulator import Simulator
from jaxsr.models.stepping import METHODS, Step

Array = Any
TANGENT_BUCKETS = (0, 12, 24, 48, 96)


@dataclass(frozen=True)
class Stepping:
    """How segments are integrated: method, steps between samples, smoothing widths.

    `smooth` tells how a model without jumps is, whose steps need not resolve any. Where a rounded
    jump turns over, one-step maps take each of them in `parts` (`corners`); samples that stay there
    may be stiff and have a method of their own.
    """

    method: Literal["rk4", "rodas3"] = "rk4"
    substeps: int = 1
    widths: tuple[float, ...] = ()
    smooth: Stepping | None = None
    parts: int = 1
    staying: Literal["rk4", "rodas3"] = "rk4"


def outputs(
    simulator: Simulator, stepping: Stepping, segments: Segments, theta: np.ndarray, x0: np.ndarray
) -> np.ndarray:
    """Simulate every segment and return its readings, shape (outputs, samples, segments)."""
    ask()
    with jax.enable_x64(True):
        y = _outputs_jit(simulator, stepping.method, _data(segments, stepping), theta, x0)
        return np.asarray(y)


def states(
    simulator: Simulator, stepping: Stepping, segments: Segments, theta: np.ndarray, x0: np.ndarray
) -> np.ndarray:
    """Simulate every segment and return its states, shape (states, samples, segments)."""
    ask()
    with jax.enable_x64(True):
        x = _states_jit(simulator, stepping.method, _data(segments, stepping), theta, x0)
        return np.asarray(x)


def linearise(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: np.ndarray,
    x0: np.ndarray,
    active: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Simulate with derivatives.

    Parameters
    ----------
    theta : ndarray, shape (parameters,)
    x0 : ndarray, shape (states, segments)
    active : ndarray of int
        Indices of the parameters to differentiate by.

    Returns
    -------
    y : ndarray, shape (outputs, samples, segments)
    by_theta : ndarray, shape (active, outputs, samples, segments)
    by_start : ndarray, shape (states, outputs, samples, segments)
    """
    ask()
    count = len(active)
    size = next(b for b in TANGENT_BUCKETS if b >= count)
    directions = np.zeros((size, theta.size))
    directions[np.arange(count), active] = 1.0
    with jax.enable_x64(True):
        y, by_theta, by_start = _linearise_jit(
            simulator, stepping.method, _data(segments, stepping), theta, x0, directions
        )
        return np.asarray(y), np.asarray(by_theta)[:count], np.asarray(by_start)


def _data(segments: Segments, stepping: Stepping) -> dict[str, Any]:
    return {
        "time": segments.time,
        "length": segments.length,
        "stages": segments.stages,
        "inputs": segments.inputs,
        "override": segments.override,
        "widths": tuple(np.float64(w) for w in stepping.widths),
    }


def _parameters(theta: Array, override: Array) -> tuple:
    return tuple(
        jnp.where(jnp.isnan(override[i]), theta[i], override[i]) for i in range(theta.shape[0])
    )


def _states(simulator: Simulator, method: str, data: dict, theta: Array, x0: Array) -> Array:
    """States at the samples, shape (states, samples, segments)."""
    advance = METHODS[method]
    p, widths, model = _parameters(theta, data["override"]), data["widths"], simulator.model
    stages = _delayed_stages(model, data, p)

    def field(t: Array, x: tuple, u: tuple) -> tuple:
        return simulator.rates(t, x, u, p, widths)

    def substep(carry: tuple, piece: tuple) -> tuple:
        t, x = carry
        h, us = piece
        step = Step(t, h, tuple(us[0]), tuple(us[1]), tuple(us[2]))
        new = advance(field, x, step)
        if model.events:
            new = _after_events(simulator, field, step, x, new, p, advance)
        return (t + h, new), None

    def sample(x: tuple, piece: tuple) -> tuple:
        t, h, us = piece
        (_, x), _ = jax.lax.scan(substep, (t, x), (h, jnp.moveaxis(us, 2, 0)))
        return x, jnp.stack(x)

    start = tuple(x0[i] for i in range(len(model.states)))
    xs = (data["time"][:-1], data["length"], jnp.moveaxis(stages, 2, 0))
    _, path = jax.lax.scan(sample, start, xs)
    return jnp.moveaxis(jnp.concatenate([x0[None], path]), 1, 0)


def _after_events(
    simulator: Simulator, field: Any, step: Step, old: tuple, new: tuple, p: tuple, advance: Any
) -> tuple:
    """Locate a zero crossing inside the step by the secant, reset there, finish the step."""
    from jaxsr.expressions import evaluate

    model = simulator.model
    for event in model.events:
        when = model.term(event.when)
        a = evaluate(when, simulator.environment(step.time, old, step.u_start, p), "jax")
        b = evaluate(when, simulator.environment(step.time, new, step.u_end, p), "jax")
        falling, rising = (a > 0) & (b <= 0), (a < 0) & (b >= 0)
        crossed = {-1: falling, 1: rising, 0: falling | rising}[event.direction]
        share = jnp.where(crossed, a / jnp.where(crossed, a - b, 1.0), 1.0)
        to_event = step._replace(length=step.length * share)
        at = advance(field, old, to_event)
        env = simulator.environment(step.time, at, step.u_start, p)
        after = tuple(
            evaluate(model.term(event.reset[s]), env, "jax") + 0.0 * at[i]
            if s in event.reset
            else at[i]
            for i, s in enumerate(model.states)
        )
        rest = step._replace(
            time=step.time + step.length * share, length=step.length * (1.0 - share)
        )
        finished = advance(field, after, rest)
        new = tuple(jnp.where(crossed, f, n) for f, n in zip(finished, new, strict=True))
    return new


def _delay(model: Model, name: str, p: tuple) -> Any:
    value = model.delays.get(name)
    if value is None or value == 0.0:
        return None
    if isinstance(value, str):
        return p[list(model.parameters).index(value)]
    return value


def _shifted(time: Array, values: Array, at: Array) -> Array:
    """Interpolate per segment; before the first sample the first value is held."""
    return jax.vmap(jnp.interp, in_axes=(1, 1, 1), out_axes=1)(at, time, values)


def _smoothly(time: Array, values: Array, at: Array) -> Array:
    """Interpolate per segment like `delays.smoothly_interpolated`."""

    def one(at: Array, t: Array, y: Array) -> Array:
        size = 1 + jnp.sum(jnp.diff(t) > 0)  # padding repeats the last time
        begin = jnp.clip(jnp.searchsorted(t, at, side="right") - 2, 0, jnp.maximum(size - 4, 0))
        nodes = [jnp.where(size < 4, float(i), t[begin + i]) for i in range(4)]
        curve = sum(w * y[begin + i] for i, (w, _) in enumerate(cubic(nodes, at)))
        inside = (at > t[0]) & (at < t[-1]) & (size >= 4)
        return jnp.where(inside, curve, jnp.interp(at, t, y))

    return jax.vmap(one, in_axes=(1, 1, 1), out_axes=1)(at, time, values)


def _delayed_stages(model: Model, data: dict, p: tuple) -> Array:
    """Inputs at the stages, with [delays] applied by linear interpolation of the samples."""
    stages = jnp.asarray(data["stages"])
    for k, name in enumerate(model.inputs):
        delay = _delay(model, name, p)
        if delay is None:
            continue
        h = data["length"]
        begin = data["time"][:-1, None] + jnp.cumsum(h, axis=1) - h
        if model.input_hold == "zero":
            # A held input is passed on by its mean over the step: impulses are kept, and a
            # delay that is no multiple of the step can be differentiated.
            shifted = jnp.where(h > 0, _delayed_mean(data, k, begin - delay, h), stages[0, k])
            stages = stages.at[:, k].set(shifted)
            continue
        for s, fraction in enumerate((0.0, 0.5, 1.0)):
            at = begin + fraction * h - delay
            flat = at.reshape(-1, at.shape[-1])
            if model.input_hold == "bandlimited":
                shifted = _shifted(*_dense(data, k, begin), flat)
            else:
                shifted = _shifted(data["time"], data["inputs"][k], flat)
            shifted = jnp.where(h > 0, shifted.reshape(at.shape), stages[s, k])
            stages = stages.at[s, k].set(shifted)
    return stages


def _delayed_mean(data: dict, k: int, begin: Array, length: Array) -> Array:
    """Mean of a held input over steps from `begin` on, by the integral of the input."""
    time, u = jnp.asarray(data["time"]), jnp.asarray(data["inputs"][k])
    u = u - u[:1]  # the integral stays small, and the first value is held before the start
    integral = jnp.concatenate(
        [jnp.zeros_like(u[:1]), jnp.cumsum(u[:-1] * jnp.diff(time, axis=0), axis=0)]
    )
    edges = begin.reshape(-1, begin.shape[-1])
    edges = jnp.concatenate([edges, edges[-1:] + length[-1, -1:]])  # steps follow each other
    rise = jnp.diff(_shifted(time, integral, edges), axis=0).reshape(begin.shape)
    return data["inputs"][k][:1] + rise / jnp.where(length > 0, length, 1.0)


def _dense(data: dict, k: int, begin: Array) -> tuple[Array, Array]:
    """Knots and values of a band-limited input at the starts and middles of all steps."""
    h, stages = data["length"], data["stages"]
    u = jnp.asarray(data["inputs"][k])
    # Padding repeats the last time, where the input has but one value.
    middle, start = (jnp.where(h > 0, stages[s, k], u[:-1, None]) for s in (1, 0))
    at = jnp.stack([begin, begin + 0.5 * h], axis=2).reshape(-1, h.shape[-1])
    values = jnp.stack([start, middle], axis=2).reshape(-1, h.shape[-1])
    return jnp.concatenate([at, data["time"][-1:]]), jnp.concatenate([values, u[-1:]])


def _outputs(simulator: Simulator, method: str, data: dict, theta: Array, x0: Array) -> Array:
    x = _states(simulator, method, data, theta, x0)
    p, model = _parameters(theta, data["override"]), simulator.model
    u = tuple(data["inputs"][k] for k in range(len(model.inputs)))
    y = simulator.readings(data["time"], tuple(x), u, p, data["widths"])
    signals = []
    for name, signal in zip(model.outputs, y, strict=True):
        signal = signal + 0.0 * data["time"]
        delay = _delay(model, name, p)
        if delay is not None or name in model.clock:
            at = data["time"] if delay is None else data["time"] - delay
            if name in model.clock:
                from jaxsr.expressions import evaluate

                env = simulator.environment(data["time"], tuple(x), u, p)
                at = at * evaluate(model.term(model.clock[name]), env, "jax")
            signal = _smoothly(data["time"], signal, at)
        signals.append(signal)
    return jnp.stack(signals)


_outputs_jit = partial(jax.jit, static_argnums=(0, 1))(_outputs)
_states_jit = partial(jax.jit, static_argnums=(0, 1))(_states)


@partial(jax.jit, static_argnums=(0, 1))
def _linearise_jit(
    simulator: Simulator, method: str, data: dict, theta: Array, x0: Array, directions: Array
) -> tuple[Array, Array, Array]:
    driven, size = len(simulator.model.driven), directions.shape[0]
    states_count = x0.shape[0] - driven  # driven states stand last, and their starts are given
    unit = jnp.eye(x0.shape[0])[:states_count, :, None] * jnp.ones_like(x0)[None]
    # One pass for all directions: parameters first, then the start of every segment at once.
    d_theta = jnp.concatenate([directions, jnp.zeros((states_count, theta.shape[0]))])
    d_start = jnp.concatenate([jnp.zeros((size, *x0.shape)), unit])

    def along(a: Array, b: Array) -> tuple[Array, Array]:
        return jax.jvp(lambda p, x: _outputs(simulator, method, data, p, x), (theta, x0), (a, b))

    y, slopes = jax.vmap(along, out_axes=(None, 0))(d_theta, d_start)
    by_start = jnp.concatenate([slopes[size:], jnp.zeros((driven, *y.shape))])
    return y, slopes[:size], by_start
