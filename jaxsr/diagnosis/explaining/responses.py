"""What forces along the equations would do to the readings of a free run, to first order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena, neutral_values
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.reduced import lean, reduce
from jaxsr.models import Simulator
from jaxsr.models.least_squares import Fit
from jaxsr.models.lifting import one_step, readings_along
from jaxsr.models.segments import Segments

Shapes = Callable[[int], np.ndarray]
"""Segment to forces in the middle of its steps, (samples - 1, forces)."""


@dataclass(frozen=True, eq=False)
class Responses:
    """Derivatives along an entry's path, from which responses to any force follow.

    Attributes
    ----------
    sites : tuple of Site
        Equations along which a force may act.
    segments : Segments
    path : ndarray, shape (states, samples, segments)
        States of the entry.
    residual : ndarray, shape (outputs, samples, segments)
    slopes : ndarray, shape (states, states + sites, samples - 1, segments)
        Of every step's end by its start and by a constant force along each equation.
    read : ndarray, shape (outputs, states, samples, segments)
        Of the readings by the states, weighted.
    parts : tuple of Part
    inverse, pull : ndarray
        Inverse Hessian of the free parameters, all starts projected out, and their step.
    """

    sites: tuple[Site, ...]
    segments: Segments
    path: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray
    read: np.ndarray
    parts: tuple[Part, ...]
    inverse: np.ndarray
    pull: np.ndarray

    @staticmethod
    def of(arena: Arena, entry: Entry, sites: tuple[Site, ...]) -> Responses:
        """Differentiate an entry's free run by forces along `sites`."""
        slopes, read = _derivatives(arena, entry, sites)
        segments, fit = arena.problem.segments, entry.fit
        weight = segments.weights / arena.problem.scale[:, None, None]
        parts = tuple(Part.of(fit, s) for s in range(segments.number))
        hessian = np.sum([p.hessian for p in parts], axis=0)
        inverse = np.linalg.pinv(hessian, rcond=1e-10, hermitian=True)
        pull = inverse @ np.sum([p.pull for p in parts], axis=0)
        read = read * weight[:, None]
        assert fit.path is not None
        return Responses(
            sites, segments, fit.path, fit.residual, slopes, read, parts, inverse, pull
        )

    def to(self, site: int, segment: int, shape: np.ndarray) -> np.ndarray:
        """Return the weighted readings' response to forces, (forces, outputs, samples).

        `shape` (samples - 1, forces) has the forces in the middle of every step.
        """
        count = shape.shape[0] + 1
        n = self.slopes.shape[0]
        slopes = self.slopes[:, :, : count - 1, segment]
        step = np.ascontiguousarray(slopes[:, :n].transpose(2, 0, 1))
        enter = slopes[:, n + site].T
        x = np.zeros((count, n, shape.shape[1]))
        for k in range(count - 1):
            np.matmul(step[k], x[k], out=x[k + 1])
            x[k + 1] += enter[k][:, None] * shape[k]
        return np.einsum("oik,kiw->wok", self.read[:, :, :count, segment], x, optimize=True)

    def course(self, state: str) -> np.ndarray:
        """Return a state along the path, wherever an output is measured; shape (samples,)."""
        values = self.path[list(self.sites[0].model.states).index(state)]
        return values[np.isfinite(self.segments.outputs).any(axis=0)]

    def reverses(self, site: Site) -> bool:
        """Whether the motion along a site goes both ways."""
        speed = self.course(site.state)
        return bool(np.quantile(speed, 0.05) < 0.0 < np.quantile(speed, 0.95))

    def gains(self, site: int, shapes: Shapes, together: int) -> tuple[np.ndarray, np.ndarray]:
        r"""How much the cost falls with forces along an equation, all segments together.

        With the readings' responses G to forces that have coefficients of their own, the free
        parameters and the segments' starts projected out, the cost falls to first order by
        :math:`r^T G (G^T G)^{-1} G^T r`.

        Parameters
        ----------
        shapes : callable
            Segment to the forces in the middle of its steps, (samples - 1, together * choices),
            the first of every choice before the second of every choice.
        together : int
            Forces that act at once, each with a coefficient.

        Returns
        -------
        gains : ndarray, shape (choices,)
        coefficients : ndarray, shape (choices, together)
        """
        power = raw = cross = score = np.zeros(())
        for s in range(self.segments.number):
            g = self.to(site, s, shapes(s))
            seen = self.parts[s].projected(g, self.residual[:, : g.shape[-1], s])
            number = len(g) // together
            flat = seen.flat.reshape(together, number, -1)
            power = power + np.einsum("awr,bwr->wab", flat, flat, optimize=True)
            raw = raw + seen.raw.reshape(together, number).sum(0)
            cross = cross + seen.cross.reshape(together, number, -1).transpose(1, 0, 2)
            score = score + seen.score.reshape(together, number).T
        power = power - np.einsum("wap,pq,wbq->wab", cross, self.inverse, cross, optimize=True)
        score = score - cross @ self.pull
        small = 1e-4 * raw + 1e-300
        clear = np.trace(power, axis1=1, axis2=2) > small
        power += small[:, None, None] * np.eye(together) * 1e-2
        coefficients = np.linalg.solve(power, score[..., None])[..., 0]
        gains = np.where(clear, np.sum(score * coefficients, axis=1), 0.0)
        return np.maximum(gains, 0.0), coefficients


def _derivatives(
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


@dataclass(frozen=True, eq=False)
class Part:
    """One segment's derivatives by its start and the parameters, flattened over its readings."""

    starts: np.ndarray
    inverse: np.ndarray
    thetas: np.ndarray
    hessian: np.ndarray
    pull: np.ndarray

    @staticmethod
    def of(fit: Fit, s: int) -> Part:
        rows = fit.residual[..., s].size
        starts = fit.by_start[..., s].reshape(len(fit.by_start), rows)
        thetas = fit.jacobian[..., s].reshape(len(fit.jacobian), rows)
        inverse = np.linalg.pinv(starts @ starts.T, rcond=1e-12, hermitian=True)
        thetas = thetas - (thetas @ starts.T) @ inverse @ starts
        residual = fit.residual[..., s].ravel()
        return Part(starts, inverse, thetas, thetas @ thetas.T, thetas @ residual)

    def projected(self, g: np.ndarray, residual: np.ndarray) -> Seen:
        """Return responses `g` (forces, outputs, samples) beside the start and the parameters."""
        outputs, samples = residual.shape
        rows = self.starts.shape[1] // outputs
        flat = np.zeros((g.shape[0], outputs, rows))
        flat[..., :samples] = g
        flat = flat.reshape(g.shape[0], -1)
        whole = np.zeros((outputs, rows))
        whole[:, :samples] = residual
        raw = np.einsum("wr,wr->w", flat, flat)
        flat -= (flat @ self.starts.T) @ self.inverse @ self.starts
        return Seen(flat, raw, flat @ self.thetas.T, flat @ whole.ravel())


@dataclass(frozen=True, eq=False)
class Seen:
    """Responses of a segment with its start projected out.

    Attributes
    ----------
    flat : ndarray, shape (forces, readings)
    raw : ndarray, shape (forces,)
        Power before the projection.
    cross : ndarray, shape (forces, parameters)
        Products with the derivatives by the parameters.
    score : ndarray, shape (forces,)
        Products with the residual.
    """

    flat: np.ndarray
    raw: np.ndarray
    cross: np.ndarray
    score: np.ndarray
