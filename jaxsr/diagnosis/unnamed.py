"""Unnamed physics: the evolution proposes a term where no named mechanism explains the rest.

It is asked where a mismatch is left, and where several named forces at one equation may stand for
one law without a name.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from jaxsr.diagnosis.candidates import Candidate, ParameterSpec
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest import Arena, Entry, active_parameters, neutral_values
from jaxsr.diagnosis.decide import independent_residuals
from jaxsr.diagnosis.refine import LIMITED, residual_to_noise
from jaxsr.diagnosis.weak_system import WeakSystem, weak_system
from jaxsr.evolution import SearchConfig, propose
from jaxsr.evolution.propose import Proposal
from jaxsr.expressions import Term, to_text
from jaxsr.models.segments import Prepared
from jaxsr.views import WeakView

SECONDS, SHARE = 12.0, 0.5
"""Longest search, and its share of the time left: what it finds is to be estimated as well."""
WORTH = 0.7
"""Residual sum of squares in the weak view, relative to that without, a proposal must reach."""
MAX_TERMS = 2
CROWD = 2
"""Forces chosen at one equation from which one law may stand for all of them."""
BESIDE = 0.1
"""Weight of the other equations, each relative to the size of what it leaves."""
ALONE = 0.3
"""Share of the error that is left, from which one force alone explains most of it."""
TRIED = 1000
"""Terms that a search tells apart: a price of naming nothing, in `decide.criterion`."""
NAMELESS = 0.7
"""Cost, relative to that of several named forces, from which one without a name may stand for them
where neither reaches the noise."""
REACH = 10.0
"""Factor within which constants inside a proposed term are estimated."""
FORCES = frozenset("dissipative elastic coupling periodic memory".split())
"""Families of forces that the shape of another one can imitate."""
ALONG_POSITION = frozenset(
    "linear_stiffness quadratic_stiffness cubic_stiffness piecewise_stiffness backlash "
    "position_ripple".split()
)
"""Mechanisms whose forces depend on the position alone."""
ProposedForce = tuple[Candidate, np.ndarray]
"""A candidate and the values of its coefficients."""


def propose_unnamed(
    case: Case, arena: Arena, entry: Entry, rng: np.random.Generator
) -> tuple[ProposedForce, tuple[int, ...]] | None:
    """Search one law for the equation that keeps most, in the place of `entry`'s forces there.

    Where `entry` has forces at all, only their equations are asked. Returns the candidate with
    its coefficients, and the members of `entry` that stand elsewhere; None where no law of at
    most `MAX_TERMS` terms removes enough.
    """
    every = arena.super_model.candidates
    at = {i: every[i].site.partition(":")[2] for i in entry.members}
    forces = [i for i in entry.members if every[i].family in (*FORCES, "external")]
    if case.screened is None or case.search.exhausted:
        return None
    system = _view(case, arena, _without(arena, entry, forces))
    names, states = case.simulator.model.states, np.unique(system.state)
    if not states.size:  # members bring states along without which no equation can be read off
        return None
    places = {at[i] for i in forces} & {names[i] for i in states}
    state = names[_worst_state(system, [i for i in states if not places or names[i] in places])]
    rest = tuple(i for i in entry.members if i not in forces or at[i] != state)
    proposal = propose_instead(case, arena, entry, state, rest, rng)
    return None if proposal is None else (proposal, rest)


def crowded(
    arena: Arena, chosen: Entry, entries: Sequence[Entry]
) -> list[tuple[str, tuple[int, ...]]]:
    """Return the equations at which several forces were chosen, with the members elsewhere.

    Where one of two alone explains most, the other is a detail beside a law with a name.
    """
    every, known = arena.super_model.candidates, {frozenset(e.members): e for e in entries}
    at: dict[str, list[int]] = {}
    for number in chosen.members:
        if every[number].family in FORCES:
            at.setdefault(every[number].site, []).append(number)
    found = []
    for site, crowd in at.items():
        rest = tuple(i for i in chosen.members if i not in crowd)
        without = known.get(frozenset(rest), known[frozenset()]).fit.cost
        alone = [known.get(frozenset({*rest, i})) for i in crowd]
        least = min((e.fit.cost for e in alone if e is not None), default=np.inf)
        if len(crowd) > CROWD or (len(crowd) == CROWD and least > ALONE**2 * without):
            found.append((site.partition(":")[2], rest))
    return found


def crowded_over_position(arena: Arena, chosen: Entry) -> list[tuple[str, tuple[int, ...]]]:
    """Return the equations at which several chosen forces depend on the position alone.

    Together they are one law of it, unless they are powers alone, the series of a spring. With the
    members that stand beside them.
    """
    every, at = arena.super_model.candidates, {}
    for number in chosen.members:
        if every[number].mechanism in ALONG_POSITION:
            at.setdefault(every[number].site.partition(":")[2], []).append(number)
    shaped = {i for i in chosen.members if any(not p.coefficient for p in every[i].parameters)}
    crowds = {s: crowd for s, crowd in at.items() if len(crowd) >= CROWD and shaped & set(crowd)}
    return [
        (state, tuple(i for i in chosen.members if i not in crowd))
        for state, crowd in crowds.items()
    ]


def propose_instead(
    case: Case,
    arena: Arena,
    chosen: Entry,
    state: str,
    rest: tuple[int, ...],
    rng: np.random.Generator,
) -> ProposedForce | None:
    """Search one law for an equation in the place of all that was chosen there beside `rest`.

    The shortest description of the data among the proposals, None where none removes enough.
    """
    if case.screened is None or case.search.exhausted:
        return None
    system = _view(case, arena, _without(arena, chosen, set(chosen.members) - set(rest)))
    index = case.simulator.model.states.index(state)
    if not (system.state == index).any():
        return None
    good = _search(case, arena, system, rest, index, rng)
    return as_candidate(case, index, good[0]) if good else None


def worth_no_name(arena: Arena, unnamed: Entry, named: Entry) -> bool:
    """Whether a law without a name leaves far less than named ones, or is shorter at the noise.

    Shorter by Schwarz's criterion, n log(cost) + k log(n): the price of several names in a
    library does not make a law nameless.
    """
    if unnamed.fit.cost < NAMELESS * named.fit.cost:
        return True
    n = independent_residuals(unnamed)
    more = unnamed.fit.active.size - named.fit.active.size
    shorter = n * np.log(unnamed.fit.cost / named.fit.cost) + more * np.log(n) < 0.0
    return bool(shorter) and residual_to_noise(arena, unnamed) <= LIMITED


def _without(arena: Arena, entry: Entry, members: Iterable[int]) -> np.ndarray:
    """Parameters of an entry, its `members` put to nothing."""
    theta, neutral = entry.fit.theta.copy(), neutral_values(arena.super_model)
    for number in members:
        own = arena.super_model.index(number)
        theta[own] = neutral[own]
    return theta


def _view(case: Case, arena: Arena, theta: np.ndarray) -> WeakSystem:
    assert case.screened is not None
    return weak_system(arena.problem.simulator, case.prepared, theta, case.screened.half_width)


def _search(
    case: Case,
    arena: Arena,
    system: WeakSystem,
    members: tuple[int, ...],
    state: int,
    rng: np.random.Generator,
) -> list[Proposal]:
    """Return the proposals of few terms that remove enough, the shortest description first.

    States enter in units of their size: constants and exponents are searched near one. The other
    equations stand beside with little weight: alone, one without an input would hold for any
    forces and inertias that vanish together.
    """
    assert case.screened is not None
    seconds = min(SECONDS, SHARE * case.search.remaining)
    if not seconds > 0.0:
        return []
    rows, sizes = system.state == state, sizes_of(case)
    weight = np.zeros(rows.size)
    for index in np.unique(system.state):
        own = system.state == index
        rms = float(np.sqrt(np.mean(system.residual[own] ** 2))) + 1e-300
        weight[own] = (1.0 if index == state else BESIDE) / rms
    integrate = _WeakColumns(case.prepared, case.screened.half_width)

    def view(columns: np.ndarray) -> np.ndarray:
        full = np.zeros((rows.size, columns.shape[1]))
        full[rows] = weight[rows, None] * integrate(columns)
        return full

    # Inputs stay out: one that cancels the drive makes every equation hold trivially.
    variables = {
        name: np.concatenate([np.nan_to_num(item.states.values[:, i]) for item in case.prepared])
        / sizes[name]
        for i, name in enumerate(case.simulator.model.states)
    }
    active = active_parameters(arena.super_model, members)
    found = propose(
        rng,
        -weight * system.residual,
        variables,
        view=view,
        fixed=weight[:, None] * system.jacobian[:, active],
        config=SearchConfig(population=120, generations=25),
        budget=seconds,
    )
    return [p for p in found if 0 < len(p.terms) <= MAX_TERMS and p.relative_loss < WORTH]


def sizes_of(case: Case) -> dict[str, float]:
    """Rms of every state to two digits, by which the search divides."""
    sizes = {}
    for i, name in enumerate(case.simulator.model.states):
        values = np.concatenate([item.states.values[:, i] for item in case.prepared])
        rms = float(np.sqrt(np.nanmean(values**2)))
        sizes[name] = float(f"{rms:.2g}") if np.isfinite(rms) and rms > 0 else 1.0
    return sizes


def as_candidate(case: Case, state: int, proposal: Proposal) -> ProposedForce:
    """Write a proposal as a candidate; constants inside its terms are estimated as well."""
    name, sizes = case.simulator.model.states[state], sizes_of(case)
    inner: list[float] = []
    pieces = [
        f"{{c{k}}}*({to_text(_written(term, sizes, inner), 6)})"
        for k, term in enumerate(proposal.terms, 1)
    ]
    coefficients = [ParameterSpec(f"c{k}") for k in range(1, len(proposal.terms) + 1)]
    constants = [
        ParameterSpec(
            f"a{k}",
            low=min(value / REACH, value * REACH),
            high=max(value / REACH, value * REACH),
            neutral=value,
            coefficient=False,
        )
        for k, value in enumerate(inner, 1)
    ]
    candidate = Candidate(
        mechanism="unnamed",
        family="unnamed",
        site=f"equation:{name}",
        parameters=(*coefficients, *constants),
        sentence="A force that matches no named mechanism acts along {site}; the search wrote it.",
        terms=((name, "+ " + " + ".join(pieces)),),
        tried=TRIED,
        source="evolutionary sparse regression in the weak view",
    )
    return candidate, np.array([*proposal.coefficients, *inner])


def _written(term: Term, sizes: dict[str, float], inner: list[float], within: str = "") -> Term:
    """Divide states by their sizes, and put parameters for constants.

    Whole numbers stay but where they are added to something: exponents are no estimates.
    """
    if term.is_variable:
        size = sizes[term.name]
        return term if size == 1.0 else Term.apply("div", term, Term.constant(size))
    if term.is_constant:
        if term.value == round(term.value) and within not in ("add", "sub"):
            return term
        inner.append(term.value)
        return Term.variable(f"{{a{len(inner)}}}")
    if not term.args:
        return term
    return Term.apply(term.op, *(_written(a, sizes, inner, term.op) for a in term.args))


def _worst_state(system: WeakSystem, states: Iterable[int]) -> int:
    """Return which equation has the largest residual relative to what its terms bring."""
    share = {}
    terms = system.jacobian * system.theta
    for state in states:
        rows = system.state == state
        brought = np.sum(terms[rows] ** 2) + np.sum(system.input_side[rows] ** 2)
        share[int(state)] = float(np.sum(system.residual[rows] ** 2) / max(brought, 1e-300))
    return max(share, key=lambda s: share[s])


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
