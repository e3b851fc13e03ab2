"""Runs of models: steps, free runs, events, holds, delays, friction, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.models import Simulator, model_text, parse_model, read_model
from jaxsr.models.free_run import free_run
from jaxsr.models.inputs import fill_missing, stage_inputs
from jaxsr.models.rollout import Stepping, _outputs_jit, linearise, outputs, states
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.models.states import StateEstimate, estimate_states, input_table, output_table
from jaxsr.models.stepping import METHODS, Step, factorised
from jaxsr.recordings import Recording

ARM = Path(__file__).resolve().parents[1] / "jaxsr" / "datasets" / "demo" / "arm.toml"


def model(
    states_: str,
    equations: str,
    parameters: str = "",
    inputs: str = "",
    reading: str = "",
    extra: str = "",
    hold: str = "linear",
) -> Simulator:
    """Build a simulator from short texts; names are separated by spaces, lines by semicolons."""
    names = states_.split()
    listed = ", ".join(f'"{n}"' for n in names)
    given = ", ".join(f'"{n}"' for n in inputs.split())
    return Simulator(
        parse_model(
            f'[model]\nstates = [{listed}]\ninputs = [{given}]\noutputs = ["y"]\n'
            f'input_hold = "{hold}"\n[equations]\n'
            + equations.replace("; ", "\n")
            + f'\n[readings]\ny = "{reading or names[0]}"\n[parameters]\n'
            + parameters.replace("; ", "\n")
            + "\n"
            + extra
        )
    )


def rolled(
    simulator: Simulator, recording: Recording, x0: list[float], stepping: Stepping
) -> tuple[np.ndarray, np.ndarray]:
    """Roll out one recording; states (samples, states) and outputs (samples, outputs)."""
    time = recording.time
    nothing = np.full((time.size, len(simulator.model.outputs)), np.nan)
    estimate = StateEstimate(np.tile(x0, (time.size, 1)), {}, frozenset())
    item = Prepared(recording, time, input_table(simulator.model, recording), nothing, estimate)
    segments = build_segments(simulator.model, [item], [(0, 0, time.size)], stepping.substeps)
    theta, start = np.array(simulator.values()), np.array(x0, dtype=float)[:, None]
    x = states(simulator, stepping, segments, theta, start)[..., 0].T
    return x, outputs(simulator, stepping, segments, theta, start)[..., 0].T


def quiet(duration: float, dt: float, **channels: np.ndarray) -> Recording:
    return Recording("a.csv", np.arange(round(duration / dt) + 1) * dt, channels)


# --- steps -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "order"), [("rk4", 4), ("rodas3", 3)])
def test_convergence_order_on_a_forced_nonlinear_oscillator(method: Any, order: int) -> None:
    simulator = model("q v", 'q = "v"; v = "u - q**3 - 0.2*v + sin(t)"', inputs="u")
    recording = quiet(2.0, 0.5, u=np.array([0.0, 1.0, -1.0, 0.5, 2.0]))
    exact, _ = rolled(simulator, recording, [0.3, 0.5], Stepping("rk4", 512))
    errors = [
        np.abs(rolled(simulator, recording, [0.3, 0.5], Stepping(method, n))[0] - exact).max()
        for n in (8, 16, 32)
    ]
    rates = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert rates[-1] == pytest.approx(order, abs=0.25), rates


def test_rodas3_is_l_stable() -> None:
    """One step of x' = -x/tau with h/tau to infinity must give zero, not -1 or growth."""

    def field(t: jax.Array, x: tuple, u: tuple) -> tuple:
        return (-x[0] * 1e12 + 0.0 * t,)

    with jax.enable_x64(True):
        step = Step(jnp.asarray(0.0), jnp.asarray(1.0), (), (), ())
        after = METHODS["rodas3"](field, (jnp.asarray(1.0),), step)
        assert abs(float(after[0])) < 1e-9
        for z in (-0.1, -1.0, -10.0, -1e3):
            small = METHODS["rodas3"](lambda t, x, u, z=z: (z * x[0] + 0.0 * t,), (1.0,), step)
            assert abs(float(small[0])) < 1.0


