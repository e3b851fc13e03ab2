"""Where in a system a law may act, what that place is called, and the motion there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.generality.law import Law, Scene
from benchmarks.generality.plant import Plant, Track, gauge_of
from benchmarks.generality.system import Array, Axis, Gauge, System

Place = tuple[int, ...]


def places(system: System, law: Law, gauges: Sequence[Gauge] | None = None) -> list[Place]:
    """Return the places of a law, by the names of which it could be told from others."""
    if law.mechanism in system.without:
        return []
    if law.kind in ("drive", "late_drive"):
        return [(k,) for k, d in enumerate(system.drives.values()) if d.actuator]
    if law.kind in ("reading", "instants"):
        gauges = system.gauges if gauges is None else gauges
        # one sensor's own time is no other than that of the recording
        return [(k,) for k in range(len(gauges))] if law.kind == "reading" or gauges[1:] else []
    if law.kind == "pair":
        return list(system.pairs)
    return [(k,) for k, axis in enumerate(system.axes) if _fits(axis, law)]


def _fits(axis: Axis, law: Law) -> bool:
    if law.mechanism in axis.without:
        return False
    if law.mechanism == "asymmetric_friction":
        # it stands beside viscous friction
        return "viscous_damping" in axis.without
    needed = {"position": bool(axis.position), "turning": bool(axis.position) and axis.turning}
    return needed.get(law.needs, True)


def site(system: System, law: Law, index: int) -> str:
    """Return the site as CONTRACT.md, section 4, writes it."""
    if law.kind in ("drive", "late_drive"):
        return f"input:{list(system.drives)[index]}"
    if law.kind in ("reading", "instants"):
        return f"output:y{index + 1}"
    kind = "external" if law.verdict == "external_input" else "equation"
    return f"{kind}:{system.axes[index].state}"


def scene(
    plant: Plant, law: Law, place: Place, tracks: Sequence[Track], gauges: Sequence[Gauge]
) -> Scene:
    """Return the undisturbed motion of the recordings to learn from, at a place."""
    system = plant.system
    t = np.concatenate([track.time for track in tracks])
    run = np.concatenate([np.full(track.time.size, r) for r, track in enumerate(tracks)])
    x, dx, u = (np.concatenate([getattr(k, n) for k in tracks], axis=1) for n in ("x", "dx", "u"))
    same = {
        "dt": system.dt,
        "duration": float(tracks[0].time[-1]),
        "runs": len(tracks),
    }
    if law.kind in ("drive", "late_drive"):
        return Scene(t, run, u=u[place[0]], **same)
    if law.kind in ("reading", "instants"):
        y = gauge_of(system, gauges[place[0]], x, dx)
        return Scene(t, run, y=y, v=np.gradient(y), **same)
    q, v = np.zeros(t.size), np.zeros(t.size)
    for sign, axis in zip((1.0, -1.0), place, strict=False):
        own = system.axes[axis]
        v = v + sign * x[system.index(own.state)]
        q = q + (sign * x[system.index(own.position)] if own.position else 0.0)
    k = system.index(system.axes[place[0]].state)
    per_force = _mobility(plant, x, u)[place[0]][k]
    net = float(np.sqrt(np.mean((dx[k] / per_force) ** 2)))
    if law.kind == "inertia":
        v = dx[k]
    return Scene(t, run, q=q, v=v, net=net, **same)


def _mobility(plant: Plant, x: Array, u: Array) -> list[Array]:
    """Return the change of the rates (states, samples) by a unit force along every axis."""
    axes = len(plant.system.axes)
    none = np.zeros((axes, x.shape[1]))
    base = np.array(plant.system.motion(x, u, plant.constants, none), dtype=float)
    found = []
    for k in range(axes):
        force = none.copy()
        force[k] = 1.0
        found.append(np.array(plant.system.motion(x, u, plant.constants, force)) - base)
    return found
