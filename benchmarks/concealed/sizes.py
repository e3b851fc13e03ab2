"""How strong an effect is, and its constants for a wanted strength."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.effects import Effect, Look, Scene
from benchmarks.concealed.systems import Array, total_force

REACH = 0.45
"""Largest relative change of a gain or of a plant's constant."""


def strength(effect: Effect, scene: Scene, clean: Array | None = None, shape: tuple = ()) -> float:
    """Return the effect's rms along the undisturbed motion, relative to what it acts on.

    A force: relative to the rms of the force that accelerates its row (the largest ratio of all
    rows). An effect on an input or a sensor: relative to the rms of the input or reading about its
    rest or mean. A push: within its window.

    Parameters
    ----------
    clean : ndarray, shape (samples, experiments)
        Undisturbed reading, for the effect of a sensor.
    shape : (samples, experiments)
    """
    if effect.kind == "output":
        assert clean is not None
        return _of_reading(effect, clean, scene)
    if effect.kind == "input":
        u = scene.u[effect.index]
        return scene.rms(_driven(effect, scene, shape) - u) / max(float(u.std()), 1e-300)
    force = _force(effect, scene, shape)
    ratios = []
    for row in range(scene.system.size):
        signal = force[row]
        if effect.kind == "external":
            signal = signal[np.abs(force[effect.index]) > 0]
        if signal.size and scene.f_rms(row) > 0:
            ratios.append(scene.rms(signal) / scene.f_rms(row))
    return max(ratios, default=0.0)


def _look(effect: Effect, scene: Scene, z: Array) -> Look:
    run = np.zeros(scene.t.size, int)
    if effect.kind == "external":
        run = run + int(effect.values["run"])
    return Look(scene.t, scene.q, scene.v, scene.u, z, scene.p, run)


def _force(effect: Effect, scene: Scene, shape: tuple) -> Array:
    if effect.replaces is not None:
        wrong = dict(scene.p)
        wrong[effect.replaces] = scene.p[effect.replaces] * effect.values["ratio"]
        out = np.zeros_like(scene.q)
        for sign, p in ((1.0, scene.p), (-1.0, wrong)):
            out += sign * total_force(scene.system, scene.q, scene.v, scene.u, p)
            for i, line in enumerate(scene.system.mass(scene.q, p)):
                out[i] -= sign * sum(m * scene.a[j] for j, m in enumerate(line))
        return out
    if effect.inertia is not None:
        out = np.zeros_like(scene.q)
        out[effect.index] = -effect.values[effect.inertia] * scene.a[effect.index]
        return out
    assert effect.force is not None
    z = own_states(effect, scene, shape) if effect.extra else np.zeros((0, scene.t.size))
    return effect.force(_look(effect, scene, z), effect.values)


def own_states(effect: Effect, scene: Scene, shape: tuple, parts: int = 6) -> Array:
    """Integrate an effect's own states along the undisturbed motion (midpoint rule)."""
    samples, runs = shape
    t, q, v, u = (
        a.reshape(*a.shape[:-1], samples, runs) for a in (scene.t, scene.q, scene.v, scene.u)
    )
    dt = float(t[1, 0] - t[0, 0])
    z = np.zeros((effect.extra, runs))
    if effect.mechanism == "hidden_mode":
        z[0] = q[effect.index, 0]
    out = np.empty((effect.extra, samples, runs))
    assert effect.rates is not None
    for k in range(samples):
        out[:, k] = z
        if k == samples - 1:
            break
        for j in range(parts):
            looks = []
            for s in (j / parts, (j + 0.5) / parts):
                mixed = [a[..., k, :] * (1 - s) + a[..., k + 1, :] * s for a in (t, q, v, u)]
                looks.append((mixed, s))
            h = dt / parts
            first = effect.rates(_at(looks[0][0], z, scene), effect.values)
            z = z + h * effect.rates(_at(looks[1][0], z + 0.5 * h * first, scene), effect.values)
    return out.reshape(effect.extra, -1)


def _at(mixed: list[Array], z: Array, scene: Scene) -> Look:
    t, q, v, u = mixed
    return Look(t, q, v, u, z, scene.p, 0)


def _driven(effect: Effect, scene: Scene, shape: tuple) -> Array:
    u = scene.u[effect.index]
    if effect.delay is not None:
        t, wave = scene.t.reshape(shape), u.reshape(shape)
        tau = effect.values[effect.delay]
        late = [
            np.interp(t[:, e] - tau, t[:, e], wave[:, e], left=wave[0, e]) for e in range(shape[1])
        ]
        return np.stack(late, axis=1).ravel()
    assert effect.drive is not None
    if effect.extra:
        return _lagging(u.reshape(shape), effect.values["tau"], scene.length / shape[0])
    return effect.drive(_look(effect, scene, np.zeros((0, u.size))), u, effect.values)


def _lagging(u: Array, tau: float, dt: float) -> Array:
    """Return u behind a first-order lag, exact for inputs that are linear between samples."""
    keep = np.exp(-dt / tau)
    z = np.empty_like(u)
    z[0] = u[0]
    for k in range(len(u) - 1):
        slope = (u[k + 1] - u[k]) / dt
        z[k + 1] = u[k + 1] - tau * slope + (z[k] - u[k] + tau * slope) * keep
    return z.ravel()


def _of_reading(effect: Effect, clean: Array, scene: Scene) -> float:
    if effect.reading is not None:
        changed = effect.reading(clean, effect.values)
    else:
        k = np.arange(clean.shape[0], dtype=float)
        dt = scene.length / clean.shape[0]
        if effect.clock is not None:
            place = k * (1.0 + effect.values[effect.clock])
        else:
            assert effect.delay is not None
            place = k - effect.values[effect.delay] / dt
        columns = [np.interp(place, k, column) for column in clean.T]
        changed = np.stack(columns, axis=1)
    return scene.rms(changed - clean) / max(float(clean.std()), 1e-300)


def sized(
    effect: Effect, scene: Scene, target: float, clean: Array | None = None, shape: tuple = ()
) -> Effect:
    """Return the effect with the constants that give it the strength `target`, or the nearest."""

    def measured(factor: float) -> float:
        return strength(effect.scaled(factor), scene, clean, shape)

    if effect.linear:
        return effect.scaled(target / max(measured(1.0), 1e-300))
    low, high = (-9.0, 9.0) if effect.rising else (-7.0, 1.0)
    if effect.about == 1.0:
        name = effect.masters[0]
        high = float(np.log(REACH / abs(effect.values[name] - 1.0)))
    for _ in range(40):
        middle = 0.5 * (low + high)
        larger = measured(float(np.exp(middle))) > target
        if larger == effect.rising:
            high = middle
        else:
            low = middle
    return effect.scaled(float(np.exp(0.5 * (low + high))))
