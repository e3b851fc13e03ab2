"""The search: operators keep their promises, and known laws are found."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxsr.evolution
from jaxsr._result import InputError, StoppedBy
from jaxsr.evolution import (
    FitnessRule,
    Front,
    Individual,
    PrimitiveSet,
    SearchConfig,
    SizeLimits,
    init,
    propose,
    search,
    step,
)
from jaxsr.evolution.create import random_term
from jaxsr.evolution.crossover import swap_subtrees
from jaxsr.evolution.library import small_terms
from jaxsr.evolution.mutate import mutate_constant, mutate_subtree
from jaxsr.evolution.select import tournament
from jaxsr.expressions import Term, parse, to_text
from jaxsr.expressions.description import opened
from jaxsr.regression import RegressionProblem

NAMES = ["t", "x", "v"]


def _problem(seed=0, noise=0.0, n=300):
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 10.0, n)
    x, v = np.sin(1.3 * t) + 0.3 * rng.normal(size=n), rng.normal(size=n)
    y = -4.0 * x - 0.5 * v * np.abs(v) + 2.0 * np.sin(3.0 * t + 1.0)
    return RegressionProblem(y + noise * rng.normal(size=n), {"t": t, "x": x, "v": v})


def _skeletons(terms):
    return {"".join(c for c in to_text(t, 2) if not c.isdigit() and c != ".") for t in terms}


def test_nothing_in_evolution_imports_jax_itself():
    for path in Path(jaxsr.evolution.__file__).parent.glob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert "import jax\n" not in text and "jax.numpy" not in text, path.name


@pytest.mark.long
def test_evaluation_and_regression_do_not_reach_up():
    code = (
        "import jaxsr.evaluation, jaxsr.regression, sys;"
        "assert not [m for m in sys.modules if m.startswith('jaxsr.evolution')]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_random_terms_respect_size_and_set():
    rng = np.random.default_rng(0)
    primitives = PrimitiveSet(functions=("add", "mul", "sin"), constants=(1.0, 2.0))
    for _ in range(500):
        size = int(rng.integers(1, 16))
        term = random_term(rng, NAMES, primitives, size)
        assert term.size <= size
        nodes = list(term.walk())
        assert {n.op for n in nodes} <= {"add", "mul", "sin", "variable", "constant"}
        assert all(1.0 <= n.value <= 2.0 for n in nodes if n.is_constant)


def test_crossover_neither_makes_nor_loses_symbols():
    rng = np.random.default_rng(1)
    changed = 0
    for _ in range(300):
        a, b = (random_term(rng, NAMES, PrimitiveSet(), 12) for _ in range(2))
        c, d = swap_subtrees(rng, a, b, 15)
        before = sorted(str((n.op, n.name, n.value)) for t in (a, b) for n in t.walk())
        after = sorted(str((n.op, n.name, n.value)) for t in (c, d) for n in t.walk())
        assert before == after
        assert max(c.size, d.size) <= 15
        changed += (c, d) != (a, b)
    assert changed > 150


def test_constant_mutation_stays_inside_eq_7_and_shrinks_with_generations():
    rng = np.random.default_rng(2)
    term = parse("sin(3.0*t)", NAMES)
    for generation in (0, 10, 100):
        reach = 5.0 / (5.0 + 2.0 * generation)
        moves = []
        for _ in range(300):
            (after,) = mutate_constant(rng, [term], generation, 5.0)
            moves.append(next(n.value for n in after.walk() if n.is_constant) - 3.0)
        assert max(np.abs(moves)) <= reach
        assert max(np.abs(moves)) > 0.9 * reach
        assert abs(np.mean(moves)) < 0.15 * reach  # to both sides alike
    assert mutate_constant(rng, [Term.variable("x")], 0, 5.0) == (Term.variable("x"),)


def test_subtree_mutation_keeps_the_size_limit():
    rng = np.random.default_rng(3)
    sizes = SizeLimits(at_birth=5, later=9)
    terms = [random_term(rng, NAMES, PrimitiveSet(), 9)]
    for _ in range(300):
        terms = mutate_subtree(rng, terms, NAMES, PrimitiveSet(), sizes)
        assert terms[0].size <= 9


def test_tournament_prefers_the_fitter():
    rng = np.random.default_rng(4)
    population = [Individual((), float(k), k, 0) for k in range(10)]
    drawn = [tournament(rng, population, np.arange(10.0)).size for _ in range(2000)]
    # the best of three of ten: mean of the minimum is 2.0 (with replacement about 2.0)
    assert np.mean(drawn) == pytest.approx(sum((k / 10) ** 3 for k in range(1, 10)), abs=0.15)


def test_front_holds_nobody_that_is_beaten():
    rng = np.random.default_rng(5)
    term = (Term.variable("x"),)
    seen = [Individual(term, float(rng.random()), int(rng.integers(1, 40)), 0) for _ in range(300)]
    front = Front()
    for k in range(0, 300, 30):
        front = front.with_(seen[k : k + 30])
    for member in front.members:
        assert not any(
            (o.size <= member.size and o.loss < member.loss)
            or (o.size < member.size and o.loss <= member.loss)
            for o in seen
        )
    assert front == Front().with_(seen)


def test_small_terms_are_canonical_and_hold_the_mechanicians_ones():
    terms = small_terms(NAMES, PrimitiveSet())
    assert len(set(terms)) == len(terms)
    texts = set(map(to_text, terms))
    assert {"x", "sign(v)", "Abs(v)*v", "v*x", "sin(x)", "1.0"} <= texts


@pytest.mark.long
def test_a_step_never_loses_the_best_and_the_seed_fixes_the_result():
    config = SearchConfig(population=40, refined=3)
    fronts = []
    for _ in range(2):
        problem, rng = _problem(noise=0.1), np.random.default_rng(6)
        state = init(rng, problem, config)
        for _ in range(4):
            best = state.front.best_loss
            state, info = step(rng, state, problem)
            assert state.front.best_loss <= best
            assert info.generation == state.generation
        fronts.append(state.front)
    assert fronts[0] == fronts[1]


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_law_with_friction_and_a_force_of_unknown_frequency_is_found(seed):
    state, reason = search(np.random.default_rng(seed), _problem(seed))
    exact = [m for m in state.front.members if m.loss < 1e-14]
    assert reason is StoppedBy.TARGET
    assert _skeletons(exact[0].terms) == {"x", "Abs(v)*v", "sin(*t + )"}


def test_budget_and_interrupt_return_the_best_so_far():
    state, reason = search(np.random.default_rng(0), _problem(noise=1.0), budget=1e-9)
    assert reason is StoppedBy.BUDGET
    assert state.front.members

    def stop(info):
        raise KeyboardInterrupt

    state, reason = search(np.random.default_rng(0), _problem(noise=1.0), progress=stop)
    assert reason is StoppedBy.INTERRUPTED
    assert state.front.members


def test_propose_finds_the_missing_term_beside_a_known_model_in_a_weak_view():
    rng = np.random.default_rng(7)
    n = 600
    x, v = np.cumsum(rng.normal(size=(2, n)), axis=1) / 10.0
    weights = rng.normal(size=(120, n)) * (rng.random((120, n)) < 0.1)
    known = np.column_stack([x, v])
    y = weights @ (-3.0 * x - 0.7 * v - 2.0 * np.sign(v))
    proposals = propose(rng, y, {"x": x, "v": v}, view=lambda c: weights @ c, fixed=weights @ known)
    best = proposals[0]
    assert [to_text(t) for t in best.terms] == ["sign(v)"]
    assert best.coefficients[0] == pytest.approx(-2.0, abs=1e-8)
    np.testing.assert_allclose(best.fixed, [-3.0, -0.7], atol=1e-8)


def test_proposals_near_the_best_are_one_of_each_form():
    """All that are asked for: beside the same front, none errs more, and no form comes twice."""
    x = np.random.default_rng(0).uniform(-2.0, 2.0, 200)
    y = x / (x**2 + 1.0) + 0.2 * np.random.default_rng(1).normal(size=200)
    config = SearchConfig(population=60, generations=8, sizes=SizeLimits(terms=2))

    def found(near):
        return propose(np.random.default_rng(2), y, {"x": x}, config=config, near=near)

    front, more = found(1.0), found(1.3)
    least = min(p.loss for p in front)
    others = [p for p in more if all(p.terms != q.terms for q in front)]
    assert len(more) == len(front) + len(others)
    assert others
    assert all(p.loss <= 1.3001 * least for p in others)
    forms = [frozenset(map(opened, p.terms)) for p in others]
    assert len(set(forms)) == len(forms)
    assert not set(forms) & {frozenset(map(opened, p.terms)) for p in front}


@pytest.mark.parametrize(
    "make",
    [
        lambda: SearchConfig(population=5),
        lambda: SearchConfig(elite=0.9, reproduction=0.2),
        lambda: PrimitiveSet(functions=("sin", "sinus")),
        lambda: PrimitiveSet(constants=(1.0, -1.0)),
        lambda: SizeLimits(at_birth=9, later=5),
        lambda: FitnessRule(tau=0.5),
    ],
)
def test_wrong_settings_are_refused_at_construction(make):
    with pytest.raises(InputError):
        make()


def test_the_papers_settings():
    config = SearchConfig.paper()
    assert (config.population, config.sizes.at_birth, config.sizes.later) == (600, 5, 15)
    assert (config.sizes.terms, config.vartheta, config.fitness.generations) == (20, 5.0, 50)
    assert config.primitives.constants == (-100.0, 100.0)
    assert config.elite + config.reproduction == pytest.approx(0.2)