def test_elimination_agrees_with_numpy() -> None:
    rng = np.random.default_rng(0)
    for count in range(1, 6):
        half = rng.normal(size=(7, count, count))
        matrix = half @ half.transpose(0, 2, 1) + 0.5 * np.eye(count)
        right = rng.normal(size=(7, count))
        rows = [[matrix[:, i, j] for j in range(count)] for i in range(count)]
        found = np.stack(factorised(rows)(tuple(right.T)), axis=1)
        np.testing.assert_allclose(found, np.linalg.solve(matrix, right[..., None])[..., 0], 1e-8)


# --- mass matrices -----------------------------------------------------------------------------


def test_mass_matrix_rates_agree_with_numpy() -> None:
    simulator = model(
        "q a b",
        'q = "a"; a = "f1 - q"; b = "f2*a"',
        "f1 = 2.0; f2 = 3.0",
        extra='[inertia]\na = { a = "2 + q**2", b = "cos(q)" }\nb = { a = "cos(q)", b = "3.0" }\n',
    )
    q, a, b = 0.4, -0.7, 1.1
    rates = simulator.rates(0.0, (q, a, b), (), simulator.values())
    matrix = np.array([[2 + q**2, np.cos(q)], [np.cos(q), 3.0]])
    expected = np.linalg.solve(matrix, [2.0 - q, 3.0 * a])
    np.testing.assert_allclose([float(r) for r in rates], [a, *expected], rtol=1e-6)


def test_mass_matrix_row_may_reach_a_state_without_a_row() -> None:
    simulator = model(
        "q v", 'q = "v"; v = "1.0 + 0*q"', extra='[inertia]\nv = { v = "2", q = "3" }\n'
    )
    rates = simulator.rates(0.0, (0.0, 0.5), (), ())
    assert [float(r) for r in rates] == pytest.approx([0.5, (1.0 - 3 * 0.5) / 2])


def test_double_pendulum_keeps_its_energy() -> None:
    simulator = model(
        "q1 q2 w1 w2",
        'q1 = "w1"; q2 = "w2"'
        '; w1 = "-w2**2*sin(q1 - q2) - 2*g*sin(q1)"; w2 = "w1**2*sin(q1 - q2) - g*sin(q2)"',
        "g = 9.81",
        extra='[inertia]\nw1 = { w1 = "2", w2 = "cos(q1 - q2)" }\n'
        'w2 = { w1 = "cos(q1 - q2)", w2 = "1" }\n',
    )
    recording = quiet(3.0, 0.01)
    methods: Any = (("rk4", 1e-6), ("rodas3", 1e-3))
    for method, tolerance in methods:
        x, _ = rolled(simulator, recording, [1.0, 0.5, 0.0, 0.0], Stepping(method, 2))
        q1, q2, w1, w2 = x.T
        kinetic = w1**2 + 0.5 * w2**2 + w1 * w2 * np.cos(q1 - q2)
        energy = kinetic - 9.81 * (2 * np.cos(q1) + np.cos(q2))
        assert np.ptp(kinetic) > 5.0
        assert np.abs(energy - energy[0]).max() < tolerance * np.ptp(kinetic)


# --- free runs with diffrax --------------------------------------------------------------------


def test_fixed_steps_agree_with_adaptive_ones_on_the_arm() -> None:
    simulator = Simulator(read_model(ARM))
    m = simulator.model
    time = np.arange(301) * 0.01
    channels = {m.column(u): (k + 1) * np.sin((2 + k) * time + k) for k, u in enumerate(m.inputs)}
    recording = Recording("a.csv", time, channels)
    x0 = [0.2, -0.3, 0.0, 0.0]
    run = free_run(simulator, recording, np.array(x0))
    x, y = rolled(simulator, recording, x0, Stepping("rk4", 8))
    assert run.success, run.message
    assert np.abs(x).max() > 0.2
    np.testing.assert_allclose(run.states, x, atol=1e-6)
    np.testing.assert_allclose(run.outputs, y, atol=1e-6)


def friction(force: str = "u") -> Simulator:
    return model("q v", f'q = "v"; v = "{force} - Fc*sign(v)"', "Fc = 1.0", inputs="u")


def stick_slip(time: np.ndarray, u: np.ndarray, fc: float, fine: int) -> tuple[np.ndarray, ...]:
    """Exact rule: in an implicit step the friction impulse is at most fc*h and stops the mass."""
    q = v = 0.0
    qs, vs = [q], [v]
    h = (time[1] - time[0]) / fine
    for i in range(time.size - 1):
        for j in range(fine):
            push = v + h * (u[i] + (u[i + 1] - u[i]) * (j + 1) / fine)
            v = push - np.clip(push, -fc * h, fc * h)
            q += h * v
        qs.append(q)
        vs.append(v)
    return np.array(qs), np.array(vs)


