"""Unnamed physics: the evolution proposes a term where no named mechanism explains the rest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxsr.diagnosis.candidates import Candidate, ParameterSpec
from jaxsr.diagnosis.contest import Arena, Entry, active_parameters
from jaxsr.diagnosis.weak_system import WeakSystem, weak_system
from jaxsr.evolution import SearchConfig, propose
from jaxsr.expressions import to_text
from jaxsr.models.segments import Prepared
from jaxsr.views import WeakView

if TYPE_CHECKING:
    from jaxsr.diagnosis.diagnose import Case

SECONDS = 12.0
WORTH = 0.7
"""Residual sum of squares in the weak view, relative to that without, a proposal must reach."""
MAX_TERMS = 2


def propose_unnamed(
    case: Case, arena: Arena, entry: Entry, rng: np.random.Generator
) -> tuple[Candidate, np.ndarray] | None:
    """Search a term for the equation that keeps the largest relative residual.

    Runs in the weak view with the parameters of `entry` as columns that stay. Returns the
    candidate and its coefficients, or None where no term of at most `MAX_TERMS` parts removes
    enough.
    """
    if case.screened is None or case.budget.exhausted:
        return None
    prepared, half_width = case.prepared, case.screened.half_width
    simulator = arena.problem.simulator
    system = weak_system(simulator, prepared, entry.fit.theta, half_width)
    state = _worst_state(system)
    rows = system.state == state
    model = case.simulator.model
    # Inputs stay out: one that cancels the drive makes every equation hold trivially.
    variables = {
        name: np.concatenate([np.nan_to_num(item.states.values[:, i]) for item in prepared])
        for i, name in enumerate(model.states)
    }
    active = active_parameters(arena.super_model, entry.members)
    config = SearchConfig(population=120, generations=25)
    found = propose(
        rng,
        -system.residual[rows],
        variables,
        view=_WeakColumns(prepared, half_width),
        fixed=system.jacobian[rows][:, active],
        config=config,
        budget=min(SECONDS, case.budget.remaining),
    )
    good = [p for p in found if 0 < len(p.terms) <= MAX_TERMS and p.relative_loss < WORTH]
    if not good:
        return None
    # A second term, or a longer one, has to halve what the shorter proposal leaves.
    best = min(good, key=lambda p: p.size)
    for proposal in sorted(good, key=lambda p: p.size):
        if proposal.relative_loss < 0.5 * best.relative_loss:
            best = proposal
    name = model.states[state]
    specs = tuple(
        ParameterSpec(f"c{k}", low=-1e12, high=1e12) for k in range(1, len(best.terms) + 1)
    )
    pieces = [f"{{c{k}}}*({to_text(t, 6)})" for k, t in enumerate(best.terms, 1)]
    candidate = Candidate(
        mechanism="unnamed",
        family="unnamed",
        site=f"equation:{name}",
        parameters=specs,
        sentence="A force that matches no named mechanism acts along {site}; the search wrote it.",
        terms=((name, "+ " + " + ".join(pieces)),),
        source="evolutionary sparse regression in the weak view",
    )
    return candidate, best.coefficients


def _worst_state(system: WeakSystem) -> int:
    """Equation with the largest residual relative to its input side."""
    ratio = {}
    for state in np.unique(system.state):
        rows = system.state == state
        bring = np.mean(system.input_side[rows] ** 2)
        left = np.mean(system.residual[rows] ** 2)
        ratio[int(state)] = float(left / bring) if bring > 0 else float(left)
    return max(ratio, key=lambda s: ratio[s])


class _WeakColumns:
    """Integrate columns over all recordings against the test functions."""

    def __init__(self, prepared: Sequence[Prepared], half_width: float) -> None:
        self.views, self.edges = [], [0]
        for item in prepared:
            present = np.isfinite(item.states.values).all(1)
            for signal in item.states.measured.values():
                present = present & np.isfinite(signal)
            self.views.append(
                WeakView.build(item.time, half_width, half_width / 4, mask=np.asarray(present))
            )
            self.edges.append(self.edges[-1] + item.time.size)

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        parts = [
            view.integrate(columns[a:b])[view.valid]
            for view, a, b in zip(self.views, self.edges[:-1], self.edges[1:], strict=True)
        ]
        return np.concatenate(parts)
