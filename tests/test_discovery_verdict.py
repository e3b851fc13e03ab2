"""What a discovery claims: by free runs of the written model, against standing still and chance."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import jaxsr
from jaxsr._result import InputError
from jaxsr.discovery import find
from jaxsr.discovery.choose import Candidate, resolved
from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.discovery.evidence import Bench, Charge
from jaxsr.discovery.experiments import remarks
from jaxsr.discovery.forecast import Readings, forecast, window_length, windows
from jaxsr.discovery.judgement import held_blocks
from jaxsr.discovery.known import unit_table
from jaxsr.discovery.rivals import experiment, rivals
from jaxsr.discovery.samples import roles, samples
from jaxsr.discovery.verdict import decided
from jaxsr.evolution import SearchConfig
from jaxsr.expressions import parse
from jaxsr.models.model import Model
from jaxsr.models.reading import read_model
from jaxsr.recordings import Recording
from jaxsr.regression import Fit

QUICK = SearchConfig(population=30, refined=3, generations=4, restarts=0, patience=4)
TIME = np.arange(0.0, 20.0, 0.05)


def model_of(equations: dict[str, str], time: str = "t") -> Model:
    outputs = tuple(f"{s}_meas" for s in equations)
    return Model(
        name="m",
        time=time,
        states=tuple(equations),
        outputs=outputs,
        equations=equations,
        readings=dict(zip(outputs, equations, strict=True)),
        columns=dict(zip(outputs, equations, strict=True)),
    )


def equation_of(state: str, terms: dict[str, float], names=("t", "q", "v")) -> Equation:
    fitted = tuple(FittedTerm(parse(k, names), c, (c, c)) for k, c in terms.items())
    return Equation(state, fitted, 0.0, None)


def evidence_of(model: Model, equations: list[Equation], recording: Recording, noise: float):
    levels = {s: np.full(len(recording), noise) for s in model.states}
    readings = Readings.of(model, [recording], [levels])
    bench = Bench(readings, readings, held_blocks([recording]), {})
    return bench.evidence(model, equations, Charge(18, len(recording)))


def oscillation(noise: float = 0.0) -> Recording:
    """Damped oscillation q'' = -4 q - 0.2 q', in closed form."""
    rng, w = np.random.default_rng(3), np.sqrt(4.0 - 0.01)
    decay = np.exp(-0.1 * TIME)
    q = decay * np.cos(w * TIME)
    v = decay * (-0.1 * np.cos(w * TIME) - w * np.sin(w * TIME))
    scatter = noise * rng.normal(size=(2, len(TIME)))
    return Recording("a", TIME, {"q": q + scatter[0], "v": v + scatter[1]})


RIGHT = model_of({"q": "v", "v": "-4.0*q - 0.2*v"})
TERMS = [equation_of("q", {"v": 1.0}), equation_of("v", {"q": -4.0, "v": -0.2})]


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_a_law_that_holds_leaves_no_more_than_noise(noise):
    found = evidence_of(RIGHT, TERMS, oscillation(noise), noise)
    assert decided(found, len(TIME)) == ("law", "")
    for evidence in found:
        assert evidence.left < 0.01
        assert evidence.gain > 5.0 * evidence.cost
        assert evidence.whole.mse == pytest.approx(evidence.whole.floor, rel=0.4, abs=1e-9)


def test_a_law_of_another_frequency_is_no_law():
    wrong = model_of({"q": "v", "v": "-5.5*q - 0.2*v"})
    verdict, reason = decided(evidence_of(wrong, TERMS, oscillation(), 0.0), len(TIME))
    assert verdict == "undecided" and "missing input or state" in reason


@pytest.mark.long
def test_random_walks_have_no_law_whatever_drift_is_fitted():
    claims = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        q = np.cumsum(rng.normal(size=300))
        recording = Recording("walk", np.arange(300.0), {"q": q})
        slope = float(np.mean(np.diff(q)))
        model = model_of({"q": f"{slope!r} - 0.01*q"})
        law = [equation_of("q", {"1.0": slope, "q": -0.01})]
        claims += decided(evidence_of(model, law, recording, 0.3), 300)[0] == "law"
    assert claims == 0


