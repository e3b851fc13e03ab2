"""The contest: sets of candidates estimated in free run and compared on held-back blocks."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.stats

from jaxsr.diagnosis.candidates import SuperModel
from jaxsr.diagnosis.integration import accurate, steady
from jaxsr.diagnosis.reduced import cropped, reduce
from jaxsr.models import Model
from jaxsr.models.driven import known_states
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.lifting import liftable
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, Segments, build_segments, cut
from jaxsr.models.shooting import fit
from jaxsr.models.simulator import Simulator

BLOCKS = 12
CONTEST_TOLERANCE = 1e-4
"""Gain in cost at which the estimation of a set stops: far below `MIN_GAIN`."""
ITERATIONS = 30
MARGIN = 25
"""Samples simulated before and after a segment where signals are delayed or remembered: the
longest delay that a segment can tell."""
REFRESHES = 1
"""Times that the starts of driven states are renewed at the latest parameters."""
MIN_GAIN = 0.05
"""Smallest gain in log held-back mean square that counts, whatever its significance: smoothing
sign() alone can move the error of a friction model by half of it."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One set of candidates after estimation in free run.

    Attributes
    ----------
    members : tuple of int
    fit : Fit
    errors : ndarray, shape (blocks,)
        Mean squared scaled residual of each block, estimated without it.
    stepping : Stepping, optional
        How its own laws were integrated.
    """

    members: tuple[int, ...]
    fit: Fit
    errors: np.ndarray
    stepping: Stepping | None = None

    @property
    def error(self) -> float:
        """Geometric mean over the blocks."""
        return float(np.exp(np.mean(np.log(self.errors + 1e-300))))

    def scaled(self, factor: float) -> Entry:
        """Return the entry with residuals divided by a factor."""
        fitted = self.fit
        fitted = replace(
            fitted,
            cost=fitted.cost / factor**2,
            residual=fitted.residual / factor,
            jacobian=fitted.jacobian / factor,
            by_start=fitted.by_start / factor,
        )
        return replace(self, fit=fitted, errors=self.errors / factor**2)


@dataclass(frozen=True, eq=False)
class Arena:
    """What all entries share: the super-model, its segments, and the blocks held back in turn."""

    super_model: SuperModel
    problem: Problem
    prepared: tuple[Prepared, ...]
    bounds: tuple[np.ndarray, np.ndarray]
    pieces: tuple[tuple[int, int, int, int], ...]  # (block, segment, from sample, to sample)
    seconds: float  # length of the segments
    wide: Problem | None = None  # the same with margins, for signals that come late
    patience: float = np.inf  # seconds after which the estimation of a set stops


def parameter_bounds(super_model: SuperModel) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of every parameter of the super-model."""
    order = list(super_model.model.parameters.items())
    low = np.array([p.bounds[0] if p.bounds else -np.inf for _, p in order])
    high = np.array([p.bounds[1] if p.bounds else np.inf for _, p in order])
    names = [n for n, _ in order]
    for candidate in super_model.candidates:
        if candidate.fixed_parameter is not None:
            at, spec = names.index(candidate.fixed_parameter), candidate.parameters[0]
            low[at], high[at] = spec.low, spec.high
    return low, high


def neutral_values(super_model: SuperModel) -> np.ndarray:
    """Parameter values at which the super-model is the given model."""
    return np.array([p.value for p in super_model.model.parameters.values()], dtype=float)


def build_arena(
    super_model: SuperModel,
    prepared: Sequence[Prepared],
    stepping: Stepping,
    horizon: float | None,
    scale: np.ndarray,
    simulator: Simulator,
) -> Arena:
    """Cut the recordings into segments of `horizon` seconds and lay out the blocks."""
    rows = cut(prepared, horizon)
    model, steps = super_model.model, stepping.substeps
    segments = build_segments(model, prepared, rows, steps)
    wide = None
    if model.driven or _shifts(model):
        margins = build_segments(model, prepared, rows, steps, margin=MARGIN)
        if liftable(simulator):
            # All sets are judged on the samples that those with margins can tell.
            wide = Problem(simulator, stepping, margins, scale)
            segments = _as_far_as(segments, margins)
        else:
            segments = margins
    problem = Problem(simulator, stepping, segments, scale)
    pieces = _pieces(segments.count)
    bounds = parameter_bounds(super_model)
    return Arena(super_model, problem, tuple(prepared), bounds, pieces, horizon or np.inf, wide)


