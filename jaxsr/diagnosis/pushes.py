"""Pushes from outside, located in free run: where and when one would lower the cost most."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.candidates import Candidate, ParameterSpec, SuperModel
from jaxsr.diagnosis.contest import Arena, Entry, build_arena, neutral_values
from jaxsr.diagnosis.decide import independent_residuals
from jaxsr.diagnosis.mechanisms.external import CONCENTRATED, LONGEST, push
from jaxsr.diagnosis.mechanisms.site import Site, sites_of
from jaxsr.diagnosis.reduced import lean, reduce
from jaxsr.models import Simulator
from jaxsr.models.least_squares import Fit
from jaxsr.models.lifting import liftable, one_step, readings_along

SURE = 16.0
"""Statistic of a push beyond what the best of all windows reaches by chance, 2 log(windows)."""
MOST = 2
CENTRES = 100
"""Centres looked at in a segment for each width."""
SHORTEST = 4.0
"""Shortest push in samples."""


@dataclass(frozen=True)
class _Push:
    """A window in one recording and what a push there gains."""

    site: Site
    recording: int
    centre: float
    width: float
    gain: float


def with_pushes(arena: Arena, entries: list[Entry]) -> tuple[Arena, list[Entry]]:
    """Return the arena and its entries with candidates for pushes that stand out."""
    null = next(e for e in entries if not e.members)
    old = arena.super_model
    simulator = arena.problem.simulator
    if not liftable(simulator) or null.fit.path is None or not null.fit.usable:
        return arena, entries
    candidates = push_candidates(arena, null)
    if not candidates:
        return arena, entries
    super_model = SuperModel.build(old.given, [*old.candidates, *candidates])
    new = build_arena(
        super_model,
        arena.prepared,
        arena.problem.stepping,
        arena.seconds,
        arena.problem.scale,
        Simulator(super_model.model),
    )
    added = neutral_values(super_model)[len(old.model.parameters) :]
    longer = [
        replace(e, fit=replace(e.fit, theta=np.concatenate([e.fit.theta, added]))) for e in entries
    ]
    return replace(new, patience=arena.patience), longer


def push_candidates(arena: Arena, entry: Entry) -> list[Candidate]:
    r"""Propose pushes in single recordings beside an entry.

    A force of Gaussian shape along an equation, in the window (t0, dt) of one recording, moves
    the readings by J g; free parameters and the segment's start, which move along, are projected
    out of g. To first order the cost falls by :math:`(g^T r)^2 / g^T g`, which is compared with
    what windows usually gain and with the best of as many windows of noise.
    """
    model = arena.super_model.given
    sites = sites_of(model, {})
    found, gains = [], []
    for push_, gain in _scanned(arena, entry, sites):
        found.append(push_)
        gains.append(gain)
    if not found:
        return []
    every = np.concatenate(gains)
    noise = entry.fit.cost / independent_residuals(entry)
    # Where more than noise is left, windows usually gain more than chi-squared's median.
    noise *= max(float(np.median(every)) / noise / 0.455, 1.0)
    sure = noise * (SURE + 2.0 * np.log(every.size))
    single = len(arena.prepared) == 1
    least = max(sure, CONCENTRATED * entry.fit.cost if single else 0.0)
    best = sorted((p for p in found if p.gain > least), key=lambda p: -p.gain)
    names = [p.recording.name for p in arena.prepared]
    chosen: dict[tuple[str, int], _Push] = {}
    for item in best:
        chosen.setdefault((item.site.state, item.recording), item)
    return [
        push(
            p.site,
            p.centre,
            p.width,
            tuple(n for n in names if n != names[p.recording]),
            every.size,
        )
        for p in list(chosen.values())[:MOST]
    ]


def _scanned(
    arena: Arena, entry: Entry, sites: tuple[Site, ...]
) -> Iterator[tuple[_Push, np.ndarray]]:
    """Yield the best push of every equation, segment and width, and the gains of all windows."""
    slopes, read = _responses(arena, entry, sites)
    segments, fit = arena.problem.segments, entry.fit
    weight = segments.weights / arena.problem.scale[:, None, None]
    parts = [_Part.of(fit, s) for s in range(segments.number)]
    hessian = np.sum([p.hessian for p in parts], axis=0)
    inverse = np.linalg.pinv(hessian, rcond=1e-10, hermitian=True)
    pull = inverse @ np.sum([p.pull for p in parts], axis=0)
    longest = LONGEST * max(float(p.time[-1] - p.time[0]) for p in arena.prepared) / 2.0
    for s, part in enumerate(parts):
        count = int(segments.count[s])
        time = segments.time[:count, s]
        step = float(np.median(np.diff(time)))
        shortest = SHORTEST * step
        for width in np.geomspace(shortest, max(longest, shortest), 4):
            span = time[-1] - time[0] - width
            if span <= 0:
                continue
            number = int(np.clip(span / width * 2.0, 1, CENTRES))
            centres = time[0] + width / 2.0 + span * (np.arange(number) + 0.5) / number
            middle = 0.5 * (time[1:] + time[:-1])
            shape = np.exp(-(((middle[:, None] - centres) / width) ** 2)) / width / np.sqrt(np.pi)
            for j, site in enumerate(sites):
                g = _readings(slopes[:, :, : count - 1, s], j, read[:, :, :count, s], shape)
                g = (g * weight[:, None, :count, s]).transpose(1, 0, 2)
                gains = part.gains(g, fit.residual[:, :count, s], inverse, pull)
                k = int(np.argmax(gains))
                best = _Push(
                    site, int(segments.recording[s]), float(centres[k]), width, float(gains[k])
                )
                yield best, gains


def _responses(
    arena: Arena, entry: Entry, sites: tuple[Site, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of every step by its start and by a force along each equation; of readings."""
    forces = [
        Candidate(
            "constant_force",
            "inertial",
            site.name,
            (ParameterSpec("F0", site.force_unit),),
            "",
            terms=((site.state, "+ {F0}"),),
        )
        for site in sites
    ]
    old = arena.super_model
    members = entry.members
    beside = [old.candidates[i] for i in members]
    super_model = SuperModel.build(old.given, [*beside, *forces])
    simulator = Simulator(super_model.model)
    own = reduce(arena.problem, old, members)
    thin = lean(old, arena.problem.simulator, arena.problem.stepping, members)
    theta = np.concatenate(
        [entry.fit.theta[own.parameters], neutral_values(super_model)[own.parameters.size :]]
    )
    active = [
        super_model.index(len(beside) + j, coefficients_only=True)[0] for j in range(len(sites))
    ]
    assert entry.fit.path is not None
    path = entry.fit.path[own.states]
    override = np.full((theta.size, path.shape[-1]), np.nan)
    override[: own.parameters.size] = own.problem.segments.override
    segments = replace(own.problem.segments, override=override)
    slopes = one_step(simulator, thin.stepping, segments, theta, path, active)[1]
    read = readings_along(simulator, thin.stepping, segments, theta, path)[1]
    return slopes, read