def test_few_rows_do_not_pay_for_many_terms():
    t = np.linspace(0.0, 3.0, 12)
    q = np.exp(-t)
    recording = Recording("few", t, {"q": q + 0.03 * np.random.default_rng(1).normal(size=12)})
    small = [equation_of("q", {"q": -1.0})]
    large = [equation_of("q", {"q": -1.0, "sin(2.1*t)*q": 1e-3, "cos(q*t)": 1e-3, "q**3": 1e-3})]
    model = model_of({"q": "-q"})
    told = [evidence_of(model, law, recording, 0.03)[0] for law in (small, large)]
    assert told[0].net > 0.0 > told[1].net
    assert "too few rows" in decided([told[1]], 12)[1]


def test_white_noise_shows_nothing_to_be_predicted():
    rng = np.random.default_rng(0)
    recording = Recording("noise", TIME, {"q": rng.normal(size=len(TIME))})
    found = evidence_of(model_of({"q": "-q"}), [equation_of("q", {"q": -1.0})], recording, 1.0)
    verdict, reason = decided(found, len(TIME))
    assert verdict == "undecided" and "aliased" in reason


def test_windows_are_as_long_as_the_memory_and_starts_are_not_judged():
    readings = Readings.of(RIGHT, [oscillation()], [{}])
    length = window_length(readings, 0)
    assert 30 < length < 130  # a period has 63 samples
    rows = windows(readings.items, length)
    run = forecast(RIGHT, readings, 0, rows)
    assert np.all(np.isnan(run.law[: length // 3]))
    assert sum(b - a for _, a, b in rows) == len(TIME)
    assert run.mse < 1e-9 and run.trivial > 0.5


def test_chaos_is_judged_over_its_own_memory():
    from scipy.integrate import solve_ivp

    def lorenz(_, x):
        return [10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]]

    t = np.arange(0.0, 15.0, 0.01)
    x = solve_ivp(lorenz, (0, 15), [1, 2, 20], t_eval=t, rtol=1e-10, atol=1e-10).y
    recording = Recording("a", t, dict(zip("xyz", x, strict=True)))
    model = model_of({"x": "10.001*(y - x)", "y": "x*(27.999 - z) - y", "z": "x*y - 2.6667*z"})
    names = ("t", "x", "y", "z")
    laws = [equation_of(s, {s: 1.0}, names) for s in "xyz"]
    assert decided(evidence_of(model, laws, recording, 0.0), len(t))[0] == "law"


# ---- several laws


def test_laws_that_differ_only_beyond_the_data_are_rivals():
    q = 0.05 * np.cos(2.0 * TIME)  # sin(q) and q are one within the data
    rows = samples(
        [Recording("a", TIME, {"q": q, "v": -0.1 * np.sin(2.0 * TIME)})],
        roles(["q", "v"], None, 1, (), None),
    )
    names = ("t", "q", "v")

    def candidate(text: str, size: int, mse: float) -> Candidate:
        return Candidate(
            Fit((parse(text, names),), np.array([-4.0]), np.zeros(0), mse), size, mse, mse
        )

    front = (candidate("q", 2, 1e-6), candidate("q/(1.0 - Abs(q))", 5, 1.1e-6),
             candidate("v", 2, 1.0))  # fmt: skip
    law = replace(equation_of("v", {"q": -4.0}), front=front, pick=0)
    equations = [equation_of("q", {"v": 1.0}), law]
    recording = Recording("a", TIME, {"q": q, "v": -0.1 * np.sin(2.0 * TIME)})
    taken = evidence_of(model_of({"q": "v", "v": "-4.0*q"}), equations, recording, 1e-3)
    found = rivals(equations, taken, rows, lambda laws: taken)
    assert [str(r.equations[1].terms[0].expression) for r in found] == ["q/(1.0 - Abs(q))"]
    assert "q = " in experiment(found, rows) or "little" in experiment(found, rows)
    worse = [replace(e, cost=e.cost + 10.0) for e in taken]
    assert rivals(equations, taken, rows, lambda laws: worse) == []


# ---- what is shown is what is scored


def rates(document, folder, columns):
    """Return rates of the JSON's expressions and of the written model, state by state."""
    model = read_model(folder / "model.toml")
    names = list(columns)
    table = np.column_stack(list(columns.values()))
    for equation in document["equations"]:
        texts = (equation["expression"], model.equations[equation["state"]])
        batch = jaxsr.compile_terms(list(texts), names)
        told = batch.evaluate(table)
        parts = jaxsr.compile_terms([t["expression"] for t in equation["terms"]], names)
        weights = np.array([t["coefficient"] for t in equation["terms"]])
        yield equation, told[:, 0], told[:, 1], parts.evaluate(table) @ weights


def check_stated(found, folder):
    found.save(folder)
    document = json.loads((folder / "discovery.json").read_text())
    rows = found.samples
    for equation, shown, written, summed in rates(document, folder, rows.variables):
        np.testing.assert_allclose(shown, written, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(summed, shown, rtol=1e-7, atol=1e-7)
        mse = np.mean((rows.targets[equation["state"]] - written) ** 2)
        assert equation["train_mse"] == pytest.approx(mse, rel=1e-6, abs=1e-20)
        if equation["validation_mse"] is not None:
            assert equation["validation_mse"] != equation["train_mse"] or mse == 0.0
    return document


@pytest.mark.slow
def test_terms_without_width_are_not_counted_twice(tmp_path, monkeypatch):
    """Intervals may lose their width; a term is given because it was known, not because of that."""
    real = find.coefficient_ci95

    def narrow(theta, residual, c, *a, **k):
        return np.column_stack([c, c])[: real(theta, residual, c, *a, **k).shape[0]]

    monkeypatch.setattr(find, "coefficient_ci95", narrow)
    recorded = oscillation(0.01)
    third = Recording("a", TIME[::3], {k: v[::3] for k, v in recorded.channels.items()})
    few = replace(QUICK, population=15, generations=2)
    found = jaxsr.discover([third], states=["q", "v"], autonomous=True, config=few, modes=1)
    terms = {t.expression: t.coefficient for t in found["v"].terms}
    assert terms["q"] == pytest.approx(-4.0, rel=0.02)
    assert len(found["v"].terms) == len(terms)
    document = check_stated(found, tmp_path / "out")
    assert document["verdict"] == "law" and document["free_run_nrmse"] < 0.05
    text = found.summary()
    assert "Free run" in text and max(map(len, text.replace(".", " ").split())) < 20


@pytest.mark.slow
@pytest.mark.parametrize("name", ["law-predators", "law-driven", "law-displacement", "walk-60"])
def test_the_written_model_is_the_stated_law(name, tmp_path):
    from benchmarks import no_law_cases as cases

    every = cases.NO_LAW | cases.LAWS
    case = every[name](np.random.default_rng(0))
    found = jaxsr.discover(
        case.recordings,
        jaxsr.Roles(states=case.states, **case.options),
        run=jaxsr.Run(budget=60),
    )
    document = check_stated(found, tmp_path / "out")
    assert (document["verdict"] == "undecided") == (name in cases.NO_LAW)


@pytest.mark.slow
def test_a_step_between_two_laws_is_written_as_it_is_stated(tmp_path):
    t = np.arange(0.0, 30.0, 0.02)
    x = np.sin(0.9 * t) * 2.0
    rate = np.where(x > 0.5, -2.0 * x, 1.5 * x)
    recording = Recording("a", t, {"x": x, "dx": rate})
    found = jaxsr.discover([recording], states=["x"], derivatives=["dx"], config=QUICK)
    check_stated(found, tmp_path / "out")


# ---- what no sampled row can show


def test_terms_that_samples_cannot_resolve_are_left_out():
    t = np.arange(0.0, 10.0, 0.05)
    names = ("t", "x")
    group = np.zeros(len(t), int)
    variables = {"t": t, "x": np.cos(t)}
    fast = parse("sin(62.831853071795862*t)", names)  # half a period between samples
    plain = [parse(k, names) for k in ("sin(2.0*t)", "x", "x*t", "1.0/(2.0 + x)", "sign(x)")]
    assert resolved([fast, *plain], variables, group, "t") == set(plain)
    pole = parse("1.0/(t - 0.975)", names)  # halfway between two samples
    assert resolved([pole], variables, group, "t") == set()


# ---- remarks and units


def test_files_whose_steps_differ_are_remarked():
    slow = Recording("slow", np.arange(0.0, 40.0, 2.0), {"x": np.arange(20.0)})
    fast = Recording("fast", np.arange(0.0, 4.0, 0.01), {"x": np.arange(400.0)})
    told = remarks([slow, fast], roles(["x"], None, 1, (), None))
    assert [c.file for c in told if c.check == "time_unit"] == ["slow"]
    assert not [c for c in remarks([fast], roles(["x"], None, 1, (), None)) if c.channel == "time"]


def test_units_are_read_as_every_document_is(tmp_path):
    path = tmp_path / "units.toml"
    path.write_bytes('[units]\nq = "m"\n'.encode("utf-16"))
    assert unit_table(path) == {"q": "m"}
    with pytest.raises(InputError, match="no such"):
        unit_table(tmp_path / "none.toml")
    path.write_text("units = 3\n")
    with pytest.raises(InputError, match="units"):
        unit_table(path)
