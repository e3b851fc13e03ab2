"""Refining: the final estimate of a chosen set, with its intervals."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from jaxsr._deadline import OutOfTime
from jaxsr._progress import Budget
from jaxsr.diagnosis.judging.corners import out_of_corners
from jaxsr.diagnosis.judging.noise_ratio import model_limited
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena, build_arena, neutral_values, parameter_bounds
from jaxsr.diagnosis.shooting.enter import active_parameters, enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.reduced import Lean, lean, reduce
from jaxsr.diagnosis.shooting.uncertainty import half_widths, unseen, untold
from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.diagnosis.weak.weak_system import WeakSystem, weak_system
from jaxsr.models import Model, Simulator, apply_edit, with_values
from jaxsr.models.least_squares import Fit
from jaxsr.models.segments import Prepared
from jaxsr.recordings import quantisation_step

SMOOTHED_MECHANISMS = frozenset(
    {
        *("coulomb_friction", "stribeck_friction", "position_dependent_friction"),
        *("load_dependent_friction", "coupled_friction"),
    }
)
ANCHORED = 1e-3
"""Rise of the cost up to which an estimate nearer to the given values shows the same."""
CURVED = 1.0
"""Departure from a line of estimates over widths, relative to their change, up to which they are
taken for one."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters of a set with the half-widths of their 95 % intervals.

    Attributes
    ----------
    arena : Arena
    entry : Entry
        The estimate in free run that the intervals stand on.
    theta : ndarray, shape (parameters,)
        Values in the order of the super-model.
    half : ndarray, shape (parameters,)
        Zero for parameters that were not estimated.
    told : ndarray, shape (parameters,)
        The same by the data alone: without directions of parameters that leave no trace.
    named : SuperModel
        The given model with the set's candidates alone, under the names a reader expects.
    share : float
        Of all samples that it rests on, where a search on a part of them went before.
    """

    arena: Arena
    entry: Entry
    theta: np.ndarray
    half: np.ndarray
    told: np.ndarray
    named: SuperModel
    share: float = 1.0

    @cached_property
    def lean(self) -> Lean:
        """The same with the set's own mechanisms alone."""
        problem, members = self.arena.problem, self.entry.members
        return lean(self.arena.super_model, problem.simulator, problem.stepping, members)

    def system(self, prepared: tuple[Prepared, ...], half_width: float) -> WeakSystem:
        """The weak view at the estimate, by the set's own parameters."""
        own = self.lean
        grid = WeakGrid.build(self.arena.super_model.given, prepared, half_width)
        return _weak_view(own, grid, self.theta)

    def interval(self, name: str) -> tuple[float, float]:
        """Value and half-width of a parameter of `named`."""
        index = self.positions[name]
        return float(self.theta[index]), float(self.half[index])

    @property
    def positions(self) -> dict[str, int]:
        """Position in the super-model of every estimated parameter of `named`."""
        order = list(self.arena.super_model.model.parameters)
        found = {n: order.index(n) for n in self.named.given.free_parameters}
        for own, full in zip(self.named.names, self.entry.members, strict=True):
            inside = self.arena.super_model.names[full]
            found |= {name: order.index(inside[spec]) for spec, name in own.items()}
        return found

    @property
    def model(self) -> Model:
        """The model file of the estimate, without what only its own recordings saw."""
        values = {n: float(self.theta[i]) for n, i in self.positions.items()}
        model = with_values(
            self.named.given, {n: values[n] for n in self.named.given.free_parameters}
        )
        for candidate, names in zip(self.named.candidates, self.named.names, strict=True):
            if candidate.passing:
                continue
            own = {spec: values[name] for spec, name in names.items()}
            model = apply_edit(model, candidate.edit(model, names, own))
        return model

    @property
    def elsewhere(self) -> np.ndarray:
        """Values for other recordings: a push that passed is switched off."""
        theta, given = self.theta.copy(), self.arena.super_model
        for number in self.entry.members:
            if given.candidates[number].passing:
                for index in given.index(number, coefficients_only=True):
                    theta[index] = 0.0
        return theta


@dataclass(frozen=True, eq=False)
class Ground:
    """What every refinement shares."""

    arena: Arena
    prepared: tuple[Prepared, ...]
    horizons: tuple[float, ...]  # those up to the headline
    grid: WeakGrid | None
    budget: Budget = field(default_factory=Budget)  # of what the report can do without
    patience: Budget = field(default_factory=Budget)  # of what it hardly can


def named_super_model(given: Model, candidates: list[Candidate]) -> SuperModel:
    """Apply candidates under the names a reader expects (Fc, not Fc__3)."""
    model, all_names = given, []
    for candidate in candidates:
        names = candidate.names(set(model.symbols) | set(model.definitions))
        model = apply_edit(model, candidate.edit(model, names))
        all_names.append(names)
    return SuperModel(model, given, tuple(candidates), tuple(all_names))


