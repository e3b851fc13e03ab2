"""Choice among given terms against brute force: beam, elimination, dictionary."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from brute_force import best_sets, column_problem, places_of, relative_loss

from jaxsr.expressions import Term, parse, to_text
from jaxsr.expressions.printing import kind
from jaxsr.regression import RegressionProblem, Rules
from jaxsr.regression.beam import beam
from jaxsr.regression.dictionary import Dictionary
from jaxsr.regression.elimination import eliminate


@pytest.mark.parametrize("seed", range(20))
def test_a_wide_beam_ranks_every_pair_and_triple_as_brute_force_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(60, 8)) @ rng.normal(size=(8, 8))  # correlated
    problem, terms = column_problem(columns, rng.normal(size=60))
    found = list(map(places_of, beam(problem, terms, width=200)))
    pairs = [s for s in found if len(s) == 2]
    triples = [s for s in found if len(s) == 3]
    assert pairs == best_sets(columns, problem.y, 2)
    assert triples == best_sets(columns, problem.y, 3)


def test_a_narrow_beam_finds_the_best_pair_always_and_the_planted_triple() -> None:
    for seed in range(30):
        rng = np.random.default_rng([1, seed])
        columns = rng.normal(size=(80, 14)) + rng.normal(size=(80, 1))
        true = tuple(sorted(rng.choice(14, 3, replace=False).tolist()))
        y = columns[:, true] @ (rng.choice([-1.0, 1.0], 3) * rng.uniform(0.5, 2.0, 3))
        y += 0.05 * rng.normal(size=80)
        problem, terms = column_problem(columns, y)
        found = list(map(places_of, beam(problem, terms, width=5)))
        assert found[0] == best_sets(columns, y, 2)[0]
        assert found[5] == true == best_sets(columns, y, 3)[0]


@pytest.mark.parametrize("seed", range(10))
def test_a_beam_sees_a_pair_of_which_neither_explains_anything_alone(seed: int) -> None:
    rng = np.random.default_rng([2, seed])
    noise = rng.normal(size=(300, 20))
    common, y = rng.normal(size=(2, 300))
    y -= common * (common @ y) / (common @ common)
    # the target is the small difference of two columns that are almost the same
    columns = np.column_stack([common, common + 0.02 * y, noise])
    order = rng.permutation(22)
    problem, terms = column_problem(columns[:, order], y)
    true = tuple(sorted(int(np.flatnonzero(order == k)[0]) for k in (0, 1)))
    assert min(relative_loss(problem.columns([terms[k]]), y) for k in true) > 0.99
    # an addition of one term at a time begins with another
    alone = [relative_loss(problem.columns([t]), y) for t in terms]
    assert int(np.argmin(alone)) not in true
    assert places_of(beam(problem, terms, width=3)[0]) == true


@pytest.mark.parametrize("seed", range(10))
def test_a_beam_sees_a_triple_of_which_no_pair_explains_much(seed: int) -> None:
    rng = np.random.default_rng([3, seed])
    a, b, y = np.linalg.qr(rng.normal(size=(200, 3)))[0].T
    columns = np.column_stack([a, b, a + b + 0.1 * y, rng.normal(size=(200, 9))])
    problem, terms = column_problem(columns, y)
    pairs = [relative_loss(columns[:, s], y) for s in itertools.combinations(range(3), 2)]
    assert min(pairs) > 0.98
    # every pair is kept here: a triple is seen if one of its pairs is
    assert (0, 1, 2) in list(map(places_of, beam(problem, terms, width=66)))


def test_a_beam_keeps_one_set_of_a_form() -> None:
    rng = np.random.default_rng(4)
    x, z = rng.uniform(-2.0, 2.0, size=(2, 200))
    variables = {"x": x, "z": z}
    waves = [f"sin({w}*{n})" for n in "xz" for w in np.arange(0.55, 3.0, 0.4).round(2)]
    terms = [parse(text, ["x", "z"]) for text in [*waves, "x", "z", "x**2", "x**3"]]
    y = np.sin(1.35 * x) - 2.0 * np.sin(2.55 * z)
    problem = RegressionProblem(y, variables)
    found = beam(problem, terms, width=6)
    forms = [tuple(sorted(map(kind, terms))) for terms in found]
    assert len(set(forms)) == len(forms)
    assert {to_text(t) for t in found[0]} == {"sin(1.35*x)", "sin(2.55*z)"}
    # of each form of pair it is the best that stands for it, and forms come in order of loss
    columns = problem.columns(terms)
    best: dict[tuple[str, ...], float] = {}
    for s in itertools.combinations(range(len(terms)), 2):
        form = tuple(sorted(kind(terms[k]) for k in s))
        best[form] = min(best.get(form, np.inf), relative_loss(columns[:, s], y))
    pairs = [(form, s) for form, s in zip(forms, found, strict=True) if len(s) == 2]
    losses = [relative_loss(problem.columns(s), y) for _, s in pairs]
    np.testing.assert_allclose(losses, [best[form] for form, _ in pairs], atol=1e-12)
    assert losses == sorted(losses)


def test_a_beam_passes_over_columns_that_are_not_numbers_or_the_same() -> None:
    rng = np.random.default_rng(5)
    x = rng.normal(size=100)
    problem = RegressionProblem(x - x**3, {"x": x})
    terms = [parse(text, ["x"]) for text in ("log(x)", "x", "2.0*x", "0.0*x", "x**3")]
    sets = [{to_text(t) for t in s} for s in beam(problem, terms, width=9)]
    assert all(len(s) == 2 and s & {"x", "2.0*x"} and "x**3" in s for s in sets)
    assert beam(problem, terms[:2], width=9) == []


def _chain(columns: np.ndarray, y: np.ndarray) -> list[tuple[tuple[int, ...], float]]:
    """Leave out one column at a time, each time the one without which the loss is lowest."""
    left = tuple(range(columns.shape[1]))
    out = [(left, relative_loss(columns[:, left], y))]
    while len(left) > 1:
        sets = [left[:k] + left[k + 1 :] for k in range(len(left))]
        losses = [relative_loss(columns[:, s], y) for s in sets]
        left = sets[int(np.argmin(losses))]
        out.append((left, min(losses)))
    return out


@pytest.mark.parametrize("seed", range(40))
def test_elimination_is_one_by_one_removal_by_least_squares(seed: int) -> None:
    rng = np.random.default_rng([6, seed])
    rows, count = int(rng.integers(12, 80)), int(rng.integers(2, 11))
    spread = 10.0 ** rng.uniform(-4.0, 4.0, size=count)  # columns of very different size
    columns = (rng.normal(size=(rows, count)) @ rng.normal(size=(count, count))) * spread
    problem, terms = column_problem(columns, rng.normal(size=rows))
    found = eliminate(problem, terms, most=count)
    truth = _chain(columns, problem.y)
    assert [places_of(s) for s, _ in found] == [s for s, _ in truth]
    np.testing.assert_allclose([x for _, x in found], [x for _, x in truth], rtol=0, atol=1e-10)
    most = count // 2 + 1
    assert eliminate(problem, terms, most) == [pair for pair in found if len(pair[0]) <= most]


@pytest.mark.parametrize("degree", [6, 8, 10])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_elimination_of_ill_conditioned_powers(degree: int, noise: float) -> None:
    rng = np.random.default_rng(degree)
    x = rng.uniform(1.0, 2.0, size=200)
    columns = x[:, None] ** np.arange(degree + 1)
    y = x - 0.5 * x**4 + noise * rng.normal(size=200)
    assert np.linalg.cond(columns / np.linalg.norm(columns, axis=0)) > 1e6
    problem, terms = column_problem(columns, y)
    found = eliminate(problem, terms, most=degree + 1)
    assert [len(s) for s, _ in found] == list(range(degree + 1, 0, -1))
    for larger, (smaller, loss) in itertools.pairwise(found):
        assert set(places_of(smaller)) < set(places_of(larger[0]))
        # no other removal would have cost less, as far as rounding can tell
        drops = [s for s in itertools.combinations(places_of(larger[0]), len(smaller))]
        assert loss <= min(relative_loss(columns[:, s], y) for s in drops) + 1e-10
    for terms_left, loss in found:
        assert loss == pytest.approx(relative_loss(columns[:, places_of(terms_left)], y), abs=1e-10)
    if noise == 0.0:
        assert places_of(found[-2][0]) == (1, 4) and found[-2][1] < 1e-10


def test_elimination_leaves_out_what_depends_and_what_is_not_finite() -> None:
    rng = np.random.default_rng(7)
    a, b, c = rng.normal(size=(3, 50))
    columns = np.column_stack([a, b, a + b, c, np.full(50, np.nan), np.zeros(50)])
    y = a - c + 0.1 * rng.normal(size=50)
    problem, terms = column_problem(columns, y)
    found = eliminate(problem, terms, most=6)
    sets = [set(places_of(s)) for s, _ in found]
    assert len(sets[0]) == 3 and 3 in sets[0] and not sets[0] & {4, 5}
    assert found[0][1] == pytest.approx(relative_loss(columns[:, [0, 1, 3]], y), abs=1e-12)


def test_elimination_within_signs_is_weighed_within_them() -> None:
    for seed in range(10):
        rng = np.random.default_rng([8, seed])
        columns = rng.normal(size=(60, 5))
        y = columns @ np.array([1.0, -1.0, 0.5, 0.0, 0.0]) + 0.1 * rng.normal(size=60)
        names = [f"x{k}" for k in range(5)]
        terms = [Term.variable(n) for n in names]
        problem = RegressionProblem(
            y, dict(zip(names, columns.T, strict=True)), rules=Rules(signs={terms[1]: 1})
        )
        for left, loss in eliminate(problem, terms, most=5):
            places = list(places_of(left))
            free = relative_loss(columns[:, places], y)
            without = (
                relative_loss(columns[:, [k for k in places if k != 1]], y)
                if places != [1]
                else 1.0
            )
            # the wrong sign is forbidden: the term is as good as absent
            assert loss == pytest.approx(max(free, without), abs=1e-8)


def _gains(columns: np.ndarray, y: np.ndarray, held: list[int]) -> np.ndarray:
    """Return what each column would take off the loss beside those held."""
    before = relative_loss(columns[:, held], y) if held else 1.0
    out = np.array(
        [before - relative_loss(columns[:, [*held, k]], y) for k in range(columns.shape[1])]
    )
    out[held] = -1.0
    return out / before


@pytest.mark.parametrize("seed", range(20))
def test_a_dictionary_ranks_by_the_exact_gain(seed: int) -> None:
    rng = np.random.default_rng([9, seed])
    columns = rng.normal(size=(120, 30)) + 2.0 * rng.normal(size=(120, 1))
    y = columns[:, :4] @ rng.normal(size=4) + 0.5 * rng.normal(size=120)
    problem, terms = column_problem(columns * 10.0 ** rng.uniform(-3, 3, size=30), y)
    dictionary = Dictionary(problem, terms)
    for count in (0, 1, 3):
        held = rng.choice(30, count, replace=False).tolist()
        gains = _gains(columns, y, held)
        found = [int(t.name[1:]) for t in dictionary.best([terms[k] for k in held], 30 - count)]
        assert found[0] == int(np.argmax(gains))
        # single precision orders what differs by more than 1e-5 of the residual
        assert np.all(np.diff(gains[found]) < 1e-5)
        assert not set(found) & set(held)
        assert found[:5] == [int(t.name[1:]) for t in dictionary.best([terms[k] for k in held], 5)]


def test_a_dictionary_ranks_in_a_view_and_beside_known_columns() -> None:
    for seed in range(10):
        rng = np.random.default_rng([10, seed])
        samples, known = rng.normal(size=(200, 12)), rng.normal(size=(40, 2))
        weights = rng.normal(size=(40, 200))
        y = rng.normal(size=40)
        names = [f"x{k}" for k in range(12)]
        terms = [Term.variable(n) for n in names]
        variables = dict(zip(names, samples.T, strict=True))
        problem = RegressionProblem(y, variables, view=lambda c, w=weights: w @ c, fixed=known)
        seen = np.hstack([known, weights @ samples])
        gains = _gains(seen, y, [0, 1, 2])[3:]  # the known ones and x0 are held
        found = [int(t.name[1:]) for t in Dictionary(problem, terms).best([terms[0]], 4)]
        assert found == (1 + np.argsort(-gains, kind="stable")[:4]).tolist()


def test_a_dictionary_offers_nothing_of_the_wrong_sign_or_already_there() -> None:
    rng = np.random.default_rng(11)
    x, z = rng.normal(size=(2, 150))
    terms = [parse(text, ["x", "z"]) for text in ("x", "z", "2.0*x", "x + z", "log(x)", "x*z")]
    y = x + 3.0 * z - 2.0 * x * z
    problem = RegressionProblem(y, {"x": x, "z": z}, rules=Rules(signs={terms[5]: 1}))
    offered = {to_text(t) for t in Dictionary(problem, terms).best(terms[:2], 6)}
    assert offered == set()  # x + z and 2 x are there already, x z may only be positive
    free = RegressionProblem(y, {"x": x, "z": z})
    assert [to_text(t) for t in Dictionary(free, terms).best(terms[:2], 6)] == ["x*z"]