def test_a_mass_below_its_friction_stays_put() -> None:
    recording = quiet(10.0, 0.02, u=0.8 * np.sin(np.arange(501) * 0.02))
    width = 1e-4
    # The smoothed sign holds 0.8 Fc at v = w*atanh(0.8): the creep can be no faster.
    bound = width * np.arctanh(0.8)
    run = free_run(friction(), recording, np.zeros(2), widths=(width,))
    assert run.success, run.message
    assert np.abs(run.states[:, 1]).max() <= bound * 1.001
    assert np.abs(run.states[:, 0]).max() <= bound * 10.0
    x, _ = rolled(friction(), recording, [0.0, 0.0], Stepping("rodas3", 4, (width,)))
    assert np.abs(x[:, 1]).max() <= bound * 1.05
    assert np.abs(x[:, 0]).max() <= bound * 10.0


def test_stick_and_slip_agree_with_the_exact_rule() -> None:
    time = np.arange(501) * 0.02
    u = 1.5 * np.sin(time)
    q, v = stick_slip(time, u, 1.0, 500)
    assert (v == 0).mean() > 0.1 and np.abs(v).max() > 0.2  # it sticks, and it slips
    recording = Recording("a.csv", time, {"u": u})
    run = free_run(friction(), recording, np.zeros(2), widths=(1e-4,))
    assert run.success, run.message
    # The implicit rule errs by h = 4e-5, the smoothing by w = 1e-4 times the sticking time.
    assert np.abs(run.states[:, 1] - v).max() < 1e-3
    assert np.abs(run.states[:, 0] - q).max() < 2e-3
    x, _ = rolled(friction(), recording, [0.0, 0.0], Stepping("rodas3", 8, (1e-4,)))
    assert np.abs(x[:, 0] - q).max() < 2e-3


def test_stiff_and_nonstiff_agree_and_the_switch_is_automatic() -> None:
    simulator = model("x z", 'x = "-1e6*(x - cos(z))"; z = "1.0 + 0*x"')
    time = np.arange(200) * 0.05
    run = free_run(simulator, time, np.array([1.0, 0.0]))
    assert run.success and "Kvaerno5" in run.message
    assert np.abs(run.states[:, 0] - np.cos(time)).max() < 2e-6
    gentle = model("x z", 'x = "-3.0*(x - cos(z))"; z = "1.0 + 0*x"')
    a = free_run(gentle, time, np.array([1.0, 0.0]), method="nonstiff")
    b = free_run(gentle, time, np.array([1.0, 0.0]), method="stiff")
    assert "Tsit5" in a.message and "Kvaerno5" in b.message
    np.testing.assert_allclose(a.states, b.states, atol=1e-6)


def test_an_escaping_state_is_reported_and_not_hidden() -> None:
    simulator = model("x", 'x = "x**2"')
    run = free_run(simulator, np.arange(31) * 0.1, np.array([1.0]))
    assert not run.success and "ended at" in run.message
    assert np.isnan(run.states[-1]).all()
    before = run.time < 0.85
    np.testing.assert_allclose(run.states[before, 0], 1 / (1 - run.time[before]), rtol=1e-5)


def test_free_run_refuses_what_it_cannot_run() -> None:
    with pytest.raises(InputError, match="inputs u are unknown"):
        free_run(friction(), np.arange(3.0), np.zeros(2))
    with pytest.raises(InputError, match="one number for each of q, v"):
        free_run(friction(), quiet(1.0, 0.1, u=np.zeros(11)), np.zeros(3))
    with pytest.raises(InputError, match="events"):
        free_run(ball(), np.arange(3.0), np.zeros(2))
    wrong: Any = "euler"
    with pytest.raises(InputError, match="Use auto"):
        free_run(model("x", 'x = "-x"'), np.arange(3.0), np.zeros(1), method=wrong)


# --- holds and delays --------------------------------------------------------------------------


def lag(hold: str = "linear", extra: str = "") -> Simulator:
    return model("x", 'x = "(u - x)/tau"', "tau = 0.5; d = 0.13", "u", extra=extra, hold=hold)