def plain(arena: Arena, entry: Entry) -> Estimate:
    """Return a set's estimate as the search left it, with intervals of its own residuals.

    One that no residual tells has intervals as wide as its bounds.
    """
    half, active = np.zeros_like(entry.fit.theta), entry.fit.active
    half[active] = np.inf
    if entry.fit.jacobian.any():
        with contextlib.suppress(OutOfTime):
            half[active] = np.hypot(half_widths(arena, entry.fit), untold(arena, entry.fit))
    candidates = [arena.super_model.candidates[i] for i in entry.members]
    named = named_super_model(arena.super_model.given, candidates)
    return Estimate(arena, entry, entry.fit.theta, half, half, named)


def refine(ground: Ground, entry: Entry, thorough: bool = True) -> Estimate:
    """Estimate a set finally.

    Where the model fits down to the noise, the free run over the segments is the most
    precise estimate. Where it does not (a small effect is still missing), each horizon asks for
    slightly different constants: then free run over the shortest horizon and the weak view
    compete, the estimate with the least error over all horizons and forces on DATA is taken,
    and the spread of the three widens the intervals. All this only if `thorough`.
    """
    arena = ground.arena
    try:
        entry, corners = out_of_corners(arena, entry, lambda: ground.budget.exhausted)
        entry = _anchored(arena, entry)
        theta, numerical = _without_smoothing(arena, entry, lambda: ground.patience.exhausted)
    except OutOfTime:
        return plain(arena, entry)
    half = np.zeros_like(theta)
    half[entry.fit.active] = half_widths(arena, entry.fit)
    options = [theta]
    if thorough and not ground.budget.exhausted and model_limited(arena, entry):
        others = _other_estimates(ground, entry.members, theta)
        options += [o for o in others if _acts(arena.super_model, entry.members, o)]
    best = options[0]
    if not ground.patience.exhausted:
        best = _least_error(ground, entry.members, options)
    spread = np.std(np.stack(options), axis=0, ddof=1) if len(options) > 1 else 0.0
    told = np.where(
        half > 0, np.sqrt(half**2 + numerical**2 + corners**2 + (2.0 * spread) ** 2), 0.0
    )
    told += _converters(arena, entry)
    half = told.copy()
    half[entry.fit.active] = np.hypot(told[entry.fit.active], untold(arena, entry.fit))
    candidates = [arena.super_model.candidates[i] for i in entry.members]
    named = named_super_model(arena.super_model.given, candidates)
    return Estimate(arena, entry, best, half, told, named)


def _anchored(arena: Arena, entry: Entry) -> Entry:
    """Return the estimate nearest to the given values among those that show the same.

    Along a direction that leaves no trace an estimate ends anywhere.
    """
    blind = unseen(arena, entry.fit)
    if not blind.directions.size or not entry.fit.usable:
        return entry
    active, theta = entry.fit.active, entry.fit.theta.copy()
    theta[active] += blind.step(theta[active] - neutral_values(arena.super_model)[active])
    low, high = arena.bounds
    theta = np.clip(theta, low, high)
    moved = enter(arena, entry.members, theta, entry.fit.path, max_iterations=1, near=True)
    return moved if moved.fit.cost <= (1.0 + ANCHORED) * entry.fit.cost else entry


def _acts(super_model: SuperModel, members: tuple[int, ...], theta: np.ndarray) -> bool:
    """Whether every member still has an effect."""
    order = list(super_model.model.parameters.values())
    return all(
        any(theta[j] != order[j].value for j in super_model.index(i, coefficients_only=True))
        for i in members
        if super_model.index(i, coefficients_only=True)
    )


def _without_smoothing(
    arena: Arena, entry: Entry, stop: Callable[[], bool] = lambda: False
) -> tuple[np.ndarray, np.ndarray]:
    """Extrapolate the smoothing of sign() away; return the values and a bound of what is left.

    Where estimates depend on the widths w in first order, 2 theta(w) - theta(2 w) is free of it;
    half the correction enters the intervals. That is so where theta(4 w) - theta(2 w) is twice
    theta(2 w) - theta(w); elsewhere the values stay and all of this difference enters. Where the
    recordings told the width, the values at it stay, and the whole of 2 (theta(w) - theta(w/2))
    enters: in which shape a law turns over is not known.
    """
    theta, stepping = entry.fit.theta, arena.problem.stepping
    simulator = arena.problem.simulator
    used = {arena.super_model.candidates[i].mechanism for i in entry.members}
    given = Simulator(arena.super_model.given)
    none = np.zeros_like(theta)
    jumps = used & SMOOTHED_MECHANISMS or given.smoothed_arguments
    if stop() or not stepping.widths or not jumps:
        return theta, none
    own = reduce(arena.problem, arena.super_model, entry.members).problem
    told = arena.jumps is not None and arena.jumps.estimated(own)

    def estimate(factor: float, near: Fit) -> Fit:
        """Estimate at other widths; only near the estimate is the difference one of them."""
        other = replace(stepping, widths=tuple(factor * w for w in stepping.widths))
        problem = replace(arena.problem, simulator=simulator, stepping=other)
        again = replace(arena, problem=problem)
        return enter(again, entry.members, near.theta, near.path, stop, near=True).fit

    if told:
        sharper = estimate(0.5, entry.fit)
        return theta, 2.0 * np.abs(sharper.theta - theta) if sharper.usable else none
    wider = estimate(2.0, entry.fit)
    if not wider.usable or stop():
        return theta, none
    widest = estimate(4.0, wider)
    if not widest.usable or stop():
        return theta, np.abs(wider.theta - theta)
    result, left = without_width(theta, wider.theta, widest.theta)
    low, high = parameter_bounds(arena.super_model)
    return np.where((result > low) & (result < high), result, theta), left


