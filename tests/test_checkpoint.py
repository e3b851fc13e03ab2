"""Checkpoints: a stopped search goes on as if it had not stopped; wrong files are refused."""

import json
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sparse

from jaxsr._result import InputError
from jaxsr.evolution import FitnessRule, PrimitiveSet, SearchConfig, init, search, step
from jaxsr.evolution.checkpoint import Keeper, fingerprint, load, save
from jaxsr.evolution.create import random_term
from jaxsr.evolution.state import SearchState
from jaxsr.expressions import Term, parse
from jaxsr.regression import RegressionProblem, Rules, Sampling, TargetErrors
from jaxsr.regression.judging import Judge

CONFIG = SearchConfig(population=40, generations=30, refined=4, patience=30)


def _problem(seed=0, fixed=False, n=250, **options):
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 10.0, n)
    x, v = np.sin(1.3 * t) + 0.3 * rng.normal(size=n), rng.normal(size=n)
    y = -4.0 * x - 0.5 * v * np.abs(v) + 2.0 * np.sin(3.0 * t + 1.0) + 0.1 * rng.normal(size=n)
    columns = np.column_stack([np.ones(n), x**3]) if fixed else None
    return RegressionProblem(y, {"t": t, "x": x, "v": v}, fixed=columns, **options)


def _advanced(rng, state, problem, generations):
    for _ in range(generations):
        state, _ = step(rng, state, problem)
    return state


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "refined", "fixed"),
    [
        (0, 4, False),
        (1, 0, False),
        (2, 0, True),
        (3, 4, True),
        pytest.param(4, 4, False, marks=pytest.mark.slow),
    ],
)
def test_stopped_and_resumed_is_bit_for_bit_the_same(tmp_path, seed, refined, fixed):
    config = replace(CONFIG, population=30, refined=refined)
    rng, problem = np.random.default_rng(seed), _problem(seed, fixed)
    state = _advanced(rng, init(rng, problem, config), problem, 3)
    save(tmp_path / "c.json", state, rng, problem)
    straight = _advanced(rng, state, problem, 5)

    again = _problem(seed, fixed)
    resumed, generator = load(tmp_path / "c.json", again, config)
    assert resumed == state
    resumed = _advanced(generator, resumed, again, 5)
    assert resumed.front.members == straight.front.members  # floats compared exactly
    assert resumed == straight
    assert generator.bit_generator.state == rng.bit_generator.state


@pytest.mark.slow
def test_writing_changes_nothing(tmp_path):
    fronts = []
    for written in (False, True):
        rng, problem = np.random.default_rng(5), _problem(5)
        state = init(rng, problem, CONFIG)
        keeper = Keeper(tmp_path / "c.json", problem, CONFIG, every=0.0)
        for _ in range(4):
            state, _ = step(rng, state, problem)
            if written:
                keeper.keep(state, rng)
        fronts.append(state.front)
    assert fronts[0] == fronts[1]


_OTHER_PROCESS = """
import sys
import numpy as np
sys.path.insert(0, {tests!r})
from test_checkpoint import CONFIG, _advanced, _problem
from jaxsr.evolution.checkpoint import load, save
problem = _problem(1)
state, rng = load({path!r}, problem, CONFIG)
state = _advanced(rng, state, problem, 3)
save({path!r}, state, rng, problem)
"""


@pytest.mark.slow
def test_another_process_goes_on_the_same(tmp_path):
    """The order in which Python walks its sets differs by process; nothing may depend on it."""
    path = tmp_path / "c.json"
    rng, problem = np.random.default_rng(1), _problem(1)
    state = _advanced(rng, init(rng, problem, CONFIG), problem, 2)
    save(path, state, rng, problem)
    tests = str(__file__).rsplit("/", 1)[0]
    code = _OTHER_PROCESS.format(tests=tests, path=str(path))
    subprocess.run([sys.executable, "-c", code], check=True)
    theirs, _ = load(path, _problem(1), CONFIG)
    assert theirs == _advanced(rng, state, problem, 3)