def lag_of_line(time: np.ndarray, tau: float) -> np.ndarray:
    """Response of tau x' = u - x, x(0) = 0 to the ramp u = t."""
    at = np.maximum(time, 0.0)
    return at - tau * (1 - np.exp(-at / tau))


def test_zero_hold_against_the_exact_recursion() -> None:
    rng = np.random.default_rng(0)
    recording = quiet(2.0, 0.1, u=rng.normal(size=21))
    u, decay = recording.channel("u"), np.exp(-0.1 / 0.5)
    exact = [0.0]
    for k in range(20):
        exact.append(decay * exact[-1] + (1 - decay) * u[k])
    x, _ = rolled(lag("zero"), recording, [0.0], Stepping("rk4", 8))
    np.testing.assert_allclose(x[:, 0], exact, atol=1e-8)
    run = free_run(lag("zero"), recording, np.zeros(1))
    np.testing.assert_allclose(run.states[:, 0], exact, atol=1e-7)


@pytest.mark.parametrize("delay", ["0.3", "0.1", "0.07"])
def test_zero_hold_with_delay(delay: str) -> None:
    """A step of the input at 0.5 s acts after the delay, also where that meets a sample."""
    recording = quiet(2.0, 0.1, u=(np.arange(21) >= 5).astype(float))
    run = free_run(lag("zero", f"[delays]\nu = {delay}\n"), recording, np.zeros(1))
    assert run.success, run.message
    exact = 1 - np.exp(-np.maximum(recording.time - 0.5 - float(delay), 0.0) / 0.5)
    np.testing.assert_allclose(run.states[:, 0], exact, atol=1e-7)


def test_linear_hold_against_the_ramp_response() -> None:
    recording = quiet(2.0, 0.1, u=np.arange(21) * 0.1)
    exact = lag_of_line(recording.time, 0.5)
    x, _ = rolled(lag(), recording, [0.0], Stepping("rk4", 8))
    np.testing.assert_allclose(x[:, 0], exact, atol=1e-8)
    run = free_run(lag(), recording, np.zeros(1))
    np.testing.assert_allclose(run.states[:, 0], exact, atol=1e-7)


def test_bandlimited_hold_is_exact_inside_the_band() -> None:
    time = np.arange(400) * 0.1
    for cycles in (0.3, 1.0, 2.0):  # Hz; half the sampling rate is 5 Hz
        u = np.sin(2 * np.pi * cycles * time)
        start, middle, end = stage_inputs(time, u, "bandlimited", 2)
        inside = slice(100, 299)  # away from the ends, where the record's outside is unknown
        at = time[:-1, None] + 0.1 * np.array([0.25, 0.75])
        error = np.abs(middle - np.sin(2 * np.pi * cycles * at))[inside].max()
        line = np.abs((start + end) / 2 - np.sin(2 * np.pi * cycles * at))
        assert error < 2e-3, cycles
        np.testing.assert_allclose(start[:, 0], u[:-1], atol=1e-9)
        np.testing.assert_allclose(end[:, -1], u[1:], atol=1e-9)
        assert line.shape == middle.shape


def test_bandlimited_needs_uniform_time_and_missing_inputs_are_filled() -> None:
    with pytest.raises(InputError, match="uniform"):
        stage_inputs(np.array([0.0, 1.0, 3.0]), np.zeros(3), "bandlimited", 1)
    filled = fill_missing(np.arange(4.0), np.array([0.0, np.nan, 2.0, 3.0]))
    np.testing.assert_array_equal(filled, np.arange(4.0))


def test_free_run_draws_a_bandlimited_input() -> None:
    time = np.arange(200) * 0.1
    w = 2 * np.pi * 1.5
    recording = Recording("a.csv", time, {"u": np.sin(w * time)})
    a = 1 / 0.5
    exact = a / (a**2 + w**2) * (a * np.sin(w * time) - w * np.cos(w * time))
    run = free_run(lag("bandlimited"), recording, np.array([exact[0]]))
    # What comes after the record is unknown, hence not the last samples.
    assert np.abs(run.states[:-5, 0] - exact[:-5]).max() < 1e-3
    linear = free_run(lag("linear"), recording, np.array([exact[0]]))
    assert np.abs(linear.states[:-5, 0] - exact[:-5]).max() > 5e-3


