"""Free runs by adaptive integration: what the fixed steps of the roll-outs are judged against."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions import evaluate
from jaxsr.models.inputs import stage_inputs
from jaxsr.models.model import Model
from jaxsr.models.simulator import Simulator, width_scales
from jaxsr.models.states import input_table
from jaxsr.recordings import Recording

Array = Any
Method = Literal["auto", "nonstiff", "stiff"]
# Points per sample interval on which a band-limited input is drawn: lines between them miss a
# sine at the band's end by (pi/32)^2/8 = 0.12 %, one at a quarter of it by 16 times less.
DENSE = 32
MOST_STEPS = 200_000
"""Steps after which an integration is given up, beside `SAMPLE_STEPS` a sample."""
FIRST_STEPS = 2_000  # where "auto" may still turn to stiff
SAMPLE_STEPS = 20


@dataclass(frozen=True, eq=False)
class FreeRun:
    """One free run.

    Attributes
    ----------
    time : ndarray, shape (samples,), in s
    states : ndarray, shape (samples, states)
    outputs : ndarray, shape (samples, outputs)
        NaN, as the states, where the integration did not arrive.
    success : bool
    message : str
        Method and number of steps, or why and when the integration ended early.
    """

    time: np.ndarray
    states: np.ndarray
    outputs: np.ndarray
    success: bool
    message: str


def free_run(
    simulator: Simulator,
    recording_or_time: Recording | np.ndarray,
    x0: np.ndarray,
    parameters: Mapping[str, float] | None = None,
    *,
    method: Method = "auto",
    rtol: float = 1e-8,
    atol: float = 1e-10,
    widths: tuple[float, ...] | None = None,
) -> FreeRun:
    """Integrate a model from x0 over a recording's time and inputs.

    Parameters
    ----------
    simulator : Simulator
    recording_or_time : Recording or ndarray, shape (samples,)
        Time in s, strictly increasing; a model with inputs needs the recording.
    x0 : ndarray, shape (states,)
    parameters : mapping, optional
        Values that replace those of the model and of its [per_recording].
    method : {"auto", "nonstiff", "stiff"}
        Tsit5, Kvaerno5, or Tsit5 and then Kvaerno5 where the first runs out of steps.
    rtol, atol : float
        Tolerances of one step; `atol` is relative to nothing, so states of very different size
        want their own units.
    widths : tuple of float, optional
        Smoothing widths of sign and Heaviside, see `Simulator`; from the states of a first run
        by default.

    Returns
    -------
    FreeRun
        An integration that fails says so in `success` and `message`; it never raises.

    Raises
    ------
    InputError
        The model has [[events]] (the roll-outs handle those), inputs without a recording, or
        `x0` has the wrong shape.
    """
    model = simulator.model
    _check(model, recording_or_time, x0, method)
    recorded = isinstance(recording_or_time, Recording)
    time = np.asarray(recording_or_time.time if recorded else recording_or_time, dtype=float)
    table = input_table(model, recording_or_time) if recorded else np.zeros((time.size, 0))
    name = recording_or_time.name if recorded else ""
    override = {p: v[name] for p, v in model.per_recording.items() if name in v}
    p = simulator.values({**override, **(parameters or {})})
    first = widths if widths is not None else simulator.default_widths
    run = _Run(simulator, time, table, p, np.asarray(x0, dtype=float), (rtol, atol))
    result = run.result(method, first)
    if widths is None and simulator.smoothed_arguments and result.success:
        # Now it is known how far the states go, and how sharp a smoothed sign must be.
        known = simulator.environment(time, tuple(result.states.T), tuple(table.T), p)
        result = run.result(method, width_scales(simulator, known))
    return result


def _check(
    model: Model, recording_or_time: Recording | np.ndarray, x0: np.ndarray, method: str
) -> None:
    if method not in ("auto", "nonstiff", "stiff"):
        raise InputError(f"method {method!r}", model.name, "Use auto, nonstiff or stiff")
    if model.events:
        raise InputError("a model with [[events]]", model.name, "Use simulate_to_csv")
    if model.inputs and not isinstance(recording_or_time, Recording):
        raise InputError(
            f"the inputs {', '.join(model.inputs)} are unknown", model.name, "Give a recording"
        )
    if np.shape(x0) != (len(model.states),):
        raise InputError(
            f"x0 has shape {np.shape(x0)}",
            model.name,
            f"Give one number for each of {', '.join(model.states)}",
        )


@dataclass(frozen=True, eq=False)
class _Run:
    simulator: Simulator
    time: np.ndarray
    table: np.ndarray
    p: tuple[float, ...]
    x0: np.ndarray
    tolerances: tuple[float, float]

    def result(self, method: Method, widths: tuple[float, ...]) -> FreeRun:
        """Integrate, and read the sensors at the times that delays and clocks ask for."""
        model = self.simulator.model
        env: dict[str, Any] = {model.time: self.time}
        env.update(zip(model.parameters, self.p, strict=True))
        asked = [self.time, *(self._read_at(y, env) for y in model.outputs)]
        times, place = np.unique(np.concatenate(asked), return_inverse=True)
        place = place.reshape(len(asked), self.time.size)
        x, success, message = self._solve(method, widths, times)
        outputs = np.empty((self.time.size, len(model.outputs)))
        with jax.enable_x64(True):
            for k in range(len(model.outputs)):
                at = times[place[k + 1]]
                u = tuple(np.interp(at, self.time, column) for column in self.table.T)
                states = tuple(x[place[k + 1]].T)
                outputs[:, k] = self.simulator.readings(at, states, u, self.p, widths)[k]
        return FreeRun(self.time, x[place[0]], outputs, success, message)

    def _read_at(self, output: str, env: dict[str, Any]) -> np.ndarray:
        """Return the times at which a sensor looked: held until its delay has passed."""
        model = self.simulator.model
        at = self.time - _delay(model, output, env)
        if output in model.clock:
            clock = model.term(model.clock[output], f"[clock] {output}")
            if clock.variables & {*model.states, *model.inputs}:
                raise InputError("a clock on states or inputs", f"[clock] {output}", "Use time")
            at = at * np.asarray(evaluate(clock, env))
        return np.clip(at, self.time[0], self.time[-1])

    def _inputs(self) -> tuple[tuple, np.ndarray]:
        """Return knots and values of each input, and the times at which they jump."""
        model, jumps, lines = self.simulator.model, [], []
        for k, name in enumerate(model.inputs):
            delay = _delay(model, name, dict(zip(model.parameters, self.p, strict=True)))
            if model.input_hold == "zero":
                jumps.append(self.time[1:-1] + delay)
            knots, values = _drawn(self.time, self.table[:, k], model.input_hold)
            lines.append((jnp.asarray(knots + delay), jnp.asarray(values)))
        return tuple(lines), self._apart(np.unique(np.concatenate(jumps))) if jumps else np.zeros(0)

    def _apart(self, jumps: np.ndarray) -> np.ndarray:
        """Put jumps that miss a sample by rounding on it: no step is that short."""
        near = self.time[np.searchsorted(self.time[:-1], jumps - 1e-9 * np.diff(self.time).min())]
        close = np.abs(near - jumps) < 2e-9 * np.diff(self.time).min()
        return np.unique(np.where(close, near, jumps))

    def _solve(
        self, method: Method, widths: tuple[float, ...], times: np.ndarray
    ) -> tuple[np.ndarray, bool, str]:
        import diffrax

        plans = {"nonstiff": [("Tsit5", MOST_STEPS)], "stiff": [("Kvaerno5", MOST_STEPS)]}
        plan = plans.get(method, [("Tsit5", FIRST_STEPS), ("Kvaerno5", MOST_STEPS)])
        with jax.enable_x64(True):
            lines, jumps = self._inputs()
            numbers = (tuple(map(jnp.asarray, part)) for part in (self.p, widths))
            rtol, atol = self.tolerances
            controller: Any = diffrax.PIDController(
                rtol=rtol,
                atol=atol,
                pcoeff=0.3,
                icoeff=0.4,
                dtmin=jnp.asarray(1e-13 * (times[-1] - times[0])),
                force_dtmin=False,  # a state that escapes ends the run at once
            )
            # A stiff solver's long steps are only as good between their ends as a cubic.
            controller = diffrax.ClipStepSizeController(
                controller,
                step_ts=jnp.asarray(self.time),
                jump_ts=jnp.asarray(jumps) if jumps.size else None,
            )
            arguments = (*numbers, lines)
            for solver, most in plan:
                solution = diffrax.diffeqsolve(
                    diffrax.ODETerm(_field(_Motion.of(self.simulator))),
                    getattr(diffrax, solver)(),
                    jnp.asarray(times[0]),
                    jnp.asarray(times[-1]),
                    None,
                    jnp.asarray(self.x0),
                    args=arguments,
                    saveat=diffrax.SaveAt(ts=jnp.asarray(times)),
                    stepsize_controller=controller,
                    max_steps=most + SAMPLE_STEPS * self.time.size,
                    throw=False,
                )
                path = np.asarray(solution.ys)
                x = np.where(np.isfinite(path), path, np.nan)
                success = bool(solution.result == diffrax.RESULTS.successful)
                success = success and bool(np.isfinite(x).all())
                if success:
                    break
        steps = int(solution.stats["num_steps"])
        if success:
            return x, True, f"{solver}, {steps} steps"
        reached = times[np.isfinite(x).all(axis=1)].max(initial=times[0])
        why = diffrax.RESULTS[solution.result] if not success else ""
        return x, False, f"{solver} ended at {reached:g} s after {steps} steps: {why}".strip()


def _delay(model: Model, name: str, values: Mapping[str, Any]) -> float:
    delay = model.delays.get(name, 0.0)
    return float(values[delay] if isinstance(delay, str) else delay)


def _drawn(time: np.ndarray, u: np.ndarray, hold: str) -> tuple[np.ndarray, np.ndarray]:
    """Return knots and values between which the input is a straight line (or held)."""
    if hold != "bandlimited":
        return time, u
    starts, _, ends = stage_inputs(time, u, "bandlimited", DENSE)
    fractions = np.arange(DENSE) / DENSE
    knots = (time[:-1, None] + np.diff(time)[:, None] * fractions).ravel()
    return np.append(knots, time[-1]), np.append(starts.ravel(), ends[-1, -1])


@dataclass(frozen=True)
class _Motion:
    """The equations of a simulator: those of equal `key` are one function, and compiled once.

    Values, delays and clocks are arguments of the function, or not its own.
    """

    key: object
    simulator: Simulator = field(compare=False)

    @staticmethod
    def of(simulator: Simulator) -> _Motion:
        model = simulator.model
        if simulator.function is not None or model.vector_field is not None:
            return _Motion(id(simulator), simulator)
        rows = (model.definitions, model.equations, model.additions, model.readings)
        mass = tuple((row, *cells.items()) for row, cells in model.inertia.items())
        names = (model.states, model.inputs, model.time, tuple(model.parameters))
        held = model.input_hold == "zero"
        return _Motion((names, held, mass, *(tuple(r.items()) for r in rows)), simulator)


@functools.lru_cache(maxsize=64)
def _field(motion: _Motion) -> Callable[[Array, Array, tuple], Array]:
    """Return dx/dt as one function for every simulator of the same motion."""
    simulator = motion.simulator
    value = _held if simulator.model.input_hold == "zero" else _straight

    def rates(t: Array, x: Array, arguments: tuple) -> Array:
        p, widths, lines = arguments
        u = tuple(value(t, knots, values) for knots, values in lines)
        return jnp.stack(simulator.rates(t, tuple(x), u, p, widths))

    return rates


def _straight(t: Array, knots: Array, values: Array) -> Array:
    """Return the straight lines, with the ends held outside: a delay asks for earlier times."""
    return jnp.interp(t, knots, values)


def _held(t: Array, knots: Array, values: Array) -> Array:
    """Return the last sample's value (zero-order hold)."""
    index = jnp.searchsorted(knots, t, side="right") - 1
    return values[jnp.clip(index, 0, knots.size - 1)]
