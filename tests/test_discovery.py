"""Equations of motion of known systems, the files, and held-out files that stay closed."""

import hashlib
import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxsr
from jaxsr._result import InputError
from jaxsr.discovery.choose import choose
from jaxsr.discovery.page import shown
from jaxsr.discovery.samples import hold_back
from jaxsr.evolution import SearchConfig
from jaxsr.expressions import parse
from jaxsr.models.reading import read_model
from jaxsr.recordings import write_csv
from jaxsr.regression import RegressionProblem


def _duffing(start, name, seconds=10.0, n=400, noise=0.0):
    """q'' = -4 q - 2 q**3 - 0.3 q' + u."""
    t = np.linspace(0.0, seconds, n)

    def u(t):
        return 3.0 * np.sin(1.1 * t) + np.cos(2.7 * t)

    def rates(t, x):
        return [x[1], -4.0 * x[0] - 2.0 * x[0] ** 3 - 0.3 * x[1] + u(t)]

    solution = solve_ivp(
        rates, (0.0, seconds), start, method="DOP853", rtol=1e-11, atol=1e-11, t_eval=t
    )
    rng = np.random.default_rng(len(name))
    q, v = solution.y
    acceleration = np.array(rates(t, solution.y)[1])
    acceleration = acceleration + noise * np.std(acceleration) * rng.normal(size=n)
    return jaxsr.Recording(name, t, {"q": q, "v": v, "dq": v, "dv": acceleration, "u": u(t)})


DATA = [_duffing([1.0, 0.0], "a"), _duffing([0.0, -2.0], "bb")]
KNOWN = (
    '[model]\nname = "k"\nstates = ["q", "v"]\ninputs = ["u"]\noutputs = ["y"]\n'
    '[equations]\nq = "v"\nv = "u - k*q"\n[readings]\ny = "q"\n'
    "[parameters]\nk = { value = 4.0 }\n"
)
QUICK = SearchConfig(population=80, refined=5, generations=25)


def _terms(equation):
    return {t.expression: t.coefficient for t in equation.terms}


@pytest.fixture(scope="module")
def found():
    return jaxsr.discover(
        DATA,
        states=["q", "v"],
        derivatives=["dq", "dv"],
        inputs=["u"],
        held_out=[_duffing([0.5, 0.5], "ccc")],
        config=QUICK,
    )


@pytest.mark.long
def test_rate_is_recognised_and_law_found_exactly(found):
    first, second = found.equations
    assert (first.state, first.expression, first.complexity) == ("q", "v", 1)
    terms = _terms(second)
    assert set(terms) == {"q", "q**3", "v", "u"}
    for name, value in {"q": -4.0, "q**3": -2.0, "v": -0.3, "u": 1.0}.items():
        assert terms[name] == pytest.approx(value, rel=1e-8)
    assert second.held_out_mse < 1e-15
    assert found.pareto.query("state == 'v' and picked").complexity.tolist() == [4]


