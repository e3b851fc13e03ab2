"""A case: a system in motion, and an effect of a size that its sensors can show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.generality.detect import Shown, detectable, shown
from benchmarks.generality.law import Motion, log_uniform
from benchmarks.generality.laws import FAMILIES
from benchmarks.generality.places import places, scene, site
from benchmarks.generality.plan import NOTHING, WRONG_VALUE, Ticket
from benchmarks.generality.plant import (
    LEAD,
    Effect,
    Escaped,
    Plant,
    Signal,
    Track,
    excited,
    readings,
)
from benchmarks.generality.sensing import SENSING, Channel, sampled
from benchmarks.generality.system import Array, Gauge, System

SAMPLES, LEARNING, HELD_OUT = 300, 2, 1
SHARES = (0.03, 0.4)
"""Rms of an effect, in that of what it acts upon."""
LARGEST = 0.8
"""Size along the motion that an effect leaves, beyond which it governs the motion and is no more
something that a model left out."""
WRONG = (0.04, 0.4)
"""Relative error of a wrong value."""
MISJUDGED = (0.02, 0.12)
"""Relative error of free values beside missing physics, in half of the cases."""
CLEAR = 60.0
"""Noncentrality up to which another effect is drawn."""
ATTEMPTS = 8
FITTED, NEAR = 3, 0.3
"""Gauss-Newton steps of a fit, and what the first one leaves at most where more are made."""


@dataclass(frozen=True, eq=False)
class Ground:
    """What a case stands on before anything is planted."""

    system: System
    constants: Mapping[str, float]
    gauges: tuple[Gauge, ...]
    signals: tuple[Signal, ...]
    tracks: tuple[Track, ...]
    readings: tuple[Array, ...]
    channels: tuple[Channel, ...]
    seen: tuple[Array, ...]

    @property
    def reach(self) -> Array:
        """Largest size of every state over the recordings, shape (states,)."""
        every = np.concatenate([t.x for t in self.tracks], axis=1)
        return np.abs(every).max(axis=1) + 1e-3 * np.abs(every).max()

    @staticmethod
    def laid(rng: np.random.Generator, ticket: Ticket, system: System, samples: int) -> Ground:
        """Draw constants, inputs and sensors, and integrate the undisturbed motion."""
        gauges = system.inertial if ticket.sensing == "inertial" else system.gauges
        for _ in range(ATTEMPTS):
            constants = system.drawn(rng)
            plant = Plant(system, constants)
            signals = []
            for number in range(LEARNING + HELD_OUT):
                time = sampled(rng, ticket.sensing, system.dt, samples, LEAD)
                signals.append(excited(rng, system.drives, time, system.hold, number))
            try:
                pairs = [readings(plant, s, gauges, s.time[LEAD:]) for s in signals]
            except Escaped:
                continue
            tracks, y = (tuple(items) for items in zip(*pairs, strict=True))
            channels = SENSING[ticket.sensing](rng, gauges, np.concatenate(y[:LEARNING], axis=1))
            empty = [np.array([c.read(rng, 0.0 * r) for c, r in zip(channels, rows, strict=True)])
                     for rows in y]  # fmt: skip
            seen = tuple(np.isfinite(rows) for rows in empty)
            return Ground(
                system, constants, gauges, tuple(signals), tracks, y, tuple(channels), seen
            )
        raise Escaped(f"{system.name}: no motion stays within bounds")

    def shown(self, moved: Sequence[tuple[Track, Array]], constants: Mapping[str, float]) -> Shown:
        """Compare what sensors would read of a motion with the model of some constants."""
        runs = [
            (signal, track, y, seen)
            for signal, (track, y), seen in zip(self.signals, moved, self.seen, strict=False)
        ]
        return shown(self.system, constants, self.gauges, self.channels, runs[:LEARNING])

    def closest(
        self,
        moved: Sequence[tuple[Track, Array]],
        constants: Mapping[str, float],
        free: Sequence[str],
        found: Shown,
    ) -> float:
        """Return the noncentrality where free constants are fitted: Gauss-Newton from `found`."""
        best, change = found.beside(free)
        values = dict(constants)
        for _ in range(FITTED):
            for name, part in zip(free, change, strict=True):
                values[name] *= float(np.exp(np.clip(part, -0.5, 0.5)))
            with np.errstate(all="ignore"):
                found = self.shown(moved, values)
            if not np.isfinite(found.gram).all():
                break
            left, change = found.beside(free)
            best = min(best, left)
        return best

    def doubles(
        self,
        moved: Sequence[tuple[Track, Array]],
        constants: Mapping[str, float],
        free: Sequence[str],
        found: Shown,
        freedom: int,
    ) -> list[str]:
        """Return the constants of which one more, free, explains a motion as well."""
        before, twins = found.left(free), []
        for name in self.system.constants:
            both = [*free, name]
            if name in free or self.system.constants[name].free:
                continue
            if found.left(both) < NEAR * before:
                left = self.closest(moved, constants, both, found)
                if not detectable(left, freedom):
                    twins.append(name)
        return twins

    def moved(self, effect: Effect) -> list[tuple[Track, Array]]:
        """Return motion and readings with an effect, of every recording.

        Raises
        ------
        Escaped
        """
        plant, reach = Plant(self.system, self.constants, effect), self.reach
        if effect.law.kind == "reading":
            tracks = zip(self.tracks, self.readings, strict=True)
            return [(track, _faulty(effect, y)) for track, y in tracks]
        return [readings(plant, s, self.gauges, s.time[LEAD:], reach) for s in self.signals]


def _faulty(effect: Effect, y: Array) -> Array:
    y, k = y.copy(), effect.place[0]
    y[k] = effect.law.act(Motion(0.0, y[k], 0.0), effect.values)
    return y


@dataclass(frozen=True, eq=False)
class Case:
    """A planted case.

    Attributes
    ----------
    truth : dict
        In the form that `benchmarks.concealed.judging` judges by, and the groups.
    given : dict of str to float
        Values of the model file.
    """

    ticket: Ticket
    ground: Ground
    moved: tuple[tuple[Track, Array], ...]
    given: Mapping[str, float]
    truth: dict[str, Any]


def planted(ticket: Ticket, seed: int, system: System, samples: int = SAMPLES) -> Case:
    """Make the case of a ticket.

    Raises
    ------
    Escaped
        No motion of the system stays within bounds.
    """
    rng = ticket.rng(seed)
    ground = Ground.laid(rng, ticket, system, samples)
    plain = tuple(zip(ground.tracks, ground.readings, strict=True))
    if ticket.family == NOTHING:
        return Case(ticket, ground, plain, ground.constants, _truth(ticket, ground, [], {}))
    if ticket.family == WRONG_VALUE:
        return _wrong(rng, ticket, ground, plain)
    return _with_effect(rng, ticket, ground)


def _with_effect(rng: np.random.Generator, ticket: Ticket, ground: Ground) -> Case:
    best: tuple[float, Effect, list[tuple[Track, Array]], Shown, float] | None = None
    free = free_constants(ground.system)
    for _ in range(ATTEMPTS):
        effect = _drawn(rng, ticket, ground)
        if effect is None:
            continue
        try:
            moved = ground.moved(effect)
        except Escaped:
            continue
        found = ground.shown(moved, ground.constants)
        left, share = found.left(free), _share(effect, ground, moved)
        if share > LARGEST:
            continue
        if best is None or left > best[0]:
            best = left, effect, moved, found, share
        if left > CLEAR:
            break
    if best is None:
        raise Escaped(f"{ticket.name}: no effect leaves the motion within bounds")
    left, effect, moved, found, share = best
    law, system = effect.law, ground.system
    sites = [site(system, law, k) for k in effect.place]
    freedom = len([n for n in effect.values if n not in ("begin", "length", "run", "a")])
    left = ground.closest(moved, ground.constants, free, found)
    row = {
        "mechanism": law.mechanism,
        "site": sites[0],
        "sites": sites,
        "family": ticket.family,
        "verdict": law.verdict,
        "size": share,
        "values": {n: float(v) for n, v in effect.values.items()},
        "unchecked": list(law.unchecked),
        # what a change of one constant brings about as well is a wrong value
        "twins": ground.doubles(moved, ground.constants, free, found, freedom),
    }
    given = dict(ground.constants)
    physics = law.verdict in ("structure", "external_input")
    misjudged = physics and bool(rng.uniform() < 0.5)
    if misjudged:
        for name in free:
            change = float(rng.choice([-1.0, 1.0])) * log_uniform(rng, *MISJUDGED)
            given[name] = float(f"{given[name] * (1.0 + change):.4g}")
    evidence = _evidence(ground, found, left, freedom)
    evidence["absorbed"] = bool(
        not evidence["detectable"] and (misjudged or detectable(found.left([]), freedom))
    )
    evidence["indistinct"] = [f"wrong_value of {n}" for n in row["twins"]]
    return Case(ticket, ground, tuple(moved), given, _truth(ticket, ground, [row], evidence))


def _drawn(rng: np.random.Generator, ticket: Ticket, ground: Ground) -> Effect | None:
    """Draw a law of the family, its place and its size."""
    system = ground.system
    options = [
        (law, place)
        for law in FAMILIES[ticket.family]
        for place in places(system, law, ground.gauges)
    ]
    names = sorted({law.mechanism for law, _ in options})
    name = str(rng.choice(names))
    law, place = [o for o in options if o[0].mechanism == name][
        int(rng.integers(sum(o[0].mechanism == name for o in options)))
    ]
    here = scene(
        Plant(system, ground.constants), law, place, ground.tracks[:LEARNING], ground.gauges
    )
    if law.where is not None and not law.where(here):
        return None
    share = log_uniform(rng, *SHARES)
    with np.errstate(all="ignore"):
        values = law.sized(here, law.draw(rng, here), share)
    if not all(np.isfinite(v) for v in values.values()):
        return None
    values = {n: float(f"{v:.5g}") for n, v in values.items()}
    return Effect(law, place, values, here.soft)


def _share(effect: Effect, ground: Ground, moved: Sequence[tuple[Track, Array]]) -> float:
    """Return the size of an effect along the motion that it leaves."""
    plant = Plant(ground.system, ground.constants)
    tracks = [replace(track, x=track.x[: len(ground.system.states)],
                      dx=track.dx[: len(ground.system.states)])
              for track, _ in moved[:LEARNING]]  # fmt: skip
    here = scene(plant, effect.law, effect.place, tracks, ground.gauges)
    return effect.law.size(here, effect.values)


def _wrong(
    rng: np.random.Generator,
    ticket: Ticket,
    ground: Ground,
    plain: tuple[tuple[Track, Array], ...],
) -> Case:
    """Give the file a value that is not the system's."""
    system, free = ground.system, free_constants(ground.system)
    best: tuple[float, str, dict[str, float], Shown] | None = None
    for _ in range(ATTEMPTS):
        name = str(rng.choice(list(system.constants)))
        given = dict(ground.constants)
        change = log_uniform(rng, *WRONG) * float(rng.choice([-1.0, 1.0]))
        given[name] = float(f"{given[name] * (1.0 + change):.4g}")
        try:
            found = ground.shown(plain, given)
        except (FloatingPointError, np.linalg.LinAlgError):
            continue
        left = found.left([n for n in free if n != name])
        if np.isfinite(left) and (best is None or left > best[0]):
            best = left, name, given, found
        if left > CLEAR:
            break
    assert best is not None
    left, name, given, found = best
    others = [n for n in free if n != name]
    twins = [n for n in ground.doubles(plain, given, others, found, 1) if n != name]
    row = {
        "mechanism": WRONG_VALUE,
        "site": f"parameter:{name}",
        "sites": [f"parameter:{n}" for n in (name, *twins)],
        "family": WRONG_VALUE,
        "verdict": "parameter",
        "size": abs(given[name] / ground.constants[name] - 1.0),
        "values": {name: float(ground.constants[name])},
        "unchecked": [],
        "twins": twins,
    }
    evidence = _evidence(ground, found, left, 1)
    evidence["indistinct"] = [f"wrong_value of {n}" for n in twins]
    return Case(ticket, ground, plain, given, _truth(ticket, ground, [row], evidence))