@pytest.mark.long
def test_an_interrupt_inside_a_generation_goes_back_to_the_last_whole_one(tmp_path):
    rng, problem = np.random.default_rng(2), _problem(2)
    keeper = Keeper(tmp_path / "c.json", problem, CONFIG, every=1e9)
    state = _advanced(rng, init(rng, problem, CONFIG), problem, 2)
    keeper.keep(state, rng)
    assert not keeper.path.exists()
    rng.normal(size=17)  # a generation began and was broken off
    keeper.close()
    generator = np.random.default_rng(99)
    back = Keeper(tmp_path / "c.json", _problem(2), CONFIG).resume(generator)
    assert back == state
    undisturbed, fresh = np.random.default_rng(2), _problem(2)
    straight = _advanced(undisturbed, init(undisturbed, fresh, CONFIG), fresh, 2)
    assert straight == state
    assert generator.bit_generator.state == undisturbed.bit_generator.state


def test_keeper_without_a_file_starts_anew_and_writes_when_due(tmp_path):
    rng, problem = np.random.default_rng(0), _problem()
    keeper = Keeper(tmp_path / "sub" / "c.json", problem, CONFIG, every=0.0)
    assert keeper.resume(rng) is None
    keeper.keep(init(rng, problem, CONFIG), rng)
    assert keeper.path.exists()
    assert [p.name for p in keeper.path.parent.iterdir()] == ["c.json"]
    with pytest.raises(InputError, match="every"):
        Keeper(tmp_path / "c.json", problem, CONFIG, every=math.nan)


class _Stop(Exception):
    pass


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "generations"), [(0, 12), *((k, 16) for k in range(4))])
def test_a_search_broken_off_again_and_again_ends_as_if_it_never_was(tmp_path, seed, generations):
    """Restarts draw random numbers too; no break may make one of them twice or never."""
    config = replace(CONFIG, population=20, generations=generations, refined=2, patience=2)
    rng = np.random.default_rng(seed)
    straight, reason = search(rng, _problem(seed, n=60), config)

    breaks, restarted = 0, False
    for _ in range(60):
        problem, generator = _problem(seed, n=60), np.random.default_rng(1234)
        if breaks == 0:
            generator = np.random.default_rng(seed)
        keeper = Keeper(tmp_path / "c.json", problem, config, every=0.0)

        def stop_after_one(info):
            raise _Stop

        try:
            resumed, again = search(
                generator, problem, config, keeper=keeper, progress=stop_after_one
            )
            break
        except _Stop:
            breaks += 1
            state, _ = load(tmp_path / "c.json", problem, config)
            restarted |= state.fruitless > 0
    assert breaks > 4 and restarted
    assert resumed == straight and again is reason
    assert generator.bit_generator.state == rng.bit_generator.state


@pytest.mark.long
@pytest.mark.parametrize("kind", ["sparse", "judge"])
def test_views_and_judges_do_not_remember_what_they_were_asked(tmp_path, kind):
    def make():
        if kind == "judge":
            plain = _problem(5)
            return _problem(3, judge=Judge(plain.variables, plain.y))
        rng = np.random.default_rng(3)
        matrix = sparse.random_array((90, 250), density=0.2, rng=rng, format="csr")
        base = _problem(3)
        return RegressionProblem(matrix @ base.y, base.variables, view=lambda c: matrix @ c)

    rule = FitnessRule(data="validation" if kind == "judge" else "training")
    config = replace(CONFIG, population=30, fitness=rule)
    rng, problem = np.random.default_rng(0), make()
    state = _advanced(rng, init(rng, problem, config), problem, 2)
    save(tmp_path / "c.json", state, rng, problem)
    straight = _advanced(rng, state, problem, 3)
    again = make()
    resumed, generator = load(tmp_path / "c.json", again, config)
    assert _advanced(generator, resumed, again, 3) == straight


@pytest.mark.parametrize("name", ["PCG64", "MT19937", "Philox", "SFC64", "PCG64DXSM"])
def test_every_generator_comes_back(tmp_path, name):
    rng = np.random.Generator(getattr(np.random, name)(3))
    problem = _problem()
    state = init(rng, problem, CONFIG)
    rng.integers(10, dtype=np.int32)  # leaves half a word behind
    save(tmp_path / "c.json", state, rng, problem)
    _, back = load(tmp_path / "c.json", _problem(), CONFIG)
    np.testing.assert_array_equal(back.integers(1 << 30, size=50), rng.integers(1 << 30, size=50))


