"""Normal forms of laws: equal laws look equal, and nothing else becomes of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxsr.expressions import Term, evaluate, parse, to_text
from jaxsr.expressions.canonical import simplify
from jaxsr.expressions.description import description_length, estimated_length
from jaxsr.expressions.normal_form import normal_form, summands

SAME = [
    ("sign(w)", "Abs(w/6.8)/(w/6.8)"),
    ("sign(w)", "w/Abs(w)", "w/sqrt(w**2)", "-sign(-2.5*w)", "2*Heaviside(w) - 1",
     "tanh(w)/Abs(tanh(w))"),
    ("Abs(w)", "sqrt(w**2)", "Max(w, -w)", "w*sign(w)", "Piecewise((w, w > 0), (-w, True))"),
    ("w*Abs(w)", "w**2*sign(w)", "w*sqrt(w**2)", "Abs(w)**3/w"),
    ("Max(q - 0.1, 0)", "(q - 0.1)*Heaviside(q - 0.1)", "(q - 0.1 + Abs(q - 0.1))/2",
     "q - Min(q, 0.1) - 0", "-Min(0.1 - q, 0)", "(q - 0.1 + sqrt((q - 0.1)**2))/2"),
    ("sign(w)*Abs(w)**1.5", "w*sqrt(Abs(w))", "w*sqrt(sqrt(w**2))", "w**2/Abs(w)**0.5*sign(w)"),
    ("5*sin(3*t + 0.5)", "5*cos(3*t + 0.5 - pi/2)", "-5*sin(-3*t - 0.5)",
     "5*cos(0.5)*sin(3*t) + 5*sin(0.5)*cos(3*t)", "5*sin(3*t + 0.5 + 2*pi)"),
    ("exp(-w**2/0.04)*sign(w)", "exp(-(w/0.2)**2)*w/Abs(w)", "sign(w)/exp((w/0.2)**2)"),
    ("q**3 + 2*q", "q*(q**2 + 2)", "(q + 1)*(q - 1)*q + 3*q", "q*Abs(q)**2 + 2*q"),
    ("v", "v*u/u", "(v + 3) - 3", "v + 0*q", "2*v*0.5"),
]  # fmt: skip


@pytest.mark.parametrize("texts", SAME, ids=lambda texts: texts[0])
def test_ways_of_writing_one_law_have_one_form(texts: tuple[str, ...]) -> None:
    first, *others = (summands(parse(text)) for text in texts)
    for parts in others:
        assert parts.keys() == first.keys()
        for part, value in first.items():
            assert parts[part] == pytest.approx(value, rel=1e-10)


def test_laws_that_differ_keep_forms_that_differ() -> None:
    texts = "sign(w) w Abs(w) w*Abs(w) w**2 sqrt(Abs(w)) tanh(w) sin(w) cos(w) Max(w,0) Min(w,0)"
    forms = {normal_form(parse(text)) for text in texts.split()}
    assert len(forms) == len(texts.split())


NAMES = ("q", "w", "t")
_LEAVES = st.one_of(
    st.sampled_from(NAMES).map(Term.variable),
    st.integers(-90, 90).map(lambda k: Term.constant(k / 10.0)),
)
_ONE = ("neg", "abs", "sign", "sin", "cos", "sqrt", "tanh", "heaviside", "exp")
_TERMS = st.recursive(
    _LEAVES,
    lambda inner: st.one_of(
        st.builds(
            Term.apply, st.sampled_from(("add", "sub", "mul", "div", "max", "min")), inner, inner
        ),
        st.builds(Term.apply, st.sampled_from(_ONE), inner),
        st.builds(
            lambda a, e: Term.apply("pow", a, Term.constant(e)),
            inner,
            st.sampled_from((2.0, 3.0, 0.5, 1.5, -1.0)),
        ),
        st.builds(
            lambda a, b, c: Term("piecewise", (a, Term.apply("lt", b, c), b, Term.boolean(True))),
            inner,
            inner,
            inner,
        ),
    ),
    max_leaves=7,
)


def _edges(term: Term, signals: dict[str, np.ndarray]) -> np.ndarray:
    """Whether an argument of a sign, of a condition or of a quotient is near zero anywhere."""
    near = np.zeros(40, bool)
    for node in term.distinct():
        args = {
            "sign": node.args[:1], "abs": node.args[:1], "heaviside": node.args[:1],
            "div": node.args[1:], "pow": node.args[:1], "sqrt": node.args[:1],
        }.get(node.op, ())  # fmt: skip
        if node.op in ("max", "min", "lt"):
            args = (Term("sub", node.args),)
        for arg in args:
            near |= ~(np.abs(np.broadcast_to(evaluate(arg, signals), 40)) > 1e-6)
    return near


@pytest.mark.long
@settings(max_examples=400)
@given(_TERMS)
def test_a_form_equals_its_term_and_is_its_own_form(term: Term) -> None:
    form = normal_form(term)
    assert normal_form(form) == form, to_text(term)
    rng = np.random.default_rng(0)
    signals = {name: rng.normal(size=40) for name in NAMES}
    with np.errstate(all="ignore"):
        before = np.broadcast_to(evaluate(term, signals), 40).astype(float)
        after = np.broadcast_to(evaluate(form, signals), 40).astype(float)
        parts = [n for n in (*term.distinct(), *form.distinct()) if n.op not in ("lt", "boolean")]
        largest = max(np.max(np.abs(np.nan_to_num(evaluate(n, signals)))) for n in parts)
        ok = ~_edges(term, signals)
        for node in term.distinct():  # a branch that is not taken must be finite too
            ok &= np.isfinite(np.broadcast_to(evaluate(node, signals), 40).astype(float))
    if largest < 1e4:  # else what is left of differences is rounding
        np.testing.assert_allclose(
            after[ok], before[ok], rtol=1e-6, atol=1e-6, err_msg=to_text(term)
        )


def test_what_has_no_form_stays_as_it_is() -> None:
    for text in ("1/(q - q)", "sqrt(-2.0 - Abs(q))", "Piecewise((q, w > 0), (1, w < -1))"):
        term = parse(text)
        assert normal_form(term) in (simplify(term), term)
    long = parse("+".join(f"q**{k}*w" for k in range(1, 30)))
    product = Term.apply("mul", Term.apply("mul", long, long), long)
    assert normal_form(product) == simplify(product)


def test_a_description_is_nodes_and_digits() -> None:
    assert description_length(parse("w")) == 1.0
    assert description_length(parse("sign(w)")) == pytest.approx(2.0)
    # four nodes of three symbols; 3*10**0
    assert description_length(parse("w*w*3")) > description_length(parse("w*w*1"))
    short = description_length(parse("cos(w)"))
    assert short < description_length(parse("cos((w/6.8)**2 + 30)"))
    bumps = " + ".join(f"c{k}*exp(-((q - {0.1 * k})/0.12)**2)" for k in range(8))
    assert description_length(parse(bumps)) > 10.0 * description_length(parse("c1*sin(n*q)"))
    # a number counts by its digits where it is written, and by the data where it is estimated
    assert description_length(parse("0.123456*w")) > description_length(parse("0.1*w"))
    few, many = (estimated_length(parse("0.123456*w"), rows) for rows in (10, 1000))
    assert many - few == pytest.approx(0.5 * np.log2(100.0))
