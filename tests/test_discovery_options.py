"""What a caller may demand of discover: checkpoints, units, signs, integrals, few data."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxsr
from jaxsr._progress import Silent
from jaxsr._result import InputError
from jaxsr.discovery.found import without_integrals
from jaxsr.discovery.known import binding_units
from jaxsr.evaluation import ColumnCache
from jaxsr.evolution import FitnessRule, PrimitiveSet, SearchConfig, search
from jaxsr.expressions import parse, to_text
from jaxsr.expressions.editing import edit
from jaxsr.models import Simulator
from jaxsr.models.reading import read_model
from jaxsr.models.simulation import simulate_to_csv
from jaxsr.recordings import Recording
from jaxsr.regression import InUnits, RegressionProblem, Rules, Sampling

QUICK = SearchConfig(population=40, refined=3, generations=12, restarts=1, patience=3)
WITH_INTEGRALS = PrimitiveSet(functions=("add", "mul", "integral"))


def _oscillator(seed=0, n=160, noise=0.05):
    """q'' = -4 q - 0.5 q'|q'| + 3 sin(2 t), accelerations with noise."""
    rng = np.random.default_rng(seed)

    def rates(t, x):
        return [x[1], -4.0 * x[0] - 0.5 * x[1] * np.abs(x[1]) + 3.0 * np.sin(2.0 * t)]

    t = np.linspace(0.0, 12.0, n)
    found = solve_ivp(rates, (0.0, 12.0), [1.0, 0.5], rtol=1e-10, atol=1e-10, t_eval=t)
    q, v = found.y
    a = np.array(rates(t, found.y)[1])
    a = a + noise * np.std(a) * rng.normal(size=n)
    return Recording(f"run{seed}", t, {"q": q, "v": v, "dq": v, "dv": a})


ROLES = {"states": ["q", "v"], "derivatives": ["dq", "dv"]}


class _Stop(Exception):
    pass


class _BrokenOff(Silent):
    """Fail at the n-th update."""

    def __init__(self, after):
        self.left = after

    def update(self, fraction, text=""):
        self.left -= 1
        if self.left == 0:
            raise _Stop


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0])
def test_a_discovery_broken_off_ends_as_if_it_never_was(tmp_path, seed):
    call = {**ROLES, "config": QUICK, "seed": seed}
    straight = jaxsr.discover([_oscillator(seed)], **call)
    for after in (1, 3):
        with pytest.raises(_Stop):
            jaxsr.discover(
                [_oscillator(seed)], **call, checkpoint=tmp_path, progress=_BrokenOff(after)
            )
    assert [p.name for p in tmp_path.iterdir()] == ["v.json"]  # q' = v is recognised
    resumed = jaxsr.discover([_oscillator(seed)], **call, checkpoint=tmp_path)
    assert [e.expression for e in resumed.equations] == [e.expression for e in straight.equations]
    assert resumed.pareto.equals(straight.pareto)
    again = jaxsr.discover([_oscillator(seed)], **call, checkpoint=tmp_path)  # it is over
    assert again.pareto.equals(straight.pareto)


def test_a_checkpoint_of_other_data_or_settings_is_refused(tmp_path):
    with pytest.raises(_Stop):
        jaxsr.discover(
            [_oscillator()], **ROLES, config=QUICK, checkpoint=tmp_path, progress=_BrokenOff(1)
        )
    with pytest.raises(InputError, match="other data"):
        jaxsr.discover([_oscillator(1)], **ROLES, config=QUICK, checkpoint=tmp_path)
    other = dataclasses.replace(QUICK, population=50)
    with pytest.raises(InputError, match="other settings"):
        jaxsr.discover([_oscillator()], **ROLES, config=other, checkpoint=tmp_path)
    with pytest.raises(InputError, match="other data"):  # a sign is part of the problem
        jaxsr.discover(
            [_oscillator()], **ROLES, config=QUICK, checkpoint=tmp_path, signs={"v": {"q": -1}}
        )


UNITS = {"q": "m", "v": "m/s"}


@pytest.mark.long
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 3))]
)
def test_units_that_bind_keep_what_has_no_meaning_out_of_every_front(seed):
    rng = np.random.default_rng(seed)
    q, v = rng.uniform(-2.0, 2.0, size=(2, 150))
    y = 2.0 * np.sin(q) - np.sqrt(np.abs(q * v)) + np.sin(q + v) + 0.01 * rng.normal(size=150)
    admits = InUnits.of(UNITS)
    begun = dataclasses.replace(QUICK, generations=1)  # what has no meaning stands in the guesses
    for bound, config in ((None, begun), (admits, QUICK)):
        problem = RegressionProblem(y, {"q": q, "v": v}, rules=Rules(admits=bound))
        guesses = [edit([parse("sin(q) + sin(q + v)")])]
        state, _ = search(np.random.default_rng(seed), problem, config, guesses=guesses)
        seen = [*state.front.members, *state.population]
        meant = [admits(term) for member in seen for term in member.terms]
        assert meant and all(meant) is (bound is not None)


def test_units_bind_where_every_variable_has_one():
    names = ("q", "v")
    assert binding_units(UNITS, None, "t", names) == InUnits.of(UNITS | {"t": "s"})
    assert binding_units(UNITS, False, "t", names) is None
    assert binding_units({"q": "m"}, None, "t", names) is None  # of v nothing is known
    assert binding_units({}, None, "t", names) is None
    with pytest.raises(InputError, match="v has no unit"):
        binding_units({"q": "m"}, True, "t", names)


@pytest.mark.long
@pytest.mark.parametrize("bind", [None, False])
def test_units_given_to_discover_bind_by_default(bind):
    t = np.linspace(0.0, 6.0, 120)
    q = np.cos(1.3 * t)
    record = Recording("a", t, {"q": q, "dq": -3.0 * np.sin(q)})
    found = jaxsr.discover(
        [record],
        states=["q"],
        derivatives=["dq"],
        config=QUICK,
        units={"q": "m"},
        bind_units=bind,
        budget=4.0,
    )
    texts = {to_text(t) for c in found["q"].front for t in c.fit.terms}
    assert ("sin(q)" in texts) is (bind is False)


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "noise"), [pytest.param(0, 0.0, marks=pytest.mark.slow), (1, 0.1)]
)
def test_signs_hold_in_the_whole_front_and_in_what_is_found(seed, noise):
    record = _oscillator(seed, noise=noise)
    # the truth brakes; both are told to push
    signs = {"v": {"-v*Abs(v)": -1, "v": 1, "q": -1, "v**3": 1}}
    found = jaxsr.discover([record], **ROLES, config=QUICK, signs=signs, budget=8.0)
    sign = {"v*Abs(v)": 1, "Abs(v)*v": 1, "v": 1, "q": -1, "v**3": 1}
    equation = found["v"]
    pairs = [(t.expression, t.coefficient) for t in equation.terms]
    for candidate in equation.front:
        fit = candidate.fit
        pairs += [(to_text(t), c) for t, c in zip(fit.terms, fit.coefficients, strict=True)]
    assert pairs and all(c * sign.get(text, 0) >= 0.0 for text, c in pairs)


@pytest.mark.parametrize(
    ("signs", "match"),
    [
        ({"z": {"v": 1}}, "no state"),
        ({"v": {"v": 2}}, "1 or -1"),
        ({"v": {"v + q": 1}}, "not one term"),
        ({"v": {"x9": 1}}, "x9"),
        ({"v": 1}, "table"),
    ],
)
def test_signs_without_meaning_are_refused(signs, match):
    with pytest.raises(InputError, match=match) as error:
        jaxsr.discover([_oscillator()], **ROLES, signs=signs)
    assert "\n" not in str(error.value)


def _with_memory(start, seconds=6.0, n=601):
    """x' = v, v' = -4 x - 0.8 times the integral of x."""
    t = np.linspace(0.0, seconds, n)

    def rates(t, s):
        return [s[1], -4.0 * s[0] - 0.8 * s[2], s[0]]

    x = solve_ivp(rates, (0.0, seconds), [*start, 0.0], rtol=1e-11, atol=1e-11, t_eval=t).y
    dv = -4.0 * x[0] - 0.8 * x[2]
    return Recording(f"run{start[0]}", t, {"x": x[0], "v": x[1], "dx": x[1], "dv": dv})


def test_an_integral_is_found_and_becomes_a_state_of_the_model(tmp_path):
    record = _with_memory([1.0, 0.0])
    config = dataclasses.replace(QUICK, primitives=WITH_INTEGRALS)
    found = jaxsr.discover(
        [record, _with_memory([-0.5, 2.0])],
        states=["x", "v"],
        derivatives=["dx", "dv"],
        config=config,
        guesses={"v": ["-x - integral(x)"]},
    )
    fits = [c.fit for c in found["v"].front]
    fit = next(f for f in fits if {to_text(t) for t in f.terms} == {"x", "integral(x)"})
    assert sorted(fit.coefficients) == pytest.approx([-4.0, -0.8], rel=1e-3)
    found.save(tmp_path / "out")
    model = read_model(tmp_path / "out" / "model.toml")
    made = model.states[2:]
    assert "x" in {model.equations[w] for w in made}
    assert {model.initial[w] for w in made} == {0.0}
    table = simulate_to_csv(Simulator(model), record)
    assert np.max(np.abs(table.x - record.channels["x"])) < 1e-3


def test_integrals_over_time_and_over_states_are_the_states_that_replace_them():
    """Simulated with the new states, and evaluated on the simulation, both are the same."""
    names = ["x", "v", "t"]
    texts = {
        "x": "v",
        "v": "-3.0*x - 0.2*integral(x*integral(v**2)) - 0.3*integral_over(x**2, v)"
        " + 0.1*integral_over(sin(t), t) + 0.1*integral(x*integral(v**2))*x",
    }
    rates = {s: parse(text, names, integrals=True) for s, text in texts.items()}
    plain, made = without_integrals(rates, "t", {"integral_2"})
    assert len(made) == 4 and "integral_2" not in made
    assert not any(n.op.startswith("integral") for f in (plain | made).values() for n in f.walk())
    order = [*plain, *made]

    def f(t, s):
        cache = ColumnCache({n: np.array([c]) for n, c in zip(order, s, strict=True)} | {"t": [t]})
        return [cache.column(term)[0] for term in (plain | made).values()]

    t = np.linspace(0.0, 3.0, 3001)
    start = [1.0, 0.5, *[0.0] * len(made)]
    y = solve_ivp(f, (0.0, 3.0), start, rtol=1e-9, atol=1e-9, t_eval=t[::10]).y
    fine = solve_ivp(f, (0.0, 3.0), start, rtol=1e-9, atol=1e-9, dense_output=True).sol(t)
    np.testing.assert_allclose(fine[:, ::10], y, atol=1e-5)
    samples = {"t": t, "x": fine[0], "v": fine[1]}
    direct = ColumnCache(samples).column(rates["v"])
    by_states = ColumnCache({"t": t} | dict(zip(order, fine, strict=True))).column(plain["v"])
    np.testing.assert_allclose(by_states, direct, atol=1e-5)


def test_an_integral_over_an_input_has_no_rate():
    with pytest.raises(InputError, match="cannot be simulated"):
        without_integrals({"x": parse("integral_over(x, u)", integrals=True)}, "t", {"x", "t", "u"})


def test_integrals_begin_anew_in_every_recording():
    t = np.tile(np.linspace(0.0, 2.0, 201), 2)
    x = np.concatenate([np.cos(t[:201]), np.exp(-t[201:])])
    area = np.concatenate([np.sin(t[:201]), 1.0 - np.exp(-t[201:])])
    problem = RegressionProblem(
        -0.7 * area, {"t": t, "x": x}, sampling=Sampling(group=np.repeat([0, 1], 201))
    )
    fit = problem.fit([parse("integral(x)", integrals=True)])
    assert fit.coefficients[0] == pytest.approx(-0.7, rel=1e-4)
    assert fit.loss < 1e-9


@pytest.mark.long
@pytest.mark.parametrize("measure", ["adaptive", "bic"])
def test_fitness_on_rows_held_back_finds_the_law_in_few_samples(measure):
    record = _oscillator(n=36, noise=0.0)
    rule = FitnessRule(measure=measure, data="validation")
    config = dataclasses.replace(QUICK, fitness=rule, population=80, generations=30)
    found = jaxsr.discover([record], **ROLES, config=config)
    assert found["v"].validation_mse < 1e-4 * np.var(record.channels["dv"])
    if measure == "bic":
        assert {t.expression for t in found["v"].terms} == {"q", "Abs(v)*v", "sin(2.0*t)"}


@pytest.mark.parametrize("seed", range(2))
def test_the_papers_settings_run_and_find_a_simple_law(seed):
    rng = np.random.default_rng(seed)
    x, v = rng.normal(size=(2, 200))
    problem = RegressionProblem(-2.0 * x - 0.5 * v**2, {"x": x, "v": v})
    config = dataclasses.replace(SearchConfig.paper(population=100), generations=30)
    state, _ = search(np.random.default_rng(seed), problem, config)
    assert "integral" not in state.config.primitives.functions  # no instants to integrate over
    exact = [m for m in state.front.members if m.loss < 1e-18]
    assert {to_text(t) for t in exact[0].terms} == {"x", "v**2"}


def test_the_papers_settings_with_time_may_integrate():
    t = np.linspace(0.0, 5.0, 150)
    x = np.cos(2.0 * t) + t
    problem = RegressionProblem(0.5 * np.sin(2.0 * t) + 0.5 * t**2, {"t": t, "x": x})
    config = dataclasses.replace(SearchConfig.paper(population=60), generations=3)
    state, _ = search(np.random.default_rng(0), problem, config)
    assert "integral" in state.config.primitives.functions
    assert state.front.best_loss < 1e-4
