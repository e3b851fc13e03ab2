"""Model files of the generated forms: one kind of model a function, written in different ways.

Each function takes a generator of random numbers and the turn in which its kind comes up; the
turn chooses the way of writing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import form_systems as systems
import numpy as np
from model_forms import ModelForm, laws

Rng = np.random.Generator

_UNITS = {
    **{"q": "m", "v": "m/s", "u": "N", "m": "kg", "k": "N/m", "c": "N*s/m", "y": "m"},
}
_POSITION = {"y": "q"}


def divided(rng: Rng, turn: int) -> ModelForm:
    text = ["(u - k*q - c*v)/m", "u/m - k/m*q - c*v/m", "-(k*q + c*v - u)/m"][turn % 3]
    units = _UNITS if turn % 2 else {}
    return ModelForm(systems.OSCILLATOR, _POSITION, laws(q="v", v=text), units=units)


def with_inertia(rng: Rng, turn: int) -> ModelForm:
    text = laws(None, 'v = { v = "m" }', q="v", v=["u - k*q - c*v", "-c*v + (u - q*k)"][turn % 2])
    return ModelForm(systems.OSCILLATOR, _POSITION, text, units=_UNITS if turn % 2 else {})


def with_definitions(rng: Rng, turn: int) -> ModelForm:
    named = {"spring": "k*q", "resist": "spring + c*v"}
    inertia = 'v = { v = "m" }' if turn % 2 else ""
    force = "u - resist"
    text = laws(named, inertia, q="v", v=force if inertia else f"({force})/m")
    return ModelForm(systems.OSCILLATOR, {"y": "q", "z": "v"} if turn % 3 else _POSITION, text)


def no_input(rng: Rng, turn: int) -> ModelForm:
    text = ["-w2*sin(q) - c*v", "-(c*v + sin(q)*w2)"][turn % 2]
    return ModelForm(systems.PENDULUM, _POSITION, laws(q="v", v=text))


def rail(rng: Rng, turn: int) -> ModelForm:
    """No spring: errors integrate; two free parameters, or one."""
    inertia = turn % 2
    text = laws(None, 'v = { v = "M" }' if inertia else "", q="v", v="u - Fv*v")
    if not inertia:
        text = laws(q="v", v="(u - Fv*v)/M")
    return ModelForm(systems.RAIL, _POSITION, text, free=("Fv",) if turn % 3 == 0 else None)


def partial_inertia(rng: Rng, turn: int) -> ModelForm:
    text = laws(
        None,
        'v1 = { v1 = "m1" }',
        q1="v1",
        q2="v2",
        v1="u - k1*q1 - c1*v1 - k2*(q1 - q2)",
        v2="(-k2*(q2 - q1) - c2*v2)/m2",
    )
    sensors = {"y1": "q1", "y2": "q2"}
    return ModelForm(systems.MASSES, sensors if turn % 2 == 0 else {"y1": "q1"}, text)


def coupled_inertia(rng: Rng, turn: int) -> ModelForm:
    """A whole mass matrix, in the coordinates q1 and q2 - q1."""
    text = laws(
        None,
        'v1 = { v1 = "m1 + m2", vr = "m2" }\nvr = { v1 = "m2", vr = "m2" }',
        q1="v1",
        r="vr",
        v1="u - k1*q1 - c1*v1 - c2*(v1 + vr)",
        vr="-k2*r - c2*(v1 + vr)",
    )
    plant = replace(
        systems.MASSES,
        states="q1 r v1 vr",
        laws={
            "q1": "v1",
            "r": "vr",
            "v1": "(u - k1*q1 - c1*v1 + k2*r)/m1",
            "vr": "(-k2*r - c2*(v1 + vr))/m2 - (u - k1*q1 - c1*v1 + k2*r)/m1",
        },
        effects={"coulomb_friction": {"v1": "-1.0*sign(v1)/m1", "vr": "1.0*sign(v1)/m1"}},
    )
    return ModelForm(plant, {"y1": "q1", "y2": "q1 + r" if turn % 2 else "r"}, text)


def arm(rng: Rng, turn: int) -> ModelForm:
    inertia = 'w1 = { w1 = "a", w2 = "h*c" }\nw2 = { w1 = "h*c", w2 = "b" }'
    text = laws(
        {"c": "cos(q1 - q2)", "s": "sin(q1 - q2)"},
        inertia,
        q1="w1",
        q2="w2",
        w1="tau1 - d*w1 - G*sin(q1) - h*s*w2**2",
        w2="tau2 - d*w2 + h*s*w1**2",
    )
    sensors = {"y1": "q1", "y2": "q2", **({"s1": "w1", "s2": "w2"} if turn % 2 else {})}
    return ModelForm(systems.ARM, sensors, text)


def _motor(sensors: Mapping[str, str], initial: str, turn: int) -> ModelForm:
    text = [
        laws(i="(u - R*i - Ke*w)/L", w="(Ke*i - b*w)/J", th="w"),
        laws(None, 'w = { w = "J" }\ni = { i = "L" }', i="u - R*i - Ke*w", w="Ke*i - b*w", th="w"),
        laws(None, 'w = { w = "J" }', i="(u - R*i - Ke*w)/L", w="Ke*i - b*w", th="w"),
    ][turn % 3]
    extra = f"[initial]\n{initial}" if initial else ""
    free = ("R", "J", "b") if turn % 2 else None
    return ModelForm(systems.MOTOR, sensors, text, free=free, extra=extra)


def motor_fixed_angle(rng: Rng, turn: int) -> ModelForm:
    return _motor({"yi": "i", "yw": "w"}, "th = 0.0", turn)


def motor_free_angle(rng: Rng, turn: int) -> ModelForm:
    return _motor({"yi": "i", "yw": "w"}, 'th = "free"' if turn % 2 else "", turn)


def motor_hidden_current(rng: Rng, turn: int) -> ModelForm:
    sensors = ({"yt": "th"}, {"yw": "w"}, {"yt": "th", "yw": "w"})[turn % 3]
    return _motor(sensors, ("", "i = 0.0", "i = 0.0\nw = 0.0")[turn % 3], turn)


def heater(rng: Rng, turn: int) -> ModelForm:
    """Two temperatures, one of them with or without a sensor; a heater and the room."""
    if turn % 2:
        inertia = 'T1 = { T1 = "C1" }\nT2 = { T2 = "C2" }'
        text = laws(None, inertia, T1="P - g12*(T1 - T2)", T2="g12*(T1 - T2) - ga*(T2 - Ta)")
    else:
        text = laws(T1="(P - g12*(T1 - T2))/C1", T2="(g12*(T1 - T2) - ga*(T2 - Ta))/C2")
    sensors = ({"y1": "T1", "y2": "T2"}, {"y2": "T2"}, {"y1": "T1"})[turn % 3]
    return ModelForm(systems.HEATER, sensors, text, free=("g12", "ga", "C1"))


def tank(rng: Rng, turn: int) -> ModelForm:
    text = ["(Kp*u - a*sqrt(Max(h, 0)))/A", "Kp*u/A - a/A*sqrt(Max(h, 0))"][turn % 2]
    return ModelForm(systems.TANK, {"level": "h"}, laws(h=text), free=("Kp", "a"))


def integrator(rng: Rng, turn: int) -> ModelForm:
    free = None if turn % 2 else ()
    return ModelForm(systems.LEVEL, {"level": "z"}, laws(z="g*u"), free=free)


def circuit(rng: Rng, turn: int) -> ModelForm:
    units = {"uc": "V", "il": "A", "us": "V", "C": "F", "L": "H", "R": "ohm", "yu": "V", "yi": "A"}
    sensors = ({"yu": "uc"}, {"yi": "il"}, {"yu": "uc", "yi": "il"})[turn % 3]
    used = {k: v for k, v in units.items() if not k.startswith("y") or k in sensors}
    text = laws(uc="il/C", il="(us - uc - R*il)/L")
    return ModelForm(systems.CIRCUIT, sensors, text, units=used if turn % 2 else {})


def three_inputs(rng: Rng, turn: int) -> ModelForm:
    text = laws(
        {"a": "ka*fw"},
        'vx = { vx = "m" }\nvy = { vy = "m" }',
        x="vx",
        vx="fx + a - c*vx - k*x",
        y="vy",
        vy="fy - a - c*vy - k*y",
    )
    sensors = {"px": "x", "py": "y"} if turn % 2 == 0 else {"px": "x"}
    return ModelForm(systems.SLED, sensors, text)


def twelve_parameters(rng: Rng, turn: int) -> ModelForm:
    rows = dict(systems.CHAIN.laws)
    return ModelForm(systems.CHAIN, {"y1": "q1", "y2": "q2", "y3": "q3"}, laws(**rows))


def bouncing_ball(rng: Rng, turn: int) -> ModelForm:
    event = '[[events]]\nwhen = "q"\ndirection = -1\nreset = { v = "-e*v" }'
    if turn % 2:
        text = laws(q="v", v="u - k*(q - 0.3) - c*v")
        return ModelForm(systems.HAMMER, {"h": "q"}, text, extra=event, wild=True)
    return ModelForm(systems.BALL, {"h": "q"}, laws(q="v", v="-g"), extra=event, wild=True)


def accelerometer(rng: Rng, turn: int) -> ModelForm:
    sensors = ({"y": "q", "acc": "d_v"}, {"acc": "d_v"}, {"y": "q", "acc": "d_v"})[turn % 3]
    reading = "(u - k*q - c*v)/m" if turn % 3 == 2 else "d(v)"
    text = laws(q="v", v="(u - k*q - c*v)/m")
    return ModelForm(systems.OSCILLATOR, sensors, text, readings={"acc": reading})


def delays(rng: Rng, turn: int) -> ModelForm:
    extra = ("[delays]\nu = 0.03", "[delays]\ny = 0.03", "[delays]\nu = 'tau'")[turn % 3]
    values = dict(systems.OSCILLATOR.values)
    if turn % 3 == 2:
        values["tau"] = 0.03
    text = laws(q="v", v="(u - k*q - c*v)/m")
    return ModelForm(systems.OSCILLATOR, _POSITION, text, extra=extra, values=values)


def differs_by_file(rng: Rng, turn: int) -> ModelForm:
    names = ("c",) if turn % 2 else ("k", "c")
    text = laws(q="v", v="(u - k*q - c*v)/m")
    return ModelForm(systems.OSCILLATOR, _POSITION, text, per_recording=names)


def all_differ_by_file(rng: Rng, turn: int) -> ModelForm:
    text = laws(q="v", v="(u - k*q - c*v)/m")
    free = None if turn % 2 else ()
    names = ("m", "k", "c")
    return ModelForm(systems.OSCILLATOR, _POSITION, text, free=free, per_recording=names)


def python_field(rng: Rng, turn: int) -> ModelForm:
    rows = ["x[1]", "(u[0] - p['k']*x[0] - p['c']*x[1])/p['m']"]
    body = [
        f"    return jnp.array([{', '.join(rows)}])",
        f"    return jnp.stack([{', '.join(rows)}])",
        "    q, v = x\n    force = u[0] - p['k']*q - p['c']*v\n"
        "    return jnp.array([v, force/p['m']])",
    ][turn % 3]
    source = f"import jax.numpy as jnp\n\n\ndef f(t, x, u, p):\n{body}\n"
    return ModelForm(systems.OSCILLATOR, _POSITION, "", python=source)


def python_arm(rng: Rng, turn: int) -> ModelForm:
    source = (
        "import jax.numpy as jnp\n\n\ndef f(t, x, u, p):\n    q1, q2, w1, w2 = x\n"
        "    c, s = p['h']*jnp.cos(q1 - q2), p['h']*jnp.sin(q1 - q2)\n"
        "    mass = jnp.array([[p['a'], c], [c, p['b']]])\n"
        "    force = jnp.array([u[0] - p['d']*w1 - p['G']*jnp.sin(q1) - s*w2**2,\n"
        "                       u[1] - p['d']*w2 + s*w1**2])\n"
        "    rate = jnp.linalg.solve(mass, force)\n"
        "    return jnp.array([w1, w2, rate[0], rate[1]])\n"
    )
    return ModelForm(systems.ARM, {"y1": "q1", "y2": "q2"}, "", python=source)


def no_free_parameter(rng: Rng, turn: int) -> ModelForm:
    if turn % 2:
        text = laws(q="v", v="(u - 40.0*q - 0.6*v)/1.3")
        return ModelForm(systems.OSCILLATOR, _POSITION, text, values={}, free=())
    return replace(divided(rng, turn), free=())


def populations(rng: Rng, turn: int) -> ModelForm:
    sensors = {"na": "a", "nb": "b"} if turn % 2 == 0 else {"na": "a"}
    text = laws(a="a*(r - s*b)", b="b*(p*a - d)")
    return ModelForm(systems.PREDATORS, sensors, text, wild=True)


def limit_cycle(rng: Rng, turn: int) -> ModelForm:
    text = laws(x="v", v="mu*(1 - x**2)*v - w2*x")
    return ModelForm(systems.VAN_DER_POL, {"y": "x"}, text)


def chaos(rng: Rng, turn: int) -> ModelForm:
    text = laws(x="s*(y - x)", y="x*(r - z) - y", z="x*y - b*z")
    return ModelForm(systems.LORENZ, {"a": "x", "b1": "y", "c1": "z"}, text, wild=True)


def closed_loop(rng: Rng, turn: int) -> ModelForm:
    """Unstable, held by a controller whose output is the recorded input."""
    inputs = {"u": "n - kp*q - kd*v"}
    values = {k: systems.LEAN.values[k] for k in "GcJ"}
    text = laws(q="v", v="G*sin(q) - c*v + u/J")
    return ModelForm(systems.LEAN, _POSITION, text, inputs=inputs, values=values, wild=True)


def hidden_filter(rng: Rng, turn: int) -> ModelForm:
    text = laws(q="v", v="(f - k*q - c*v)/m", f="(u - f)/T")
    extra = ("", "[initial]\nf = 0.0", "[initial]\nq = 0.3\nv = 0.0\nf = 0.0")[turn % 3]
    return ModelForm(systems.VALVE, _POSITION, text, extra=extra)


def not_a_number(rng: Rng, turn: int) -> ModelForm:
    """A law that is no number, or no finite one, where the data goes."""
    law = ["k*q**1.5", "k*sqrt(q)", "k*log(q)", "k*exp(900*q)", "k/(q - q)", "k/q", "k*asin(9*q)"]
    text = laws(q="v", v=f"(u - {law[turn % len(law)]} - c*v)/m")
    why = "the law is no number on the data"
    return ModelForm(systems.OSCILLATOR, _POSITION, text, may_refuse=why)


def bad_inertia(rng: Rng, turn: int) -> ModelForm:
    """Zero, singular, off the diagonal, or singular along the path."""
    rows = [
        'v1 = { v1 = "0" }',
        'v1 = { v1 = "1", v2 = "1" }\nv2 = { v1 = "1", v2 = "1" }',
        'v1 = { v2 = "1" }\nv2 = { v1 = "1" }',
        'v1 = { v1 = "q1" }',
        'v1 = { v1 = "m1 - m1" }',
        'v1 = { v1 = "-m1" }',
    ]
    text = laws(
        None,
        rows[turn % len(rows)],
        q1="v1",
        q2="v2",
        v1="u - k1*q1 - c1*v1 - k2*(q1 - q2)",
        v2="(-k2*(q2 - q1) - c2*v2)/m2",
    )
    sensors = {"y1": "q1", "y2": "q2"}
    return ModelForm(systems.MASSES, sensors, text, may_refuse="the inertia is no mass matrix")


def idle_reading(rng: Rng, turn: int) -> ModelForm:
    """An output that reads an input, a constant, or a square."""
    extra = [{"z": "u"}, {"z": "3.0 + 0*q"}, {"z": "q**2"}, {"z": "Abs(q)"}][turn % 4]
    text = laws(q="v", v="(u - k*q - c*v)/m")
    sensors = extra if turn % 8 >= 4 else {"y": "q", **extra}
    may = "" if turn % 4 >= 2 else "an output tells nothing of a state"
    return ModelForm(systems.OSCILLATOR, sensors, text, may_refuse=may)


def stated_noise(rng: Rng, turn: int) -> ModelForm:
    tables = "[noise]\ny = 1e-3", "[clock]\ny = '1 + s'", "[resolution]\ny = 1e-4"
    values = dict(systems.OSCILLATOR.values)
    if turn % 3 == 1:
        values["s"] = 1e-4
    text = laws(q="v", v="(u - k*q - c*v)/m")
    return ModelForm(systems.OSCILLATOR, _POSITION, text, extra=tables[turn % 3], values=values)


def time_in_law(rng: Rng, turn: int) -> ModelForm:
    text = laws(q="v", v="A*sin(w*t) - k*q - c*v")
    return ModelForm(systems.SHAKEN, _POSITION, text)


def switching_law(rng: Rng, turn: int) -> ModelForm:
    stop = ["ks*Max(q - qs, 0)", "Piecewise((0, q < qs), (ks*(q - qs), True))"][turn % 2]
    return ModelForm(systems.STOP, _POSITION, laws(q="v", v=f"(u - k*q - c*v - {stop})/m"))


def input_hold(rng: Rng, turn: int) -> ModelForm:
    head = {"input_hold": ("zero", "bandlimited")[turn % 2]}
    return replace(with_inertia(rng, turn), head=head)


def no_time_column(rng: Rng, turn: int) -> ModelForm:
    return replace(divided(rng, turn), head={"sample_time": 0.02})


def first_order_speed(rng: Rng, turn: int) -> ModelForm:
    """Order 1: a speed under friction, its position in no equation."""
    plant = replace(systems.RAIL, states="v", start=(0.0,), laws={"v": "(u - Fv*v)/M"})
    inertia = 'v = { v = "M" }' if turn % 2 else ""
    return ModelForm(
        plant, {"y": "v"}, laws(None, inertia, v="u - Fv*v" if inertia else "(u - Fv*v)/M")
    )


def extra_state(rng: Rng, turn: int) -> ModelForm:
    """A state that stands still, or one that nothing reads and nothing needs."""
    law = {"w": "0"} if turn % 2 else {"w": "q"}
    plant = replace(
        systems.OSCILLATOR,
        states="q v w",
        start=(0.3, 0.0, 0.0),
        laws={**systems.OSCILLATOR.laws, **law},
    )
    text = laws(q="v", v="(u - k*q - c*v)/m", **law)
    return ModelForm(plant, _POSITION, text, extra="[initial]\nw = 0.0" if turn % 3 else "")


KINDS: tuple[Callable[[Rng, int], ModelForm], ...] = (
    *(divided, with_inertia, with_definitions, no_input, rail, partial_inertia, coupled_inertia),
    *(arm, motor_fixed_angle, motor_free_angle, motor_hidden_current, heater, tank, integrator),
    *(circuit, three_inputs, twelve_parameters, bouncing_ball, accelerometer, delays),
    *(differs_by_file, all_differ_by_file, python_field, python_arm, no_free_parameter),
    *(populations, limit_cycle, chaos, closed_loop, hidden_filter, not_a_number, bad_inertia),
    *(idle_reading, stated_noise, time_in_law, switching_law, input_hold, no_time_column),
    *(first_order_speed, extra_state),
)