def _evidence(ground: Ground, found: Shown, left: float, freedom: int) -> dict[str, Any]:
    """Return what the sensors can show, and errors of a free run that is told the truth.

    The errors are those of the noise, beside what re-calibration leaves to first order.
    """
    y = np.concatenate(ground.readings[LEARNING:], axis=1)
    parts = [(c.deviation / np.std(row)) ** 2 for c, row in zip(ground.channels, y, strict=True)]
    floor = float(np.sqrt(np.mean(parts)))
    count = int(sum(seen.sum() for seen in ground.seen[:LEARNING]))
    ratio = float(np.sqrt(left / count))
    return {
        "statistic": left,
        "freedom": freedom,
        "detectable": bool(detectable(left, freedom)),
        "absorbed": False,
        "in_noise": ratio,
        "horizons": [float(ground.tracks[0].time[-1])],
        "recalibrated": [floor * float(np.hypot(1.0, ratio))],
        "oracle": [floor],
        "indistinct": [],
    }


def _truth(
    ticket: Ticket, ground: Ground, effects: list[dict[str, Any]], evidence: dict[str, Any]
) -> dict[str, Any]:
    system = ground.system
    return {
        "groups": {"system": system.group, "sensing": ticket.sensing, "mechanism": ticket.family},
        "system": system.name,
        "kind": ticket.family if ticket.family in (NOTHING, WRONG_VALUE) else "single",
        "effects": effects,
        "evidence": evidence or _evidence(ground, _nothing(system), 0.0, 0),
        "turning": [a.state for a in system.axes if a.turning],
        "springs": ["all"] if system.springs else [],
        "sensors": [f"y{k + 1}" for k in range(len(ground.gauges))],
        "constants": dict(ground.constants),
    }


def _nothing(system: System) -> Shown:
    size = len(system.constants) + 1
    return Shown(tuple(system.constants), np.eye(size))


def free_constants(system: System) -> list[str]:
    """Return the constants that may be re-calibrated."""
    return [n for n, c in system.constants.items() if c.free]