@pytest.mark.long
def test_files_are_complete_and_the_model_reads_back(found, tmp_path):
    found.save(tmp_path / "out")
    document = json.loads((tmp_path / "out" / "discovery.json").read_text())
    assert document["schema"] == "jaxsr.discovery/1"
    assert [e["state"] for e in document["equations"]] == ["q", "v"]
    assert document["modes"] == [] and document["switching"] == {}
    assert {"version", "seed", "command", "seconds", "stopped_by"} <= set(document["provenance"])
    equation = document["equations"][1]
    keys = {"state", "expression", "terms", "train_mse", "validation_mse", "held_out_mse"}
    keys |= {"complexity", "operators", "free_run_nrmse", "held_out_free_run_nrmse"}
    assert set(equation) == keys
    assert document["verdict"] == "law" and document["reason"] == ""
    assert document["free_run_nrmse"] < 1e-3 and equation["held_out_free_run_nrmse"] < 1e-3
    data = {n: DATA[0].channels[n] for n in ("q", "v", "u")}
    batch = jaxsr.compile_terms([equation["expression"]], ["q", "v", "u"])
    whole = batch.evaluate(np.column_stack(list(data.values())))[:, 0]
    parts = jaxsr.compile_terms([t["expression"] for t in equation["terms"]], ["q", "v", "u"])
    weights = [t["coefficient"] for t in equation["terms"]]
    np.testing.assert_allclose(
        parts.evaluate(np.column_stack(list(data.values()))) @ weights, whole
    )
    assert set(document["pareto"]["v"][0]) == {"complexity", "mse", "expression"}
    model = read_model(tmp_path / "out" / "model.toml")
    assert model.states == ("q", "v") and model.inputs == ("u",)
    assert model.equations["v"] == equation["expression"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "data:image/png;base64" in page and "://" not in page
    assert (tmp_path / "out" / "fit_v.png").stat().st_size > 1000


def test_free_runs_over_held_out_recordings_are_kept_and_drawn(found, tmp_path):
    runs = found.held_out_runs
    assert [(run.recording, run.output) for run in runs] == [("ccc", "q"), ("ccc", "v")]
    held_out = _duffing([0.5, 0.5], "ccc")
    for run, equation in zip(runs, found.equations, strict=True):
        np.testing.assert_array_equal(run.measured, held_out.channels[run.output])
        np.testing.assert_array_equal(run.time, held_out.time)
        assert run.nrmse == pytest.approx(equation.held_out_nrmse)
        assert np.abs(run.simulated - run.measured).max() < 1e-2
    found.save(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "q, ccc (held out)" in page and 'id="explore"' in page
    assert (tmp_path / "out" / "held_out_run_2.png").exists()


@pytest.mark.long
def test_held_out_files_change_nothing_but_their_own_error(found):
    other = jaxsr.discover(
        DATA, states=["q", "v"], derivatives=["dq", "dv"], inputs=["u"], config=QUICK
    )
    assert [e.expression for e in other.equations] == [e.expression for e in found.equations]
    assert other.equations[1].held_out_mse is None and other.held_out_runs == ()
    assert other.model == found.model


@pytest.mark.slow
def test_displacements_alone_give_a_second_order_law():
    records = [jaxsr.Recording(r.name, r.time, {k: r.channels[k] for k in "qu"}) for r in DATA]
    found = jaxsr.discover(records, states=["q"], order=2, inputs=["u"], config=QUICK)
    assert [e.state for e in found.equations] == ["q", "d_q"]
    assert found.equations[0].expression == "d_q"
    terms = _terms(found.equations[1])
    assert set(terms) == {"q", "q**3", "d_q", "u"}
    assert terms["q**3"] == pytest.approx(-2.0, rel=1e-3)
    assert found.model.outputs == ("q_meas",)


def test_known_part_is_kept_and_only_the_rest_searched(tmp_path):
    known = tmp_path / "known.toml"
    known.write_text(KNOWN)
    found = jaxsr.discover(
        DATA, states=["q", "v"], derivatives=["dq", "dv"], inputs=["u"], known=known, config=QUICK
    )
    terms = _terms(found.equations[1])
    assert set(terms) == {"u", "q", "q**3", "v"}
    assert terms["q"] == -4.0  # as given, not fitted
    assert terms["v"] == pytest.approx(-0.3, rel=1e-8)


@pytest.mark.slow
def test_noise_keeps_the_structure_and_the_intervals_cover():
    noisy = [_duffing([1.0, 0.0], "a", noise=0.05), _duffing([0.0, -2.0], "bb", noise=0.05)]
    found = jaxsr.discover(
        noisy, states=["q", "v"], derivatives=["dq", "dv"], inputs=["u"], config=QUICK
    )
    second = found.equations[1]
    assert {"q", "q**3", "u"} <= set(_terms(second))
    stiffness = next(t for t in second.terms if t.expression == "q**3")
    assert stiffness.ci95[0] < -2.0 < stiffness.ci95[1]


def test_a_state_that_never_changes_has_a_zero_rate():
    t = np.linspace(0.0, 1.0, 100)
    record = jaxsr.Recording("still", t, {"x": np.full(100, 3.0), "dx": np.zeros(100)})
    (equation,) = jaxsr.discover([record], states=["x"], derivatives=["dx"]).equations
    assert equation.expression == "0.0" and equation.terms == ()


def test_a_zero_budget_still_gives_whole_files(tmp_path):
    found = jaxsr.discover(
        DATA, states=["v"], derivatives=["dv"], inputs=["u"], budget=1e-6, config=QUICK
    )
    found.save(tmp_path / "d")
    document = json.loads((tmp_path / "d" / "discovery.json").read_text())
    assert document["provenance"]["stopped_by"] == "budget"


@pytest.mark.long
def test_paths_are_read_and_missing_samples_left_out(tmp_path):
    record = DATA[0]
    channels = {k: np.array(v) for k, v in record.channels.items()}
    channels["u"][50:60] = np.nan
    write_csv(jaxsr.Recording("a.csv", record.time, channels), tmp_path / "a.csv")
    for name in ("b.csv", "c.csv"):
        write_csv(jaxsr.Recording(name, record.time, record.channels), tmp_path / name)
    (tmp_path / "k.toml").write_text(KNOWN.replace("u - k*q", "-k*q"))
    found = jaxsr.discover(
        [tmp_path / "a.csv"], states=["q", "v"], derivatives=["dq", "dv"], inputs=["u"],
        config=QUICK, held_out=[tmp_path / "b.csv"], validation=[tmp_path / "c.csv"],
        known=tmp_path / "k.toml",
    )  # fmt: skip
    assert _terms(found.equations[1])["u"] == pytest.approx(1.0, rel=1e-6)
    files = {
        name: hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()
        for name in ("a.csv", "b.csv", "c.csv", "k.toml")
    }
    assert found.provenance["data_sha256"] == {"a.csv": files["a.csv"]}
    assert found.provenance["held_out_sha256"] == {"b.csv": files["b.csv"]}
    assert found.provenance["validation_sha256"] == {"c.csv": files["c.csv"]}
    assert found.provenance["known_sha256"] == {"k.toml": files["k.toml"]}
    shown_there = shown(found)["provenance"]
    assert shown_there["Held out"] == f"b.csv (SHA-256 {files['b.csv'][:12]}…)"
    assert not any("sha256" in key for key in shown_there.keys() - {"data_sha256"})


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"states": []}, "states"),
        ({"states": ["q", "nope"]}, "nope"),
        ({"states": ["q"], "derivatives": ["dq", "dv"]}, "2 derivatives for 1"),
        ({"states": ["q"], "order": 3}, "order"),
        ({"states": ["q"], "inputs": ["q"]}, "two roles"),
        ({"states": ["q"], "modes": "many"}, "modes"),
        ({"states": ["q"], "modes": 0}, "modes"),
        ({"states": ["q q"]}, "no column"),
    ],
)
def test_wrong_calls_are_refused_in_one_line(options, match):
    with pytest.raises(InputError, match=match) as error:
        jaxsr.discover(DATA, **options)
    assert "\n" not in str(error.value)