def _readings(slopes: np.ndarray, force: int, read: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Response of the readings of a segment to pushes, shape (outputs, windows, samples).

    `slopes` (states, states + equations, samples - 1), `read` (outputs, states, samples), `shape`
    (samples - 1, windows).
    """
    n = slopes.shape[0]
    step = np.ascontiguousarray(slopes[:, :n].transpose(2, 0, 1))
    enter = slopes[:, n + force].T
    x = np.zeros((shape.shape[0] + 1, n, shape.shape[1]))
    for k in range(shape.shape[0]):
        np.matmul(step[k], x[k], out=x[k + 1])
        x[k + 1] += enter[k][:, None] * shape[k]
    return np.einsum("oik,kiw->owk", read, x)


@dataclass(frozen=True, eq=False)
class _Part:
    """One segment's derivatives by its start and the parameters, flattened over its readings."""

    starts: np.ndarray
    inverse: np.ndarray
    thetas: np.ndarray
    hessian: np.ndarray
    pull: np.ndarray

    @staticmethod
    def of(fit: Fit, s: int) -> _Part:
        rows = fit.residual[..., s].size
        starts = fit.by_start[..., s].reshape(len(fit.by_start), rows)
        thetas = fit.jacobian[..., s].reshape(len(fit.jacobian), rows)
        inverse = np.linalg.pinv(starts @ starts.T, rcond=1e-12, hermitian=True)
        thetas = thetas - (thetas @ starts.T) @ inverse @ starts
        residual = fit.residual[..., s].ravel()
        return _Part(starts, inverse, thetas, thetas @ thetas.T, thetas @ residual)

    def gains(
        self, g: np.ndarray, residual: np.ndarray, inverse: np.ndarray, pull: np.ndarray
    ) -> np.ndarray:
        """How much the cost falls with each of the responses `g`, (windows, outputs, samples)."""
        outputs, samples = residual.shape
        rows = self.starts.shape[1] // outputs
        flat = np.zeros((g.shape[0], outputs, rows))
        flat[..., :samples] = g
        flat = flat.reshape(g.shape[0], -1)
        whole = np.zeros((outputs, rows))
        whole[:, :samples] = residual
        raw = np.einsum("wr,wr->w", flat, flat)
        flat -= (flat @ self.starts.T) @ self.inverse @ self.starts
        cross = flat @ self.thetas.T
        power = np.einsum("wr,wr->w", flat, flat) - np.einsum("wp,pq,wq->w", cross, inverse, cross)
        score = flat @ whole.ravel() - cross @ pull
        seen = power > 1e-4 * raw
        return np.where(seen, score**2 / np.where(seen, power, 1.0), 0.0)
