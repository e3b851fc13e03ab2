"""A discovery's forms, plots, page and pickle."""

import pickle
import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest
import sympy

import jaxsr
from jaxsr._result import InputError
from jaxsr.discovery.equation import Equation, FittedTerm, relative_error
from jaxsr.discovery.fronts import front_table, latex_text
from jaxsr.discovery.page import fits_of, shown
from jaxsr.evolution import SearchConfig
from jaxsr.expressions import parse

matplotlib.use("Agg")


def _record(name, phase, noise=0.02, n=300):
    """Samples of q'' = -4 q - 0.3 v + u on a prescribed motion; exact but for the noise."""
    t = np.linspace(0.0, 12.0, n)
    rng = np.random.default_rng(len(name))
    w = np.array([0.6, 1.7, 2.9, 4.3, 5.1])[:, None]  # enough tones to tell q, v and u apart
    angle = w * t + phase * np.arange(5)[:, None]
    q, v, a = (
        np.sum(part, axis=0) for part in (np.sin(angle) / w, np.cos(angle), -w * np.sin(angle))
    )
    u = a + 4.0 * q + 0.3 * v
    dv = a + noise * rng.normal(size=n)
    return jaxsr.Recording(name, t, {"q": q, "v": v, "dq": v, "dv": dv, "u": u})


@pytest.fixture(scope="module")
def found():
    return jaxsr.discover(
        [_record("a", 0.0), _record("bb", 1.0)],
        states=["q", "v"],
        derivatives=["dq", "dv"],
        inputs=["u"],
        config=SearchConfig(population=60, generations=12, refined=4),
    )


@pytest.mark.long
def test_forms_agree(found):
    rng = np.random.default_rng(0)
    named = {name: rng.normal(size=50) for name in ("t", "q", "v", "u")}
    rates = found.to_numpy()(named)
    assert list(rates) == ["q", "v"]
    np.testing.assert_array_equal(rates["q"], named["v"])
    expected = -4.0 * named["q"] - 0.3 * named["v"] + named["u"]
    np.testing.assert_allclose(rates["v"], expected, atol=0.1)
    symbols = [sympy.Symbol(n, real=True) for n in ("q", "v", "u")]
    by_sympy = sympy.lambdify(symbols, found.sympy("v"))(*(named[str(s)] for s in symbols))
    np.testing.assert_allclose(by_sympy, rates["v"], rtol=1e-12)
    with jax.enable_x64(True):
        arrays = {name: jnp.asarray(x) for name, x in named.items()}
        np.testing.assert_allclose(jax.jit(found.to_jax())(arrays)["v"], rates["v"], rtol=1e-12)
        one = {name: x[0] for name, x in arrays.items()}
        slope = jax.grad(lambda values: found.to_jax()(values)["v"])(one)["q"]
    assert slope == pytest.approx(-4.0, abs=0.05)
    assert found.latex("q") == "v"
    assert "q" in found.latex("v", digits=2)
    with pytest.raises(InputError, match="no equation of 'w'"):
        found.latex("w")


def test_every_coefficient_is_printed_as_its_interval_justifies():
    fitted = (
        FittedTerm(parse("sin(2.3456789*t)"), -0.12125, (-0.12142, -0.12108)),
        FittedTerm(parse("x + t"), -20.4, (-20.53, -20.27)),
        FittedTerm(parse("1.0"), 9.819206, (9.80646, 9.83195)),
        FittedTerm(parse("x"), 1.23456789, (1.23456789, 1.23456789), given=True),
    )
    equation = Equation("x", fitted, 0.0, None)
    text = "-0.12125*sin(2.34568*t) - 20.40*(x + t) + 9.819 + 1.23457*x"
    assert equation.shown == text
    assert "1.23456789*x" in equation.expression and "2.3456789*t" in equation.expression
    parse(text, ["t", "x"])  # still an expression of the grammar


def test_it_prints_its_equations(found):
    lines = str(found).splitlines()
    assert lines[0] == "d(q)/dt = v" and lines[1].startswith("d(v)/dt = ")
    assert len(lines[1]) < 60
    assert found._repr_html_().count("<math") == 2


@pytest.mark.parametrize(
    ("text", "latex"),
    [("2.34567*x0**2.0", "2.346 x_{0}^{2}"), ("d_q/sqrt(v)", r"\frac{d_{q}}{\sqrt{v}}"),
     ("0.0", "0")],
)  # fmt: skip
def test_latex_has_few_digits_and_whole_numbers(text, latex):
    assert latex_text(parse(text)) == latex