@pytest.mark.parametrize("delay", ["0.13", '"d"'])
def test_delay_on_an_input(delay: str) -> None:
    recording = quiet(2.0, 0.1, u=np.arange(21) * 0.1)
    simulator = lag(extra=f"[delays]\nu = {delay}\n")
    exact = lag_of_line(recording.time - 0.13, 0.5)
    x, _ = rolled(simulator, recording, [0.0], Stepping("rk4", 32))
    # The kink at 0.13 s lies inside a step.
    np.testing.assert_allclose(x[:, 0], exact, atol=1e-4)
    run = free_run(simulator, recording, np.zeros(1))
    np.testing.assert_allclose(run.states[:, 0], exact, atol=1e-6)


def test_delay_and_clock_on_an_output() -> None:
    recording = quiet(2.0, 0.01, u=np.zeros(201))
    late = lag(extra="[delays]\ny = 0.13\n")
    run = free_run(late, recording, np.ones(1))
    exact = np.exp(-np.maximum(recording.time - 0.13, 0.0) / 0.5)
    np.testing.assert_allclose(run.outputs[:, 0], exact, atol=1e-7)
    _, y = rolled(late, recording, [1.0], Stepping("rk4", 1))
    np.testing.assert_allclose(y[:, 0], exact, atol=1e-4)  # lines between samples
    fast = lag(extra='[clock]\ny = "1 - d"\n')
    run = free_run(fast, recording, np.ones(1))
    exact = np.exp(-recording.time * (1 - 0.13) / 0.5)
    np.testing.assert_allclose(run.outputs[:, 0], exact, atol=1e-7)
    _, y = rolled(fast, recording, [1.0], Stepping("rk4", 1))
    np.testing.assert_allclose(y[:, 0], exact, atol=1e-4)


# --- events ------------------------------------------------------------------------------------


def ball() -> Simulator:
    event = '[[events]]\nwhen = "q"\ndirection = -1\nreset = { v = "-e*v" }\n'
    return model("q v", 'q = "v"; v = "-g"', "g = 9.81; e = 0.8", extra=event)


def test_bouncing_ball() -> None:
    """First impact at sqrt(2 h/g), then flights of 2 e^n sqrt(2 h/g)."""
    recording = quiet(1.5, 0.01)
    x, _ = rolled(ball(), recording, [1.0, 0.0], Stepping("rk4", 4))
    t0 = np.sqrt(2 / 9.81)
    exact, begin, speed = np.empty(recording.time.size), -t0, np.sqrt(2 * 9.81)
    for i, t in enumerate(recording.time):
        while t > begin + 2 * speed / 9.81:
            begin, speed = begin + 2 * speed / 9.81, 0.8 * speed
        s = t - begin
        exact[i] = speed * s - 9.81 * s**2 / 2
    assert x[:, 0].min() > -0.02
    # Located by the secant inside a step of 2.5 ms: g h^2/8 = 8e-6 m, carried on by the bounces.
    np.testing.assert_allclose(x[:, 0], exact, atol=1e-3)


# --- recordings and compilation ----------------------------------------------------------------


def test_initial_numbers_hold_at_the_first_sample_alone() -> None:
    simulator = model("q v", 'q = "v"; v = "-q"', extra='[initial]\nq = 0.5\nv = "free"\n')
    time = np.arange(200) * 0.05
    rng = np.random.default_rng(0)
    recording = Recording("a.csv", time, {"y": 0.6 * np.cos(time) + 1e-3 * rng.normal(size=200)})
    estimate = estimate_states(simulator.model, recording)
    assert estimate.values[0, 0] == 0.5
    assert np.abs(estimate.values[1:, 0] - 0.6 * np.cos(time[1:])).max() < 0.02
    item = Prepared.build(simulator.model, recording)
    segments = build_segments(simulator.model, [item], [(0, 0, 100), (0, 100, 200)], 1)
    assert segments.guess[0, 0] == 0.5 and not segments.free_start[0, 0]
    assert segments.free_start[0, 1] and segments.free_start[1].all()
    assert segments.guess[0, 1] == pytest.approx(0.6 * np.cos(5.0), abs=0.02)


