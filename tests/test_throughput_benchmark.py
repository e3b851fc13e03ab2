"""The benchmark of throughput: its populations, its peers, its clock and its judge of rounding."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import jax

from benchmarks import first_evaluation, peers, scaling, throughput, throughput_gpu
from benchmarks.naive_stack import NaiveStack
from benchmarks.rounding import Reference, reference
from benchmarks.throughput_cases import (
    BINARY,
    UNARY,
    VARIABLES,
    Population,
    distinct_population,
    random_population,
    samples,
)
from benchmarks.throughput_plots import plot
from benchmarks.timing import Pairs, alternated, exponent, spread
from jaxsr import compile_terms
from jaxsr.expressions import Term, parse

DRAWS = {"random": random_population, "distinct": distinct_population}
TINY = throughput.Plan(
    terms=20,
    repeats=3,
    slow_repeats=2,
    rows=(20, 50),
    new_rows=(20, 50),
    scaling_rows=(20, 60, 180),
    populations=(5, 15),
    term_sizes=(3, 5),
    agreement_rows=30,
    population=20,
    generations=1,
    memory_samples=0,
)


@pytest.fixture(scope="module", params=DRAWS)
def population(request: pytest.FixtureRequest) -> Population:
    return DRAWS[request.param](np.random.default_rng(3), 400)


@pytest.mark.parametrize("draw", DRAWS.values())
@pytest.mark.parametrize("size", [3, 4, 5, 6, 7, 8, 15, 31])
def test_terms_have_the_size_asked(draw: type, size: int) -> None:
    assert {t.size for t in draw(np.random.default_rng(size), 60, [size]).terms} == {size}


def test_no_subtree_can_be_folded(population: Population) -> None:
    inner = [node for term in population.terms for node in term.walk() if node.args]
    assert all(node.variables for node in inner)
    assert {node.op for node in inner} == {*BINARY, *UNARY}


def test_same_seed_same_population(population: Population) -> None:
    again = DRAWS[population.name](np.random.default_rng(3), 400)
    other = DRAWS[population.name](np.random.default_rng(4), 400)
    assert again.terms == population.terms != other.terms


def test_share_of_unique_nodes(population: Population) -> None:
    terms = (parse("sin(x1 + 2*x2)", VARIABLES), parse("cos(2*x2)", VARIABLES))
    # 2*x2 occurs twice among five inner nodes
    assert Population("", terms).unique_fraction == pytest.approx(4 / 5)
    assert Population("", terms).nodes == 6 + 4
    assert population.unique_fraction == 1.0 or population.name == "random"
    assert population.unique_fraction > 0.5


def machines(population: Population, data: np.ndarray) -> dict[str, np.ndarray]:
    theta = {
        "ours": compile_terms(population.terms, VARIABLES).evaluate(data).T,
        "naive": NaiveStack(population.terms, VARIABLES).evaluate(data),
    }
    if not peers.missing("pyoperon"):
        operon = peers.OperonTrees(population.terms, VARIABLES, data)
        theta["pyoperon"] = operon.evaluate()
    if not peers.missing("gplearn"):
        programs = peers.GplearnPrograms(population.terms, VARIABLES)
        theta["gplearn"] = programs.evaluate(data)
    return theta


@pytest.mark.long
def test_all_machines_evaluate_the_same_trees(population: Population) -> None:
    data = samples(40, 5)
    truth = reference(population.terms, VARIABLES, data)
    for name, theta in machines(population, data).items():
        facts = truth.compare(theta)
        assert facts["beyond_the_rounding_bound"] == 0, name
        assert facts["finite_in_one_only_where_float32_decides"] == 0, name
        assert facts["largest_relative_where_float32_can"] < 1e-5, name
        assert facts["share_where_float32_can"] > 0.9


@pytest.mark.long
@pytest.mark.parametrize("text", ["x1 - x2", "x1/x2", "(x1 - x2)/(x3 - 2)", "1 - sqrt(Abs(x1))/x2"])
def test_peers_keep_the_order_of_arguments(text: str) -> None:
    data = samples(30, 1)
    one = Population("", (parse(text, VARIABLES),))
    columns = dict(zip(VARIABLES, data.T.astype(float), strict=True))
    truth = eval(text, {"sqrt": np.sqrt, "Abs": np.abs}, columns)
    for name, theta in machines(one, data).items():
        # cancellation costs at most a few digits on these samples
        assert theta[0] == pytest.approx(truth, rel=1e-4, abs=1e-5), name


def judged(terms: list[str], data: np.ndarray) -> tuple[list[Term], Reference]:
    read = [parse(t, VARIABLES) for t in terms]
    return read, reference(read, VARIABLES, data)


def test_float64_rounded_passes_and_a_wrong_digit_is_seen() -> None:
    data = samples(200, 2)
    _, truth = judged(["sin(x1*x2) + x3", "exp(x1)/(x2 + 10)", "tanh(x1) - 0.5"], data)
    good = truth.theta.astype(np.float32)
    assert truth.compare(good)["beyond_the_rounding_bound"] == 0
    wrong = good.copy()
    wrong[1, 17] *= 1.0001
    facts = truth.compare(wrong)
    assert facts["beyond_the_rounding_bound"] == 1
    assert facts["largest_relative_where_float32_can"] == pytest.approx(1e-4, rel=0.01)
    wrong[1, 17] = np.inf
    assert truth.compare(wrong)["finite_in_one_only_where_float32_decides"] == 1


def test_bounds_hold_for_float32_arithmetic(population: Population) -> None:
    data = samples(30, 9)
    theta = compile_terms(population.terms, VARIABLES).evaluate(data).T
    truth = reference(population.terms, VARIABLES, data)
    sure = np.isfinite(truth.bound) & np.isfinite(theta)
    assert np.all(np.abs(theta[sure] - truth.theta[sure]) <= truth.bound[sure])
    # and are not idle: the median is a few units in the last place
    size = np.maximum(np.abs(truth.theta[sure]), 1e-30)
    assert np.median(truth.bound[sure] / size) < 1e-6


@pytest.mark.parametrize(
    "text", ["sin(exp(20 + x1))", "(x1 + 1000000.0) - 1000000.0", "log(x1 - x1)"]
)
def test_nothing_is_asked_where_float32_cannot_know(text: str) -> None:
    _, truth = judged([text], samples(50, 1))
    facts = truth.compare(truth.theta.astype(np.float32))
    assert facts["share_where_float32_can"] == 0.0
    assert facts["largest_relative_where_float32_can"] == 0.0


def test_a_lost_value_stays_lost() -> None:
    # exp overflows in float32: what follows from it is not decided, though tanh(inf) is one
    _, truth = judged(["tanh(exp(200 + x1) - exp(199 + x2))"], samples(20, 1))
    assert np.all(np.isinf(truth.bound))


def test_spread_and_ratios() -> None:
    assert spread([3.0, 1.0, 2.0, 5.0, 4.0]).median == 3.0
    facts = Pairs((1.0, 2.0, 4.0), (3.0, 4.0, 4.0)).document(8.0, "peer")
    assert facts["ours"]["median"] == 4.0 and facts["peer"]["median"] == 2.0
    assert facts["ratio_of_medians"] == 2.0
    assert facts["paired_ratio"]["median"] == 2.0
    assert facts["paired_ratio"]["quartile_1"] == 1.5


def test_pairs_are_taken_in_turns() -> None:
    order: list[str] = []
    pairs = alternated(lambda: order.append("A"), lambda: order.append("B"), 3)
    assert "".join(order) == "AB" * 4 and len(pairs.ours) == 3


@pytest.mark.parametrize("power", [0.7, 1.0, 1.3])
def test_exponent_of_a_power_law(power: float) -> None:
    rows = np.array([1e3, 1e4, 1e5, 1e6])
    assert exponent(rows.tolist(), (2e-9 * rows**power).tolist()) == pytest.approx(power)


@pytest.mark.slow
def test_every_section_runs_and_is_drawn(tmp_path: Path) -> None:
    body = {name: section(TINY) for name, section in throughput.SECTIONS.items() if name != "cold"}
    assert len(body["raw"]["runs"]) == 4
    assert body["scaling"]["rows"]["exponent_ours"] < 1.5
    assert body["new_population"]["20_rows"]["repeated"]["repeats"] == 3
    plot(body, tmp_path / "throughput.png")
    assert (tmp_path / "throughput.png").read_bytes().startswith(b"\x89PNG")


def test_without_a_gpu_nothing_is_invented() -> None:
    if any(device.platform == "gpu" for device in jax.devices()):
        pytest.skip("a GPU is at hand")
    facts = throughput_gpu.measure(20, [100], 1)
    assert facts["measured"] is False and "points" not in facts


@pytest.mark.slow
def test_the_path_of_the_gpu_on_cpu_devices() -> None:
    cpu = jax.local_devices(backend="cpu")[0]
    facts = throughput_gpu.compare(cpu, cpu, 20, [100, 200], 3)
    assert [p["rows"] for p in facts["points"]] == [100, 200]
    assert facts["copy_bytes_per_second"] > 1e8
    assert all(0.0 < p["share_of_bandwidth_bound"] for p in facts["points"])


@pytest.mark.slow
def test_a_cold_process() -> None:
    facts = first_evaluation.cold(50, 100)
    for run in facts.values():
        assert run["first_seconds"] >= 0.5 * run["second_seconds"] > 0.0


@pytest.mark.long
def test_scaling_compares_equal_work() -> None:
    facts = scaling.in_term_size([3, 9], 1)
    nodes = [p["nodes"] for p in facts["points"]]
    assert nodes[0] == pytest.approx(nodes[1], rel=0.01)