def test_blocks_held_back_are_a_quarter_and_come_from_every_recording():
    group = np.repeat([0, 1], [400, 240])
    held = hold_back(group)
    assert np.mean(held) == pytest.approx(0.25, abs=0.02)
    assert held[:400].any() and held[400:].any()
    assert np.count_nonzero(np.diff(held.astype(int))) <= 10  # blocks, not scattered samples


def test_choice_takes_the_smallest_within_one_standard_error():
    rng = np.random.default_rng(0)
    x, z = rng.normal(size=(2, 400))
    y = 2.0 * x + 0.3 * rng.normal(size=400)
    problem = RegressionProblem(y[:200], {"x": x[:200], "z": z[:200]})
    sets = [[parse(s) for s in texts] for texts in (("z",), ("x",), ("x", "z"), ("x", "z", "x*z"))]
    judge = RegressionProblem(y[200:], {"x": x[200:], "z": z[200:]})
    _, pick = choose(problem, sets, judge)
    assert pick == 1


@pytest.mark.long
def test_regressor_is_a_scikit_learn_estimator():
    rng = np.random.default_rng(1)
    X = rng.uniform(-2.0, 2.0, size=(200, 2))
    y = 2.0 * X[:, 0] ** 2 - 3.0 * np.sin(1.7 * X[:, 1])
    estimator = jaxsr.SymbolicSparseRegressor(population=80, random_state=0).fit(X, y)
    assert estimator.score(X, y) == pytest.approx(1.0, abs=1e-12)
    x0, x1 = (s for s in sorted(estimator.sympy().free_symbols, key=str))
    values = estimator.sympy().subs({x0: 0.5, x1: -1.0}).evalf()
    assert float(values) == pytest.approx(2.0 * 0.25 - 3.0 * np.sin(-1.7), rel=1e-8)
    assert "sin" in estimator.latex()
    assert estimator.pareto_.picked.sum() == 1
    assert estimator.get_params()["population"] == 80
    with pytest.raises(ValueError, match="features"):
        estimator.predict(X[:, :1])