def test_per_recording_values_hold_in_their_file_alone() -> None:
    simulator = model(
        "x", 'x = "-k*x"', "k = 1.0", extra='[per_recording]\nk = { "b.csv" = 2.0 }\n'
    )
    time = np.arange(50) * 0.02
    items = []
    for name in ("a.csv", "b.csv"):
        recording = Recording(name, time, {"y": np.ones(50)})
        items.append(Prepared.build(simulator.model, recording))
    segments = build_segments(simulator.model, items, [(0, 0, 50), (1, 0, 50)], 4)
    y = outputs(simulator, Stepping("rk4", 4), segments, np.array([1.0]), np.ones((1, 2)))
    np.testing.assert_allclose(y[0, :, 0], np.exp(-time), atol=1e-8)
    np.testing.assert_allclose(y[0, :, 1], np.exp(-2 * time), atol=1e-8)
    run = free_run(simulator, items[1].recording, np.ones(1))
    np.testing.assert_allclose(run.states[:, 0], np.exp(-2 * time), atol=1e-7)
    assert output_table(simulator.model, items[0].recording).shape == (50, 1)


def test_a_second_call_compiles_nothing() -> None:
    simulator = friction()
    recording = quiet(1.0, 0.02, u=np.ones(51), y=np.zeros(51))
    item = Prepared.build(simulator.model, recording)
    segments = build_segments(simulator.model, [item], [(0, 0, 25), (0, 25, 50)], 2)
    x0 = np.zeros((2, 2))
    outputs(simulator, Stepping("rk4", 2, (0.1,)), segments, np.array([0.5]), x0)
    programs: Any = _outputs_jit
    before = programs._cache_size()
    outputs(simulator, Stepping("rk4", 2, (0.2,)), segments, np.array([0.7]), x0 + 1.0)
    again = Simulator(parse_model(model_text(simulator.model)))
    outputs(again, Stepping("rk4", 2, (0.2,)), replace(segments, guess=x0), np.array([0.7]), x0)
    assert programs._cache_size() == before


def test_parameters_in_another_order_are_another_program() -> None:
    """Parameters are passed by position: a kept program of the other order would swap them."""
    time = np.arange(20) * 0.05
    item_of, ends = Recording("a.csv", time, {"y": np.ones(20)}), []
    for order in ("a = 1.0; b = 3.0", "b = 3.0; a = 1.0"):
        simulator = model("x", 'x = "-a*x + b"', order)
        item = Prepared.build(simulator.model, item_of)
        segments = build_segments(simulator.model, [item], [(0, 0, 20)], 1)
        y = outputs(simulator, Stepping(), segments, np.array(simulator.values()), np.ones((1, 1)))
        ends.append(y[0, -1, 0])
    exact = 3.0 - 2.0 * np.exp(-time[-1])
    np.testing.assert_allclose(ends, exact, rtol=1e-6)


def test_derivatives_against_finite_differences() -> None:
    simulator = model(
        "q v", 'q = "v"; v = "u - k*sin(q) - c*v*Abs(v)"', "k = 4.0; c = 0.3; e = 1.0", "u"
    )
    time = np.arange(40) * 0.05
    recording = Recording("a.csv", time, {"u": np.sin(time), "y": np.zeros(40)})
    item = Prepared.build(simulator.model, recording)
    segments = build_segments(simulator.model, [item], [(0, 0, 20), (0, 20, 40)], 2)
    theta, x0 = np.array(simulator.values()), np.array([[0.3, -0.2], [0.5, 1.0]])
    methods: Any = ("rk4", "rodas3")
    for method in methods:
        stepping = Stepping(method, 2)
        y, by_theta, by_start = linearise(
            simulator, stepping, segments, theta, x0, np.array([1, 0])
        )
        np.testing.assert_allclose(y, outputs(simulator, stepping, segments, theta, x0), atol=1e-12)
        h = 1e-5
        for row, index in enumerate((1, 0)):
            step = np.zeros(3)
            step[index] = h
            up = outputs(simulator, stepping, segments, theta + step, x0)
            down = outputs(simulator, stepping, segments, theta - step, x0)
            np.testing.assert_allclose(by_theta[row], (up - down) / (2 * h), atol=1e-7)
        for row in range(2):
            step = np.zeros((2, 1))
            step[row] = h
            up = outputs(simulator, stepping, segments, theta, x0 + step)
            down = outputs(simulator, stepping, segments, theta, x0 - step)
            np.testing.assert_allclose(by_start[row], (up - down) / (2 * h), atol=1e-7)
