"""Making, crossing, moving and editing terms: invariants over many draws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.evolution import Individual, MutationWeights, PrimitiveSet, SizeLimits
from jaxsr.evolution.config import PAPER_FUNCTIONS
from jaxsr.evolution.create import random_term, random_terms
from jaxsr.evolution.crossover import cross_constant, crossover, swap_subtrees
from jaxsr.evolution.mutate import mutate_constant, mutate_subtree
from jaxsr.expressions import PRIMITIVES, Term, parse, to_numpy, to_text
from jaxsr.expressions.editing import ONE, edit, shorten, simplify, split
from jaxsr.regression.rank import independent_columns, independent_in_grams

NAMES = ["t", "x", "z"]
RICH = PrimitiveSet(
    functions=(*(f for f in PAPER_FUNCTIONS if f != "integral"), "sub", "neg", "max", "min", "cosh")
)
PAPER = PrimitiveSet(functions=PAPER_FUNCTIONS, exponents=(-3.0, 3.0), real_exponents=0.5)


def is_valid(term: Term) -> bool:
    """Tell whether every node has the arguments that its primitive takes, and its own size."""
    for node in term.walk():
        if node.op in ("variable", "constant"):
            fits = not node.args and (node.op == "constant" or node.name in NAMES)
        else:
            fits = PRIMITIVES[node.op].arity in (-1, len(node.args)) and bool(node.args)
        below = list(node.walk())
        if (
            not fits
            or node.size != len(below)
            or node.operators != sum(bool(n.args) for n in below)
        ):
            return False
    return True


def test_sizes_at_birth_are_ramped() -> None:
    rng = np.random.default_rng(0)
    sizes = [term.size for k in range(5000) for term in [random_term(rng, NAMES, RICH, 1 + k % 5)]]
    counts = np.bincount(sizes, minlength=6)[1:6]
    # as many of each size as were asked for: every size can be made by some function
    np.testing.assert_array_equal(counts, [1000] * 5)


@pytest.mark.parametrize("primitives", [RICH, PAPER])
def test_operators_keep_sizes_and_make_valid_terms(primitives: PrimitiveSet) -> None:
    rng = np.random.default_rng(1)
    sizes = SizeLimits(at_birth=5, later=15, terms=5)
    pool = [
        Individual.of([random_term(rng, NAMES, primitives, 5) for _ in range(3)], 1.0)
        for _ in range(30)
    ]
    for draw in range(4000):
        a, b = (pool[rng.integers(len(pool))] for _ in range(2))
        match draw % 4:
            case 0:
                children = crossover(rng, a, b, sizes.later)
            case 1:
                children = [mutate_subtree(rng, a.terms, NAMES, primitives, sizes)]
            case 2:
                children = [mutate_constant(rng, a.terms, draw, 5.0, pool[:5])]
            case _:
                children = [cross_constant(rng, a.terms, pool[:5])]
        for child in children:
            assert len(child) == 3
            assert all(term.size <= sizes.later and is_valid(term) for term in child)
            pool[rng.integers(len(pool))] = Individual.of(child, 1.0)
    # the pool has moved on from its birth
    assert max(term.size for ind in pool for term in ind.terms) > 7


def test_a_child_that_is_too_large_is_redone_and_after_five_tries_the_parents_come_back() -> None:
    rng = np.random.default_rng(2)
    long, short = parse("sin(x)*cos(z) + t*x", NAMES), parse("x*z", NAMES)
    children = [swap_subtrees(rng, long, short, long.size) for _ in range(500)]
    assert all(max(a.size, b.size) <= long.size for a, b in children)
    unchanged = np.mean([pair == (long, short) for pair in children])
    assert 0.0 < unchanged < 0.3  # a swap of equal nodes changes nothing either
    # no exchange keeps both below three nodes
    assert swap_subtrees(rng, long, short, 2) == (long, short)


def test_crossover_cuts_chains_and_shuns_bare_operands() -> None:
    rng = np.random.default_rng(3)
    a = Individual.of([parse("sin(sin(x))", NAMES)], 1.0)
    for _ in range(200):
        for (term,) in crossover(rng, a, a, 15):
            assert shorten(term) == term
    # with one bare and one made term on each side, a bare pair is hardly ever drawn
    mixed = Individual.of([parse("x", NAMES), parse("sin(z)", NAMES)], 1.0)
    other = Individual.of([parse("t", NAMES), parse("cos(z)", NAMES)], 1.0)
    bare = [{parse("x", NAMES), parse("t", NAMES)}]
    swapped = sum(
        {first[0], second[0]} == bare[0] and first[0] == parse("t", NAMES)
        for first, second in (crossover(rng, mixed, other, 15) for _ in range(500))
    )
    assert swapped < 10


def test_constants_cross_between_individuals() -> None:
    rng = np.random.default_rng(4)
    terms = (parse("sin(2.0*t + 3.0)", NAMES), parse("x", NAMES))
    best = [Individual.of([parse("cos(7.0*t)", NAMES), parse("exp(8.0*x)", NAMES)], 0.1)]
    seen = set()
    for _ in range(200):
        child = cross_constant(rng, terms, best)
        assert child[1] == terms[1]
        values = [n.value for n in child[0].walk() if n.is_constant]
        before = [2.0, 3.0]
        changed = [new for new, old in zip(values, before, strict=True) if new != old]
        assert len(changed) == 1
        seen.add((values.index(changed[0]), changed[0]))
    assert seen == {(0, 7.0), (0, 8.0), (1, 7.0), (1, 8.0)}
    assert cross_constant(rng, (parse("x", NAMES),), best) == (parse("x", NAMES),)
    assert cross_constant(rng, terms, []) == terms


@pytest.mark.parametrize("vartheta", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("generation", [0, 3, 50, 500])
def test_steps_of_constants_are_uniform_in_the_range_of_eq_7(
    vartheta: float, generation: int
) -> None:
    rng = np.random.default_rng(5)
    reach = vartheta / (vartheta + 2.0 * generation)
    term = parse("sin(3.0*t)", NAMES)
    steps = []
    for _ in range(2000):
        (moved,) = mutate_constant(rng, [term], generation, vartheta)
        steps.append(next(n.value for n in moved.walk() if n.is_constant) - 3.0)
    shares = (np.sort(steps) + reach) / (2.0 * reach)
    assert shares[0] >= -1e-12 and shares[-1] <= 1.0 + 1e-12
    # Kolmogorov-Smirnov against the uniform law, at a chance of one in a thousand
    expected = (np.arange(2000) + 0.5) / 2000
    assert np.max(np.abs(shares - expected)) < 1.95 / math.sqrt(2000)


def test_exponents_at_birth_are_whole_or_real_as_asked() -> None:
    rng = np.random.default_rng(6)

    def drawn(primitives: PrimitiveSet) -> list[float]:
        terms = [random_term(rng, ["x"], primitives, 3) for _ in range(600)]
        return [term.args[1].value for term in terms if term.op == "pow"]

    whole = drawn(PrimitiveSet(functions=("pow",), exponents=(-2.5, 3.0)))
    assert set(whole) == {-2.0, -1.0, 2.0, 3.0}
    real = drawn(PrimitiveSet(functions=("pow",), exponents=(0.2, 0.9), real_exponents=1.0))
    assert min(real) < 0.25 and max(real) > 0.85 and all(0.2 <= e <= 0.9 for e in real)
    mixed = drawn(PrimitiveSet(functions=("pow",), exponents=(2.0, 3.0), real_exponents=0.25))
    assert 0.15 < np.mean([e not in (2.0, 3.0) for e in mixed]) < 0.35


def test_leaves_are_variables_constants_and_one() -> None:
    rng = np.random.default_rng(7)
    primitives = PrimitiveSet(functions=("add",), constants=(1e-5, 4e-5))
    leaves = [random_term(rng, NAMES, primitives, 1) for _ in range(2000)]
    assert 0.77 < np.mean([leaf.is_variable for leaf in leaves]) < 0.83
    assert {leaf.name for leaf in leaves if leaf.is_variable} == set(NAMES)
    assert 0.02 < np.mean([leaf == ONE for leaf in leaves]) < 0.07
    values = [leaf.value for leaf in leaves if leaf.is_constant and leaf != ONE]
    assert all(1e-5 <= v <= 4e-5 for v in values) and len(set(values)) > 200
    assert all(leaf.is_constant for leaf in (random_term(rng, [], primitives, 1) for _ in range(9)))


@pytest.mark.parametrize(
    "make",
    [
        lambda: PrimitiveSet(functions="sin"),  # type: ignore[arg-type]  # the point of the test
        lambda: PrimitiveSet(functions=("add", "piecewise")),
        lambda: PrimitiveSet(functions=("integrate",)),
        lambda: PrimitiveSet(constants=(1.0, 1.0)),
        lambda: PrimitiveSet(constants=(0.0, math.inf)),
        lambda: PrimitiveSet(constants=(math.nan, 1.0)),
        lambda: PrimitiveSet(exponents=(3.0, 2.0)),
        lambda: PrimitiveSet(exponents=(0.2, 0.9)),
        lambda: PrimitiveSet(real_exponents=1.5),
        lambda: SizeLimits(at_birth=0),
        lambda: SizeLimits(at_birth=2.5),  # type: ignore[arg-type]  # the point of the test
        lambda: SizeLimits(at_birth=16, later=15),
        lambda: SizeLimits(terms=0),
        lambda: MutationWeights(crossover=-1.0),
        lambda: MutationWeights(add=math.nan),
    ],
)
def test_wrong_sets_limits_and_weights_are_refused_in_one_line(make) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_simplifying_keeps_values_is_idempotent_and_hardly_grows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = dict(zip(NAMES, rng.uniform(-2.0, 2.0, (3, 40)), strict=True))
    data["z"][:4] = 0.0  # a quantised sensor often reads zero
    compared = 0
    for _ in range(600):
        term = random_term(rng, NAMES, RICH, int(rng.integers(1, 16)))
        form = simplify(term)
        assert is_valid(form)
        assert simplify(form) == form, to_text(term)
        # -1.0*x for -x, x**2*z**2 for (x*z)**2 and log(x) + 0.7 for log(2*x) take a few more
        assert form.size <= term.size + 6, to_text(term)
        parts = [to_numpy(node)(data) * np.ones(40) for node in term.walk()]
        # rewrites hold where every part is finite; beyond that exp underflows
        fine = np.all([np.isfinite(p) & (np.abs(p) < 1e8) for p in parts], axis=0)
        fine &= np.all([(np.abs(p) > 1e-250) | (p == 0.0) for p in parts], axis=0)
        with np.errstate(all="ignore"):
            apart = sum((c * to_numpy(p)(data) * np.ones(40) for c, p in split(term)), np.zeros(40))
        for value in (to_numpy(form)(data) * np.ones(40), apart):
            # an exponential multiplies the rounding of a sum that was written in another order
            close = np.isclose(value[fine], parts[0][fine], rtol=1e-5, atol=1e-7)
            assert np.count_nonzero(~close) <= 1, to_text(term)
        compared += bool(np.any(fine))
    assert compared > 300


@pytest.mark.parametrize("seed", range(3))
def test_edited_individuals_have_no_repeats_nothing_hopeless_and_stay_as_they_are(
    seed: int,
) -> None:
    rng = np.random.default_rng(100 + seed)
    for _ in range(200):
        terms = random_terms(rng, NAMES, RICH, 12, 4)
        assert len(set(terms)) == len(terms)
        for term in terms:
            assert all(math.isfinite(node.value) for node in term.walk())
            assert not (term.op == "mul" and term.args[0].is_constant)  # outer coefficient 1
        assert edit(terms) == terms


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("sign(x**2 + 1)", "1.0"),
        ("sign(-1 - Abs(x))", "-1.0"),
        ("sign(Abs(x))", "sign(Abs(x))"),  # 0 at rest: not 1
        ("Abs(x**2 + exp(z))", "exp(z) + x**2"),
        ("Abs(-2*x**4)", "2.0*x**4"),
        ("Abs(x*Abs(z))", "Abs(Abs(z)*x)"),
        ("Heaviside(exp(x))", "1.0"),
        ("Heaviside(-cosh(x) - 1)", "0.0"),
        ("Heaviside(3*x)", "Heaviside(x)"),
        ("sqrt(4*x)", "2.0*sqrt(x)"),
        ("sqrt(2 - 2*x)", "1.4142135623730951*sqrt(1.0 - x)"),
        ("exp(log(x))", "x"),
        ("(4*x)**0.5", "2.0*x**0.5"),
        ("sin(z - x)", "-1.0*sin(x - z)"),
        ("cos(x - t - 2)", "cos(t + 2.0 - x)"),
        ("Abs(x*z)**2", "x**2*z**2"),
        ("sign(0.7645 - 0.7645*sign(t))", "-1.0*sign(sign(t) - 1.0)"),
        ("sign(tanh(x))", "sign(x)"),
        ("3/(2*x)", "1.5/x"),
    ],
)
def test_sign_definite_arguments_and_scales(text: str, expected: str) -> None:
    assert to_text(simplify(parse(text, NAMES))) == expected


@pytest.mark.parametrize(
    "text",
    ["sqrt(-exp(x))", "log(-x**2)", "sqrt(-1 - x**2)", "1/(x - x)", "x/(2*z - z - z)", "log(-2)",
     "sin(sqrt(-2))", "z*log(0)", "(-2)**0.5*x", "exp(1000)*x", "Abs(1e-300*x + 1e90)",
     "(1e60*x)**6"],
)  # fmt: skip
def test_terms_that_are_nowhere_finite_go(text: str) -> None:
    kept = parse("cos(x)", NAMES)
    assert edit([parse(text, NAMES), kept]) == (kept,)


def test_an_integral_is_linear_in_what_it_integrates() -> None:
    def read(text: str) -> Term:
        return parse(text, NAMES, integrals=True)

    assert simplify(read("integral(-2*x)")) == read("-2.0*integral(x)")
    assert simplify(read("integral(3)")) == read("3.0*integral(1.0)")
    assert simplify(read("integral_over(2*x, 4*z + 5)")) == read("8.0*integral_over(x, z)")
    assert simplify(read("integral_over(x, 7)")) == Term.constant(0.0)
    parts = {to_text(term): c for c, term in split(read("integral(2*x + 3*z*z - 1)"))}
    assert parts == {"integral(x)": 2.0, "integral(z**2)": 3.0, "integral(1.0)": -1.0}


def test_independent_columns_keep_the_simpler_of_those_that_say_the_same() -> None:
    rng = np.random.default_rng(8)
    a, b, c = rng.normal(size=(3, 50))
    theta = np.column_stack([a + b, a, 2.0 * a, b, c, np.zeros(50), a - b + c, np.full(50, np.nan)])
    complexity = [3, 1, 2, 1, 1, 1, 5, 1]
    assert independent_columns(theta, complexity) == [1, 3, 4]
    assert independent_columns(theta) == [0, 1, 4]
    assert independent_columns(np.zeros((0, 3))) == []
    assert independent_columns(theta[:2, :5], complexity[:5]) == [1, 3]  # no more than samples
    with pytest.raises(InputError, match="order"):
        independent_columns(theta, [1, 2])


@pytest.mark.parametrize("scale", [1e-120, 1.0, 1e120])
def test_near_dependence_is_told_from_dependence(scale: float) -> None:
    rng = np.random.default_rng(9)
    a, b, e = rng.normal(size=(3, 200))
    for share, kept in ((1e-5, [0, 1, 2]), (1e-11, [0, 1])):
        theta = np.column_stack([a, b, a - 3.0 * b + share * e]) * scale
        assert independent_columns(theta) == kept


def test_many_grams_at_once_say_what_the_columns_say() -> None:
    rng = np.random.default_rng(10)
    grams, expected = [], []
    for _ in range(100):
        rank, count = int(rng.integers(1, 6)), 8
        theta = rng.normal(size=(40, rank)) @ rng.normal(size=(rank, count))
        theta[:, int(rng.integers(count))] = 0.0
        norms = np.linalg.norm(theta, axis=0)
        theta = theta / np.where(norms > 0.0, norms, 1.0)
        grams.append(theta.T @ theta)
        expected.append(independent_columns(theta, tolerance=1e-5))
    kept = independent_in_grams(np.array(grams))
    assert [list(np.flatnonzero(row)) for row in kept] == expected
