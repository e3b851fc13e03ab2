"""Effects with a state of their own, in the actuator, in time, or in a constant of the plant."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.effects import E, Effect, Look, Scene, on
from benchmarks.concealed.systems import per
from benchmarks.concealed.units import NONE, TIME, times


def memory(rng: np.random.Generator, scene: Scene, mechanism: str, row: int) -> Effect:
    """Return hysteresis, a hidden resonator, drift or an overflow in a row, or a slow actuator."""
    builders = {
        "hysteresis": _hysteresis,
        "hidden_mode": _hidden_mode,
        "drift": _drift,
        "overflow": _overflow,
        "actuator_lag": _lag,
    }
    return builders[mechanism](rng, scene, row)


def _hysteresis(rng: np.random.Generator, scene: Scene, row: int) -> Effect:
    x, force = scene.system.coordinates[row], scene.system.force_dims[row]
    size = rng.uniform(0.15, 0.5) * scene.q_max(row)
    share = rng.uniform(0.5, 0.9)

    def bouc_wen(w: Look, e: E) -> np.ndarray:
        v, z = w.v[row], w.z[0]
        return (e["a"] * v - e["b"] * np.abs(v) * z - e["g"] * v * np.abs(z))[None]

    return Effect(
        "hysteresis",
        "equation",
        row,
        {"kz": 1.0, "a": 1.0, "b": share / size, "g": (1.0 - share) / size},
        {"kz": per(force, x), "b": times(NONE, x, -1), "g": times(NONE, x, -1)},
        ("kz",),
        force=lambda w, e: on(w, row, -e["kz"] * w.z[0]),
        extra=1,
        rates=bouc_wen,
        shape=("a", "b", "g", "kz"),
    )


def _hidden_mode(rng: np.random.Generator, scene: Scene, row: int) -> Effect:
    system = scene.system
    inertia = per(system.force_dims[row], system.coordinates[row], 1, 2)
    pace = float(scene.omega * rng.uniform(0.4, 1.3))
    damping = float(rng.uniform(0.02, 0.1))

    def pull(w: Look, e: E) -> np.ndarray:
        return e["w"] ** 2 * (w.q[row] - w.z[0]) + 2 * e["d"] * e["w"] * (w.v[row] - w.z[1])

    return Effect(
        "hidden_mode",
        "equation",
        row,
        {"m": 1.0, "w": pace, "d": damping},
        {"m": inertia, "w": times(NONE, TIME, -1)},
        ("m",),
        force=lambda w, e: on(w, row, -e["m"] * pull(w, e)),
        extra=2,
        rates=lambda w, e: np.stack([w.z[1], pull(w, e)]),
        shape=("m", "w", "d"),
    )


def _drift(rng: np.random.Generator, scene: Scene, row: int) -> Effect:
    force = scene.system.force_dims[row]
    return Effect(
        "drift",
        "equation",
        row,
        {"d": float(rng.choice([-1.0, 1.0]))},
        {"d": times(force, TIME, -1)},
        ("d",),
        force=lambda w, e: on(w, row, e["d"] * w.t + 0.0 * w.q[row]),
        shape=("d",),
    )


def _overflow(rng: np.random.Generator, scene: Scene, row: int) -> Effect:
    system = scene.system
    led_on = bool(rng.integers(2))
    height = float(np.quantile(scene.q[0], 0.9))

    def spill(w: Look, e: E) -> np.ndarray:
        over = e["ko"] * np.maximum(w.q[0] - e["hm"], 0.0)
        out = on(w, 0, -over)
        if led_on:
            out[1] = over
        return out

    # a weir wide enough that the level hardly rises above it
    width = 2.0 * float(np.ravel(scene.p["f1"])[0])
    return Effect(
        "overflow",
        "equation",
        0,
        {"hm": height, "ko": width},
        {"hm": system.coordinates[0], "ko": per(system.force_dims[0], system.coordinates[0])},
        ("hm",),
        linear=False,
        rising=False,
        force=spill,
        rows=(0, 1),
        shape=("ko",),
    )


def _lag(rng: np.random.Generator, scene: Scene, row: int) -> Effect:
    drive = int(rng.integers(len(scene.system.drives)))
    return Effect(
        "actuator_lag",
        "input",
        drive,
        {"tau": 0.05 / scene.omega},
        {"tau": TIME},
        ("tau",),
        linear=False,
        extra=1,
        rates=lambda w, e: ((w.u[drive] - w.z[0]) / e["tau"])[None],
        drive=lambda w, u, e: w.z[0],
    )


def actuator(rng: np.random.Generator, scene: Scene, mechanism: str, drive: int) -> Effect:
    """Return an effect between the recorded input and the plant."""
    dims = scene.system.drives[drive].dims
    u = scene.u[drive]
    largest = float(np.abs(u).max())
    if mechanism == "input_delay":
        tau = {"tau": 0.05 / scene.omega}
        return Effect(
            mechanism, "input", drive, tau, {"tau": TIME}, ("tau",), linear=False, delay="tau"
        )
    if mechanism == "input_saturation":
        return Effect(
            mechanism,
            "input",
            drive,
            {"us": 0.9 * largest},
            {"us": dims},
            ("us",),
            linear=False,
            rising=False,
            drive=lambda w, u, e: np.clip(u, -e["us"], e["us"]),
        )
    if mechanism == "input_deadzone":
        return Effect(
            mechanism,
            "input",
            drive,
            {"ud": 0.05 * largest},
            {"ud": dims},
            ("ud",),
            linear=False,
            drive=lambda w, u, e: u - np.clip(u, -e["ud"], e["ud"]),
        )
    side = float(rng.choice([-1.0, 1.0]))
    return Effect(
        "input_gain",
        "input",
        drive,
        {"g": 1.0 + 0.05 * side},
        {},
        ("g",),
        linear=False,
        about=1.0,
        drive=lambda w, u, e: e["g"] * u,
    )


def external(rng: np.random.Generator, scene: Scene, mechanism: str, row: int) -> Effect:
    """Return a push in one of the experiments to learn from."""
    width = float(rng.uniform(0.04, 0.12) * scene.length)
    begin = float(rng.uniform(0.15, 0.75) * scene.length)
    which = int(rng.integers(scene.count))

    def push(w: Look, e: E) -> np.ndarray:
        s = (w.t - e["from"]) / e["width"]
        inside = (s > 0) & (s < 1) & (w.run == which)
        wave = np.where(inside, np.sin(np.pi * np.clip(s, 0, 1)) ** 2, 0.0)
        return on(w, row, e["A"] * wave + 0.0 * w.q[row])

    return Effect(
        "transient_force",
        "external",
        row,
        {"A": float(rng.choice([-1.0, 1.0])), "from": begin, "width": width, "run": float(which)},
        {"A": scene.system.force_dims[row], "from": TIME, "width": TIME},
        ("A",),
        force=push,
        shape=("A", "from", "width", "run"),
    )


def wrong_value(rng: np.random.Generator, scene: Scene, mechanism: str, row: int) -> Effect:
    """Return a constant whose true value differs from the one in the model file."""
    constants = [n for n in scene.system.constants if n not in ("w1", "n1", "g0")]
    name = str(rng.choice(constants))
    side = float(rng.choice([-1.0, 1.0]))
    return Effect(
        "wrong_value",
        "parameter",
        list(scene.system.constants).index(name),
        {"ratio": 1.0 + 0.05 * side},
        {},
        ("ratio",),
        linear=False,
        about=1.0,
        replaces=name,
    )