def test_terms_come_back_exactly_whatever_the_grammar_thinks_of_them(tmp_path):
    rng, problem = np.random.default_rng(4), _problem()
    primitives = PrimitiveSet(functions=("add", "mul", "div", "sin", "pow", "neg", "log", "tanh"))
    odd = [
        Term.apply("neg", Term.constant(2.0)),  # text gives -2.0
        Term.apply("pow", Term.variable("x"), Term.constant(1e9)),  # more than the grammar reads
        Term.variable(""),
        Term.apply("mul", Term.constant(0.1 + 0.2), Term.variable("x")),
        Term.apply("mul", Term.constant(-5e-324), Term.variable("x")),
        parse("Piecewise((x, v > 0.0), (0.5, True))"),
    ]
    drawn = [random_term(rng, ["x", "v"], primitives, 9) for _ in range(300)]
    state = init(rng, problem, CONFIG)
    state = replace(state, refined=frozenset((term, odd[0]) for term in [*odd, *drawn]))
    save(tmp_path / "c.json", state, rng, problem)
    back, _ = load(tmp_path / "c.json", _problem(), CONFIG)
    assert back.refined == state.refined
    assert math.isinf(init(rng, problem, CONFIG).rule.best_loss) and back.rule == state.rule


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("checkpoint") / "c.json"
    rng, problem = np.random.default_rng(0), _problem()
    save(path, init(rng, problem, CONFIG), rng, problem)
    return path


def _refused(path, match, problem=None, config=CONFIG):
    with pytest.raises(InputError, match=match) as error:
        load(path, problem or _problem(), config)
    assert "\n" not in str(error.value) and str(path) in str(error.value)


def test_other_data_and_other_settings_are_refused(written):
    _refused(written, "other data", _problem(1))
    _refused(written, "other data", _problem(0, fixed=True))
    _refused(written, "other settings", config=replace(CONFIG, population=50))
    primitives = PrimitiveSet(constants=(-1.0, 1.0))
    _refused(written, "other settings", config=replace(CONFIG, primitives=primitives))


def test_a_longer_search_goes_on_from_a_shorter_one(written):
    state, _ = load(written, _problem(), replace(CONFIG, generations=200))
    assert state.config.generations == 200


def test_fingerprint_sees_values_names_and_time():
    marks = {fingerprint(_problem(seed)) for seed in range(5)}
    assert len(marks) == 5
    problem = _problem()
    y, columns = problem.y, problem.variables
    renamed = RegressionProblem(y, {"t": columns["t"], "v": columns["x"], "x": columns["v"]})
    other_time = RegressionProblem(y, columns, sampling=Sampling(time="x"))
    nudged = RegressionProblem(np.nextafter(y, np.inf), columns)
    rougher = RegressionProblem(y, columns, errors=TargetErrors(floor=1e-3))
    bound = RegressionProblem(y, columns, rules=Rules(signs={parse("x"): -1}))
    other_rows = RegressionProblem(y, columns, judge=Judge(columns, y + 1.0))
    problems = (problem, renamed, other_time, nudged, rougher, bound, other_rows)
    assert len({fingerprint(p) for p in problems}) == len(problems)
    bound.solve([[parse("x"), parse("v")]])  # what was asked of a problem leaves no mark
    assert fingerprint(bound) == fingerprint(
        RegressionProblem(y, columns, rules=Rules(signs={parse("x"): -1}))
    )


def test_damaged_and_foreign_files_are_refused(written, tmp_path):
    text = written.read_text()
    path = tmp_path / "bad.json"
    _refused(path, "cannot be read")
    body = json.loads(text)
    members = body["body"]["state"]["fields"]["population"]
    members[0]["fields"]["loss"] *= 1.0 + 1e-15
    lost = {**body, "body": {k: v for k, v in body["body"].items() if k != "rng"}}
    cases = [text[: len(text) // 2], "", "[]", "null", '{"schema": "x"}', "[" * 100_000,
             json.dumps(body), json.dumps(lost)]  # fmt: skip
    for content in cases:
        path.write_text(content)
        _refused(path, "checkpoint")
    path.write_bytes(b"\xff\xfe\x00garbage")
    _refused(path, "checkpoint")


def test_a_file_of_another_version_is_refused(tmp_path, monkeypatch):
    rng, problem = np.random.default_rng(0), _problem()
    state = init(rng, problem, CONFIG)
    monkeypatch.setattr("jaxsr.evolution.checkpoint._parts_of", lambda kind, seen: [SearchState])
    save(tmp_path / "c.json", state, rng, problem)
    _refused(tmp_path / "c.json", "another version")