def test_front_table_marks_the_pick_and_scores_falls(found):
    table = front_table(found["v"])
    assert table.picked.sum() == 1
    assert np.all(table.score >= 0.0) and table.score[0] == 0.0
    assert table.loss[table.score > 0.0].is_monotonic_decreasing
    alone = front_table(found["q"])  # recognised, not chosen
    assert alone.equation.tolist() == ["v"] and alone.picked.all()


@pytest.mark.slow
def test_it_pickles_and_another_process_reads_it(found, tmp_path):
    path = tmp_path / "found.pickle"
    path.write_bytes(pickle.dumps(found))
    back = pickle.loads(path.read_bytes())
    assert [e.expression for e in back.equations] == [e.expression for e in found.equations]
    assert back.model == found.model and back.to_dict() == found.to_dict()
    assert back["v"].terms == found["v"].terms
    # a term's hash belongs to its process: a stale one would make equal terms differ
    code = (
        "import pickle, sys\n"
        "from jaxsr.expressions import parse\n"
        f"found = pickle.load(open({str(path)!r}, 'rb'))\n"
        "assert {parse('q')} & {t.term for t in found['v'].terms}\n"
        "print(found['v'].expression)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == found["v"].expression


def test_page_shows_equations_as_mathml_and_stands_alone(found, tmp_path):
    found.save(tmp_path / "out")
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"discovery.json", "model.toml", "report.html", "fit_q.png", "fit_v.png"} <= names
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.count("<math") >= 4 and page.count("data:image/png;base64") == 3
    assert "<script" not in page and "://" not in page
    assert "95 % interval" in page and "Residual over rate" in page
    assert len(re.findall('class="chosen"', page)) == 1


def test_page_keeps_one_candidate_for_each_number_of_terms(found):
    document = shown(found)
    front = document["pareto"]["v"]
    counts, errors = [r["complexity"] for r in front], [r["mse"] for r in front]
    assert counts == sorted(set(counts)) and errors == sorted(errors, reverse=True)
    assert sum(row["picked"] for row in front) == 1
    assert document["equations"][0]["terms"][0]["ci95"] is None  # q' = v is no estimate
    assert "picked" not in found.to_dict()["pareto"]["v"][0]


def test_fits_hold_every_sample_of_every_recording(found):
    fits = fits_of(found)
    assert [(f.state, f.recording) for f in fits] == [
        (state, f"recording {k}") for state in ("q", "v") for k in (1, 2)
    ]
    assert sum(len(f.time) for f in fits) == 2 * len(found.samples)
    error = np.concatenate([f.target - f.predicted for f in fits if f.state == "v"])
    rate = np.concatenate([f.target for f in fits if f.state == "v"])
    expected = np.linalg.norm(error) / np.linalg.norm(rate)
    assert relative_error(found["v"], found.samples) == pytest.approx(expected)
    assert expected == pytest.approx(0.02 / np.sqrt(np.mean(rate**2)), rel=0.15)


def test_plots_draw_on_the_axes_given(found):
    import matplotlib.pyplot as plt

    for draw in (found.plot_front, found.plot_fit, found.plot_residual):
        figure, (left, right) = plt.subplots(1, 2)
        assert draw("v", right) is right and right.has_data() and not left.has_data()
        figure.canvas.draw()
        plt.close(figure)
    ax = found.plot_fit("v", recording=1)
    data, fit = (line.get_ydata() for line in ax.get_lines())
    rows = found.samples.group == 1
    np.testing.assert_array_equal(data, found.samples.targets["v"][rows])
    np.testing.assert_allclose(fit, data, atol=0.2)
    plt.close("all")
    with pytest.raises(InputError, match="recording 7"):
        found.plot_fit("v", recording=7)


def test_an_interval_too_narrow_to_print_is_given_by_its_width(tmp_path):
    from jaxsr.report import write_discovery_report

    terms = [
        {"expression": "q", "coefficient": -50.0, "ci95": [-50.0 - 3e-13, -50.0 + 3e-13]},
        {"expression": "v", "coefficient": 2.0, "ci95": [1.9, 2.1]},
        {"expression": "u", "coefficient": 1.0, "ci95": None},
    ]
    equation = {"state": "v", "expression": "-50.0*q + 2.0*v + u", "terms": terms}
    write_discovery_report({"equations": [equation]}, [], tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<b>−50</b>" in page and "± 3×10⁻¹³" in page
    assert "1.90 … 2.10" in page and "<b>1</b>" in page