def _as_far_as(narrow: Segments, wide: Segments) -> Segments:
    """Leave out the samples that are left out of the segments with margins."""
    rows = np.arange(narrow.time.shape[0])[:, None] + narrow.start - wide.start
    rows = np.minimum(rows, wide.time.shape[0] - 1)
    known = np.isfinite(wide.outputs[:, rows, np.arange(narrow.number)[None, :]])
    return replace(narrow, outputs=np.where(known, narrow.outputs, np.nan))


def _shifts(model: Model) -> bool:
    """Whether a delay or a clock can be estimated."""
    return bool(model.clock) or any(isinstance(d, str) for d in model.delays.values())


def _pieces(counts: np.ndarray) -> tuple[tuple[int, int, int, int], ...]:
    """Assign segments, or stretches of them where they are few, to blocks."""
    if counts.size >= 8:
        block = np.minimum(np.arange(counts.size) * BLOCKS // counts.size, BLOCKS - 1)
        return tuple((int(block[s]), s, 0, int(n)) for s, n in enumerate(counts))
    each = int(np.ceil(BLOCKS / counts.size))
    pieces, number = [], 0
    for s, count in enumerate(counts):
        edges = np.linspace(0, count, each + 1).astype(int)
        for a, b in pairwise(edges):
            if b - a >= 2:
                pieces.append((number, s, int(a), int(b)))
                number += 1
    return tuple(pieces)


def enter(
    arena: Arena,
    members: tuple[int, ...],
    start: np.ndarray,
    path: np.ndarray | None = None,
    stop: Callable[[], bool] = lambda: False,
    max_iterations: int = ITERATIONS,
    near: bool = False,
) -> Entry:
    """Estimate one set jointly with the free parameters and the starts, and hold blocks back.

    `path` is where the states are sought, as another entry's fit has them; `near` says that they
    are nearly there.
    """
    super_model = arena.super_model
    problem = arena.problem
    end = time.monotonic() + arena.patience
    late = arena.wide is not None and late_members(super_model, members)
    if late and arena.wide is not None:
        problem = replace(arena.wide, scale=problem.scale)
        path = None if path is None else _extended(path, arena.problem.segments, problem.segments)
    own = reduce(problem, super_model, members)
    low, high = (bound[own.parameters] for bound in arena.bounds)
    active = own.active(active_parameters(super_model, members))
    theta = super_model.switched(members, start)
    inner, course = theta[own.parameters], None if path is None else path[own.states]
    careful = max_iterations >= ITERATIONS and _steps_matter(arena, members)
    if careful:
        own = replace(own, problem=steady(own.problem, inner))
        if near and course is not None:
            own = replace(own, problem=accurate(own.problem, inner, course))

    def late_or(stop: Callable[[], bool]) -> bool:
        return stop() or time.monotonic() > end

    def estimate(x0: np.ndarray | None, near: bool) -> Fit:
        limits = max_iterations, lambda: late_or(stop), CONTEST_TOLERANCE
        return fit(own.problem, inner, active, (low, high), x0, *limits, course, near)

    for _ in range(1 + REFRESHES * super_model.remembers(members)):
        driven = own.problem.simulator.model.driven
        x0 = None
        if driven:
            x0 = _driven(arena, own.problem, inner, None if course is None else course[:, 0])
        result = estimate(x0, near)
        moved = np.abs(result.theta - inner) > 1e-3 * np.abs(inner)
        inner, course = result.theta, result.path
        if not driven or not moved.any() or not result.usable:
            break
    if careful and result.usable and course is not None and not late_or(stop):
        finer = accurate(steady(own.problem, inner), inner, course)
        if finer.stepping != own.problem.stepping:
            own = replace(own, problem=finer)
            again = estimate(None, near=True)
            result = again if again.usable else result
    segments = problem.segments
    result = own.restored(result, theta, segments)
    if late:
        result = cropped(result, problem, arena.problem.segments)
    return Entry(members, result, held_back(arena, result), own.problem.stepping)


def _steps_matter(arena: Arena, members: tuple[int, ...]) -> bool:
    """Whether a member's law jumps, but for hard edges, which have a method of their own."""
    chosen = [arena.super_model.candidates[i] for i in members]
    sharp = any(c.sharp for c in chosen) and not any(c.stiff for c in chosen)
    return sharp and liftable(arena.problem.simulator)


def _extended(path: np.ndarray, narrow: Segments, wide: Segments) -> np.ndarray:
    """A path in segments with margins: where the states are known there, and the path inside."""
    result = wide.course.copy()
    for s, (first, count) in enumerate(zip(narrow.start - wide.start, narrow.count, strict=True)):
        result[:, first : first + count, s] = path[:, :count, s]
    return result


def late_members(super_model: SuperModel, members: Sequence[int]) -> bool:
    """Whether a member shifts signals in time or remembers them."""
    return shifting_members(super_model, members) or super_model.remembers(members)


def shifting_members(super_model: SuperModel, members: Sequence[int]) -> bool:
    """Whether a member shifts signals in time."""
    chosen = [super_model.candidates[i] for i in members]
    return any(c.delays or c.clock for c in chosen)


def _driven(arena: Arena, problem: Problem, theta: np.ndarray, x0: np.ndarray | None) -> np.ndarray:
    """Return the starts with driven states where `theta` leads them."""
    segments, model = problem.segments, problem.simulator.model
    x0 = np.array(segments.guess if x0 is None else x0)
    count = len(model.driven)
    for r, item in enumerate(arena.prepared):
        mine = segments.recording == r
        path = known_states(model, item, theta, problem.simulator)
        x0[-count:, mine] = path[segments.start[mine], -count:].T
    return x0


def active_parameters(super_model: SuperModel, members: tuple[int, ...]) -> np.ndarray:
    """Free parameters of the given model and all parameters of the members."""
    index = [*super_model.base_index(), *(j for i in members for j in super_model.index(i))]
    return np.array(sorted(set(index)), dtype=int)


def held_back(arena: Arena, result: Fit) -> np.ndarray:
    """Mean squared residual of every block when parameters and starts are estimated without it.

    To first order around the estimate: leaving block b out moves (theta, x0) by the Gauss-Newton
    step of the remaining residuals. A block that is a whole segment has no other data for its
    own start, which is then estimated on it, as in any free run.
    """
    if not result.usable:
        return np.full(1 + max(b for b, *_ in arena.pieces), np.inf)
    states, parameters = result.by_start.shape[0], result.active.size
    segments = result.residual.shape[-1]
    whole = arena.problem.segments.count
    products: dict[int, list[tuple[int, bool, np.ndarray, np.ndarray, float, int]]] = {}
    gram = np.zeros((segments, parameters + states, parameters + states))
    moment = np.zeros((segments, parameters + states))
    for block, s, a, b in arena.pieces:
        columns = np.concatenate(
            [result.jacobian[:, :, a:b, s], result.by_start[:, :, a:b, s]]
        ).reshape(parameters + states, -1)
        r = result.residual[:, a:b, s].ravel()
        g, m = columns @ columns.T, columns @ r
        used = int(arena.problem.segments.weights[:, a:b, s].sum())
        alone = a == 0 and b == whole[s]
        products.setdefault(block, []).append((s, alone, g, m, float(r @ r), used))
        gram[s] += g
        moment[s] += m
    errors = []
    for block in sorted(products):
        rest_gram, rest_moment = gram.copy(), moment.copy()
        for s, _, g, m, _, _ in products[block]:
            rest_gram[s] -= g
            rest_moment[s] -= m
        theta_step, start_steps = _solve(rest_gram, rest_moment, parameters)
        sse = used_total = 0.0
        for s, alone, g, m, power, used in products[block]:
            if alone:
                own = m[parameters:] - g[parameters:, :parameters] @ theta_step
                start = np.linalg.lstsq(g[parameters:, parameters:], own, rcond=1e-10)[0]
            else:
                start = start_steps[s]
            step = np.concatenate([theta_step, start])
            sse += max(power - 2 * m @ step + step @ g @ step, 0.0)
            used_total += used
        if used_total:
            errors.append(sse / used_total)
    return np.array(errors)


def _solve(gram: np.ndarray, moment: np.ndarray, parameters: int) -> tuple[np.ndarray, np.ndarray]:
    """Solve for the common parameters and every segment's start (arrow-shaped equations)."""
    inner = gram[:, parameters:, parameters:]
    inverse = np.linalg.pinv(inner, rcond=1e-10, hermitian=True)
    cross = gram[:, :parameters, parameters:]
    own, common = moment[:, parameters:], moment[:, :parameters]
    solved = cross @ inverse
    total = (gram[:, :parameters, :parameters] - solved @ cross.transpose(0, 2, 1)).sum(0)
    right = (common - (solved @ own[..., None])[..., 0]).sum(0)
    step = np.zeros(0)
    if parameters:
        size = column_sizes(total)
        step = np.linalg.lstsq(total / size / size[:, None], right / size, rcond=1e-10)[0] / size
    left = own - np.einsum("spi,p->si", cross, step)
    return step, (inverse @ left[..., None])[..., 0]


def column_sizes(gram: np.ndarray) -> np.ndarray:
    """Square roots of the diagonal, 1 for columns without effect."""
    diagonal = np.diag(gram)
    return np.sqrt(np.where(diagonal > 1e-200, diagonal, 1.0))


def gain(worse: np.ndarray, better: np.ndarray) -> tuple[float, float, float]:
    """Compare two entries block by block.

    Returns
    -------
    mean : float
        Mean of log(worse / better) over the blocks.
    error : float
        Its standard error.
    p : float
        One-sided p-value of Student's t-test that the mean is above zero.
    """
    if not np.isfinite(worse).all() or not np.isfinite(better).all():
        # What could not be simulated loses.
        lost = float(not np.isfinite(worse).all()) - float(not np.isfinite(better).all())
        return lost * np.inf if lost else 0.0, 0.0, 0.5 - 0.5 * lost
    difference = np.log(worse + 1e-300) - np.log(better + 1e-300)
    mean, count = float(np.mean(difference)), difference.size
    error = float(np.std(difference, ddof=1) / np.sqrt(count)) if count > 1 else np.inf
    if error == 0.0:
        return mean, 0.0, 0.5 if mean == 0.0 else float(mean < 0)
    return mean, error, float(scipy.stats.t.sf(mean / error, count - 1))


def correlation_length(residual: np.ndarray) -> float:
    """Return how many neighbouring samples carry one independent residual."""
    total, power = 0.0, 0.0
    lags = min(residual.shape[1] - 1, 400)
    r = residual.transpose(0, 2, 1).reshape(-1, residual.shape[1])
    power = float(np.mean(r**2)) + 1e-300
    for lag in range(1, lags):
        rho = float(np.mean(r[:, :-lag] * r[:, lag:])) / power
        if rho < 0.05:
            break
        total += rho
    return 1.0 + 2.0 * total


def weights(
    entries: Sequence[Entry], effective: float, price: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Probabilities of the entries, `price` added to the log error of each.

    Pseudo-Bayesian model averaging with the Bayesian bootstrap over blocks: the held-back log
    score of a block is -(n/2) log(error), n independent residuals per block.

    References
    ----------
    Yao, Vehtari, Simpson & Gelman, Bayesian Analysis 13 (2018), section 3.4.
    """
    log_errors = np.log(np.stack([e.errors for e in entries]) + 1e-300)
    score = -0.5 * effective * (log_errors + price[:, None])
    blocks = score.shape[1]
    draws = rng.dirichlet(np.ones(blocks), size=2000) * blocks
    total = draws @ score.T
    total -= total.max(axis=1, keepdims=True)
    share = np.exp(total)
    return (share / share.sum(axis=1, keepdims=True)).mean(axis=0)