def without_width(
    theta: np.ndarray, wider: np.ndarray, widest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Extrapolate estimates at the widths w, 2 w and 4 w to none; return a bound of what is left.

    Estimates that do not follow the width in a line stay, and all of their change is the bound.
    """
    change = wider - theta
    straight = np.abs(widest - wider - 2.0 * change) < CURVED * np.abs(change)
    result = np.where(straight, theta - change, theta)
    return result, np.where(straight, 0.5, 1.0) * np.abs(change)


def _converters(arena: Arena, entry: Entry) -> np.ndarray:
    """Half the step of a converter, for the limit of its readings: these tell it no better."""
    super_model, outputs = arena.super_model, arena.super_model.model.outputs
    half = np.zeros_like(entry.fit.theta)
    for number in entry.members:
        candidate = super_model.candidates[number]
        if candidate.mechanism == "clipping":
            k = list(outputs).index(candidate.site.partition(":")[2])
            readings = np.concatenate([p.outputs[:, k] for p in arena.prepared])
            half[super_model.index(number)] = 0.5 * (quantisation_step(readings) or 0.0)
    return half


def _other_estimates(
    ground: Ground, members: tuple[int, ...], theta: np.ndarray
) -> list[np.ndarray]:
    found, arena = [], ground.arena
    shortest = ground.horizons[0]
    if shortest < 0.9 * arena.seconds:
        short_arena = build_arena(
            arena.super_model,
            ground.prepared,
            arena.problem.stepping,
            shortest,
            arena.problem.scale,
            arena.problem.simulator,
            arena,
        )
        short = enter(short_arena, members, theta, stop=lambda: ground.budget.exhausted).fit
        if short.usable:
            found.append(short.theta)
    if ground.grid is not None:
        found.append(_weak_estimate(ground, ground.grid, members, theta))
    return found


def _weak_estimate(
    ground: Ground, grid: WeakGrid, members: tuple[int, ...], theta: np.ndarray
) -> np.ndarray:
    """Gauss-Newton in the weak view, every equation weighted by its own residual."""
    super_model, problem = ground.arena.super_model, ground.arena.problem
    own = lean(super_model, problem.simulator, problem.stepping, members)
    active = active_parameters(super_model, members)
    low, high = parameter_bounds(super_model)
    theta, inside = theta.copy(), own.active(active)
    for _ in range(3):
        system = _weak_view(own, grid, theta)
        if not system.residual.size:
            break
        weight = np.ones(system.residual.size)
        for state in np.unique(system.state):
            rows = system.state == state
            weight[rows] = 1.0 / (np.sqrt(np.mean(system.residual[rows] ** 2)) + 1e-300)
        a = system.jacobian[:, inside] * weight[:, None]
        size = np.sqrt((a**2).sum(0))
        size = np.where(size > 0, size, 1.0)
        step = np.linalg.lstsq(a / size, -system.residual * weight, rcond=1e-9)[0] / size
        theta[active] = np.clip(theta[active] + step, low[active], high[active])
    return theta


def _least_error(ground: Ground, members: tuple[int, ...], options: list[np.ndarray]) -> np.ndarray:
    """Return the estimate with the least mean log error over horizons and forces, on DATA."""
    if len(options) == 1:
        return options[0]
    problem = ground.arena.problem
    own = lean(ground.arena.super_model, problem.simulator, problem.stepping, members)
    totals = []
    for theta in options:
        total = sum(
            np.log(own.free_run(ground.prepared, theta, h).nrmse + 1e-300) for h in ground.horizons
        )
        if ground.grid is not None:
            left = _weak_view(own, ground.grid, theta).residual
            total += np.log(np.sqrt(np.mean(left**2)) + 1e-300) if left.size else 0.0
        totals.append(total)
    return options[int(np.argmin(totals))]


def _weak_view(own: Lean, grid: WeakGrid, theta: np.ndarray) -> WeakSystem:
    """The equations that need no hidden state with the set's own mechanisms in them."""
    states = grid.observable_in(own.simulator.model)
    return weak_system(own.simulator, grid, theta[own.parameters], states)
