"""Treatment of samples: derivatives and their errors, the weak view, rounding, recognition."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import gamma, jv

import jaxsr
from jaxsr._result import InputError
from jaxsr.discovery.recognise import recognised
from jaxsr.discovery.rounding import rounded
from jaxsr.discovery.samples import Samples, hold_back, roles, samples, thinned
from jaxsr.discovery.treatment import Treatment, treat
from jaxsr.discovery.weak_rows import WeakRows, weak_rows
from jaxsr.evolution import SearchConfig
from jaxsr.expressions import parse, to_text
from jaxsr.recordings import Recording
from jaxsr.regression import RegressionProblem
from jaxsr.views import DERIVATIVES, SMOOTHERS

Signal = Callable[[np.ndarray], np.ndarray]

# ------------------------------------------------------------------------------- derivatives

SMOOTH: dict[str, tuple[Signal, Signal, Signal]] = {
    "sine": (np.sin, np.cos, lambda t: -np.sin(t)),
    "chirp": (
        lambda t: np.sin(0.3 * t**2),
        lambda t: 0.6 * t * np.cos(0.3 * t**2),
        lambda t: 0.6 * np.cos(0.3 * t**2) - 0.36 * t**2 * np.sin(0.3 * t**2),
    ),
    "decay": (
        lambda t: np.exp(-t) + 0.01 * t,
        lambda t: 0.01 - np.exp(-t),
        lambda t: np.exp(-t),
    ),
    "bump": (
        lambda t: 1.0 / (1.0 + (t - 4.0) ** 2),
        lambda t: -2.0 * (t - 4.0) / (1.0 + (t - 4.0) ** 2) ** 2,
        lambda t: (6.0 * (t - 4.0) ** 2 - 2.0) / (1.0 + (t - 4.0) ** 2) ** 3,
    ),
    "polynomial": (lambda t: t**4 - 3.0 * t, lambda t: 4.0 * t**3 - 3.0, lambda t: 12.0 * t**2),
}
RATIO = 3.0  # the stated error, at most so many times too small, at any sample


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("n", [60, 250, 2000])
@pytest.mark.parametrize("name", SMOOTH)
def test_the_errors_of_clean_derivatives_bound_what_they_miss(
    name: str, n: int, order: int
) -> None:
    t = np.linspace(0.0, 8.0, n)
    x = SMOOTH[name][0](t)
    signal = treat(t, x)
    assert signal.clean and not signal.weak
    assert np.array_equal(signal.values, x)  # to the last bit
    found, error = signal.derivative(order)
    assert error is not None and np.all(error > 0.0)
    missed = np.abs(found - SMOOTH[name][order](t))
    inside = missed <= error
    assert np.mean(inside) >= 0.95 and np.max(missed / error) < RATIO, np.max(missed / error)


@pytest.mark.parametrize("order", [1, 2])
def test_errors_are_no_larger_than_they_need_be(order: int) -> None:
    """Where differences of order 6 are good to a few digits, the stated error is, too."""
    t = np.linspace(0.0, 8.0, 250)
    for values in SMOOTH.values():
        found, error = treat(t, values[0](t)).derivative(order)
        assert error is not None
        assert np.median(error) < 1e-4 * np.sqrt(np.mean(found**2))


def test_missing_samples_of_clean_data_are_not_made_up() -> None:
    t = np.linspace(0.0, 8.0, 300)
    x = np.sin(t)
    x[[40, 41, 120]] = np.nan
    signal = treat(t, x)
    found, error = signal.derivative(1)
    known = np.isfinite(found)
    assert signal.clean and error is not None and np.count_nonzero(known) > 250
    assert np.array_equal(np.isnan(signal.values), np.isnan(x))
    assert np.max(np.abs(found - np.cos(t))[known]) < 1e-6


def noisy(seed: int, share: float, n: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = np.linspace(0.0, 8.0, n)
    truth = np.sin(2.0 * t) + 0.3 * np.cos(5.0 * t)
    level = share * float(np.std(truth))
    return t, truth, truth + level * np.random.default_rng(seed).normal(size=n)


@pytest.mark.parametrize("share", [0.003, 0.03, 0.2])
@pytest.mark.parametrize("seed", range(2))
def test_noisy_samples_are_smoothed_and_taken_in_the_weak_view(seed: int, share: float) -> None:
    t, truth, x = noisy(seed, share)
    signal = treat(t, x)
    assert signal.weak and not signal.clean
    level = share * np.std(truth)
    np.testing.assert_allclose(np.sqrt(np.mean(signal.noise**2)), level, rtol=0.2)
    assert np.sqrt(np.mean((signal.values - truth) ** 2)) < 0.6 * level
    found, error = signal.derivative(1)
    rate = 2.0 * np.cos(2.0 * t) - 1.5 * np.sin(5.0 * t)
    assert error is None
    plain = np.gradient(x, t) - rate
    assert np.std(found - rate) < 0.5 * np.std(plain)


def test_a_derivative_that_is_a_column_leaves_its_state_alone() -> None:
    t, _, x = noisy(0, 0.05)
    signal = treat(t, x, given=True)
    assert np.array_equal(signal.values, x) and not signal.weak
    assert not treat(t, x, Treatment(view="weak"), given=True).weak


@pytest.mark.parametrize("count", [4, 12, 23])
def test_too_few_samples_stay_as_they_are(count: int) -> None:
    t, _, x = noisy(0, 0.05, count)
    signal = treat(t, x, Treatment(view="weak"))
    assert np.array_equal(signal.values, x) and signal.clean and not signal.weak
    assert np.all(np.isfinite(signal.derivative(1)[0]))


# ---------------------------------------------------------------------------------- options


@pytest.mark.parametrize("way", sorted(SMOOTHERS))
def test_a_smoother_that_is_named_is_used(way: str) -> None:
    t, _, x = noisy(1, 0.05)
    values = treat(t, x, Treatment(smoothing=way)).values
    np.testing.assert_array_equal(values, jaxsr.views.smooth(t, x, way))
    assert np.std(values - x) > 0.0


@pytest.mark.parametrize("way", sorted(DERIVATIVES))
def test_a_derivative_that_is_named_is_used(way: str) -> None:
    t, _, x = noisy(1, 0.05)
    signal = treat(t, x, Treatment(smoothing="none", derivative=way))
    found, error = signal.derivative(1)
    assert error is None and not signal.weak and np.array_equal(signal.values, x)
    np.testing.assert_array_equal(found, jaxsr.views.derivative(t, x, way))


def test_a_view_that_is_named_is_taken() -> None:
    t, truth, x = noisy(1, 0.05)
    assert not treat(t, x, Treatment(view="derivative")).weak
    assert treat(t, truth, Treatment(view="weak")).weak
    part = roles(["x"], None, 1, (), None)
    for view, expected in (("derivative", set()), ("weak", {"x"})):
        chosen = replace(part, treatment=Treatment(view=view))
        assert set(samples([Recording("a", t, {"x": x})], chosen).weak) == expected
        assert set(samples([Recording("a", t, {"x": truth})], chosen).weak) == expected


def test_no_smoothing_leaves_noisy_samples_as_recorded() -> None:
    t, _, x = noisy(1, 0.05)
    assert np.array_equal(treat(t, x, Treatment(smoothing="none")).values, x)


@pytest.mark.parametrize("name", ["smoothing", "derivative", "view"])
def test_an_option_without_meaning_gets_one_clear_line(name: str) -> None:
    with pytest.raises(InputError) as told:
        Treatment(**{name: "moving_average"})
    text = str(told.value)
    assert "moving_average" in text and name in text and "auto" in text and "\n" not in text


def test_the_weak_view_and_a_derivative_contradict_each_other() -> None:
    with pytest.raises(InputError, match="takes no derivative"):
        Treatment(view="weak", derivative="tikhonov")


# -------------------------------------------------------------------------------- weak rows


def places(rows: WeakRows, t: np.ndarray) -> tuple[np.ndarray, float]:
    """Return centres and half-width: first and second moments of (1 - s^2)^8 are 0 and 1/19."""
    centre = rows.matrix @ t
    spread = rows.matrix @ t**2 - centre**2
    return centre, float(np.sqrt(19.0 * np.median(spread)))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("even", [True, False])
def test_weak_rows_of_cubics_are_exact(even: bool, order: int) -> None:
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 5.0, 300) if even else np.cumsum(rng.uniform(0.01, 0.02, size=300))
    for _ in range(10):
        p = np.polynomial.Polynomial(rng.normal(size=4))
        rows = weak_rows(t, p(t), np.full(300, 1e-3), order)
        scale = np.max(np.abs(rows.target))
        np.testing.assert_allclose(rows.matrix @ p.deriv(order)(t), rows.target, atol=1e-8 * scale)
        # and the mean of a polynomial of degree 3 - order under the test function, in closed form
        centre, width = places(rows, t)
        q = p.deriv(order)
        mean = q(centre) + q.deriv(2)(centre) / 2.0 * width**2 / 19.0
        np.testing.assert_allclose(rows.target, mean, atol=1e-7 * scale)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("speed", [1.0, 3.0, 8.0])
def test_weak_rows_of_sines_have_a_closed_form(speed: float, order: int) -> None:
    r""":math:`\int \phi_c \cos(w t) = \cos(w c)\,\Gamma(19/2) (2/(wh))^{17/2} J_{17/2}(wh)`."""
    t = np.linspace(0.0, 10.0, 2000)
    rows = weak_rows(t, np.sin(speed * t), np.full(2000, 1e-2), order)
    centre, width = places(rows, t)
    factor = gamma(9.5) * (2.0 / (speed * width)) ** 8.5 * jv(8.5, speed * width)
    rates = {1: speed * np.cos(speed * centre), 2: -(speed**2) * np.sin(speed * centre)}
    np.testing.assert_allclose(rows.target, factor * rates[order], atol=1e-5 * speed**order)
    assert np.all(np.diff(centre) > 0.0)
    assert centre[0] - width > -1e-9 and centre[-1] + width < 10.0 + 1e-9


def test_the_error_of_a_row_is_what_noise_leaves_in_it() -> None:
    t = np.linspace(0.0, 10.0, 500)
    pulls = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        level = 0.1 + 0.05 * t  # more noise later
        rows = weak_rows(t, 0.3 * t + level * rng.normal(size=500), level)
        pulls.append((rows.target - 0.3) / rows.error)
    # some ten rows of a record are independent: the root of 40 mean squares is 1 +- 0.04
    assert 0.85 < np.sqrt(np.mean([np.mean(p**2) for p in pulls])) < 1.12
    thirds = np.array([[np.mean(q**2) for q in np.array_split(p, 3)] for p in pulls])
    assert np.all(np.abs(np.mean(thirds, axis=0) - 1.0) < 0.35)  # early and late alike


def test_missing_samples_enter_no_row() -> None:
    t = np.linspace(0.0, 10.0, 600)
    x = np.sin(t)
    x[200:204] = np.nan
    rows = weak_rows(t, x, np.full(600, 0.01))
    assert len(rows.target) and not np.any(rows.matrix[:, 200:204].toarray())
    np.testing.assert_allclose(rows.matrix @ np.cos(t), rows.target, atol=1e-5)


def test_a_record_all_gaps_is_refused() -> None:
    t = np.linspace(0.0, 10.0, 400)
    x = np.where(np.arange(400) % 3 == 0, np.nan, np.sin(t))
    with pytest.raises(InputError, match="long enough for test functions"):
        weak_rows(t, x, np.full(400, 0.1))


def test_taking_samples_keeps_whole_test_functions_only() -> None:
    t = np.linspace(0.0, 10.0, 400)
    rows = weak_rows(t, t**2, np.full(400, 0.05))
    rng = np.random.default_rng(0)
    for _ in range(20):
        low, high = sorted(rng.choice(400, 2, replace=False))
        kept = np.arange(low, high + 1)
        part = rows.take(kept)
        dense = rows.matrix.toarray()
        outside = np.delete(dense, kept, axis=1)
        whole = ~np.any(outside, axis=1)
        # weights at the very ends of a support are zero and may be cut off
        assert len(part.target) <= np.count_nonzero(whole)
        assert len(part.target) >= np.count_nonzero(whole) - 4
        np.testing.assert_allclose(part.matrix @ (2.0 * t[kept]), part.target, atol=1e-9)
        np.testing.assert_allclose(part.matrix @ np.ones(len(kept)), 1.0, atol=1e-12)
    assert len(rows.take(np.arange(0, 400, 2)).target) == 0
    again = rows.take(np.arange(400))
    assert np.array_equal(again.target, rows.target) and np.array_equal(again.error, rows.error)


def test_joined_rows_see_their_own_recording_alone() -> None:
    first, second = np.linspace(0.0, 10.0, 400), np.linspace(3.0, 6.0, 300)
    parts = [
        weak_rows(first, np.sin(first), np.full(400, 0.01)),
        weak_rows(second, second**3, np.full(300, 0.02)),
    ]
    whole = WeakRows.joined(parts)
    count = len(parts[0].target)
    assert whole.matrix.shape == (count + len(parts[1].target), 700)
    assert not np.any(whole.matrix[:count, 400:].toarray())
    assert not np.any(whole.matrix[count:, :400].toarray())
    rate = np.concatenate([np.cos(first), 3.0 * second**2])
    np.testing.assert_allclose(whole.matrix @ rate, whole.target, atol=1e-5)
    assert np.array_equal(whole.error, np.concatenate([p.error for p in parts]))
    back = whole.take(np.arange(400, 700))
    assert np.array_equal(back.target, parts[1].target)


# ---------------------------------------------------------------------------------- samples


def test_every_fourth_block_of_every_recording_is_held_back() -> None:
    group = np.repeat([0, 1, 2], [160, 80, 5])
    held = hold_back(group)
    assert not np.any(held[group == 2])  # too short to be cut
    for number in (0, 1):
        own = held[group == number]
        assert np.mean(own) == 0.25
        assert np.count_nonzero(np.diff(own.astype(int)) == 1) == 2  # in two blocks


def test_thinned_rows_are_even_and_keep_both_ends() -> None:
    for n, most in ((10, 20), (1000, 7), (101, 100)):
        kept = thinned(np.arange(n), most)
        assert len(kept) == min(n, most) and kept[0] == 0 and kept[-1] == n - 1
        assert len(set(kept)) == len(kept) and np.ptp(np.diff(kept)) <= 1


def test_what_one_recording_lacks_is_left_out_for_all() -> None:
    t, truth, x = noisy(3, 0.05)
    part = roles(["x"], None, 1, (), None)
    clean, rough = Recording("clean", t, {"x": truth}), Recording("rough", t, {"x": x})
    both = samples([clean, rough], part)
    assert not both.weak and not both.errors and len(both.traces) == 2
    assert set(samples([rough, rough], part).weak) == {"x"}
    assert set(samples([clean, clean], part).errors) == {"x"}


@pytest.mark.parametrize("count", [3, 30])
def test_a_short_recording_beside_a_long_one_weighs_no_more_a_sample(count: int) -> None:
    t, _, x = noisy(4, 0.05)
    long, short = Recording("long", t, {"x": x}), Recording("short", t[:count], {"x": x[:count]})
    levels = [
        float(np.median(trace["noise"]["x"]))
        for trace in samples([long, short], roles(["x"], None, 1, (), None)).traces
    ]
    assert 0.2 < levels[1] / levels[0] < 5.0


# --------------------------------------------------------------------- accelerations alone


def shaken(noise: float, seed: int = 0) -> tuple[Recording, np.ndarray, np.ndarray]:
    """q'' = -9 q - 0.6 q' + 2 u, u two sines, in the steady state; only q'' and u are recorded."""
    t = np.arange(0.0, 120.0, 0.1)
    q, v, u = np.zeros((3, len(t)))
    for w, size, phase in ((2.1, 1.0, 0.0), (4.3, 0.7, 0.4)):
        wave = size * np.exp(1j * (w * t + phase))
        answer = 2.0 / (9.0 - w**2 + 0.6j * w) * wave
        u, q, v = u + wave.imag, q + answer.imag, v + (1j * w * answer).imag
    a = -9.0 * q - 0.6 * v + 2.0 * u
    a = a + noise * np.std(a) * np.random.default_rng(seed).normal(size=len(t))
    return Recording("shaken", t, {"a": a, "u": u}), q, v


def test_motions_are_integrated_from_accelerations_alone() -> None:
    """What a part of a period leaves is of the order of the amplitude over 40 periods."""
    recording, q, v = shaken(0.0)
    data = samples([recording], roles(["q"], ["a"], 2, ("u",), None))
    for name, truth in (("q", q), ("d_q", v)):
        apart = data.variables[name] - truth
        assert np.sqrt(np.mean(apart**2)) < np.std(truth) / 40.0
    assert np.array_equal(data.targets["d_q"], recording.channels["a"])
    assert np.array_equal(data.targets["q"], data.variables["d_q"])


def test_a_displacement_that_is_recorded_is_not_integrated() -> None:
    recording, q, v = shaken(0.0)
    given = Recording("given", recording.time, {**recording.channels, "q": q})
    data = samples([given], roles(["q"], ["a"], 2, ("u",), None))
    assert np.array_equal(data.variables["q"], q)
    assert np.sqrt(np.mean((data.variables["d_q"] - v) ** 2)) < np.std(v) / 100.0


def _from_accelerations(noise: float, budget: float) -> None:
    quick = SearchConfig(population=40, refined=3, generations=8, restarts=0, patience=2)
    found = jaxsr.discover(
        [shaken(noise)[0]],
        states=["q"],
        derivatives=["a"],
        order=2,
        inputs=["u"],
        autonomous=True,
        config=quick,
        budget=budget,
    )
    first, second = found.equations
    assert first.expression == "d_q"
    rng = np.random.default_rng(0)
    q, v, u = rng.normal(size=(3, 400)) * [[0.4], [1.0], [0.9]]
    truth = -9.0 * q - 0.6 * v + 2.0 * u
    values = Samples({"t": q, "q": q, "d_q": v, "u": u}, {}, np.zeros(400, int), frozenset())
    apart = second.predict(values) - truth
    assert np.sqrt(np.mean(apart**2)) < 0.02 * np.std(truth)


def test_accelerations_alone_give_a_model_close_to_the_truth() -> None:
    _from_accelerations(0.0, 6.0)


@pytest.mark.slow
def test_accelerations_with_a_little_noise_give_a_model_close_to_the_truth() -> None:
    """Integrated twice, noise of 1e-4 of the motion wanders by some percent of it in 120 s."""
    _from_accelerations(1e-4, 20.0)


# --------------------------------------------------------------------------------- rounding


def _problem(law: str, noise: float = 0.0, seed: int = 0) -> RegressionProblem:
    rng = np.random.default_rng(seed)
    variables = {"t": np.linspace(0.0, 10.0, 300), "x": rng.uniform(0.2, 2.0, size=300)}
    y = jaxsr.expressions.evaluate(parse(law), variables)
    return RegressionProblem(y + noise * rng.normal(size=300), variables)


@pytest.mark.parametrize(
    ("law", "given", "expected"),
    [
        ("3*x**2", "x**1.9999", "x**2"),
        ("3*x**2", "x**2.015", "x**2"),
        ("2*x**-1", "x**-1.01", "1/x"),
        ("2*sin(x - t)", "sin(x - 1.0000002*t)", "sin(x - t)"),
        ("2*exp(-3*x)", "exp(-2.9999999*x)", "exp(-3*x)"),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_constants_next_to_whole_numbers_become_whole(
    law: str, given: str, expected: str, noise: float
) -> None:
    problem = _problem(law, noise)
    (term,) = rounded(problem, (parse(given),))
    constants = [n.value for n in term.walk() if n.is_constant]
    assert all(c.is_integer() for c in constants), to_text(term)
    x = {"t": np.linspace(0.0, 9.0, 50), "x": np.linspace(0.3, 1.9, 50)}
    column, wanted = (jaxsr.expressions.evaluate(e, x) for e in (term, parse(expected)))
    # a sine's sign is its coefficient's
    np.testing.assert_allclose(np.abs(column), np.abs(wanted), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("law", "near"),
    [
        ("2*sin(5*t + 1.047)", 1.047),  # a phase of pi/3
        ("3*x**2.01", 2.01),  # an exponent that the data tell from 2
        ("2*sin(1.0003*t + x)", 1.0003),  # ten seconds tell it from 1
        ("2*x**0.5", 0.5),
    ],
)
def test_constants_that_the_data_tell_from_whole_ones_stay(law: str, near: float) -> None:
    problem = _problem(law, 1e-5)
    (term,) = rounded(problem, (parse(law[2:]),))
    values = [n.value for n in term.walk() if n.is_constant]
    assert np.min(np.abs(np.array(values) - near)) < 1e-4


@pytest.mark.parametrize("seed", range(8))
def test_a_phase_of_a_third_of_pi_is_no_whole_number_under_noise_either(seed: int) -> None:
    """As much noise as sine leaves its phase open by 5 %, and still 1 is no better than 1.047."""
    (term,) = rounded(_problem("2*sin(5*t + 1.047)", 1.4, seed), (parse("sin(5*t + 1.047)"),))
    phase = max(n.value for n in term.walk() if n.is_constant and n.value < 4.0)
    assert not phase.is_integer() and abs(phase - 1.047) < 0.5


def test_other_terms_are_refined_and_none_is_lost() -> None:
    problem = _problem("3*x**2 + 2*sin(5*t + 1.047) - x", 0.02)
    terms = rounded(problem, [parse(e) for e in ("x**2.01", "sin(4.99*t + 1.1)", "x")])
    assert {to_text(t) for t in terms} > {"x**2", "x"} and len(terms) == 3
    assert problem.fit(terms).loss < 1.1 * 0.02**2


# ------------------------------------------------------------------------------ recognition


def _glide(seed: int, noise: float, gain: float = 1.0, n: int = 300, bias: float = 0.0) -> Samples:
    """x and its rate, both with noise relative to their spread, in two recordings."""
    rng = np.random.default_rng(seed)
    recordings = []
    for k in range(2):
        t = np.linspace(0.0, 10.0, n)
        a, b = rng.uniform(0.5, 2.0, size=2)
        x = np.sin(a * t) + 0.4 * np.cos(3.0 * b * t) + 0.5 * k
        v = gain * (a * np.cos(a * t) - 1.2 * b * np.sin(3.0 * b * t)) + bias
        w = np.cos(a * t + 0.3)
        x, v, w = (y + noise * np.std(y) * rng.normal(size=n) for y in (x, v, w))
        channels = {"x": x, "v": v, "w": w, "dx": v, "dv": w, "dw": x}
        recordings.append(Recording(f"run{k}", t, channels))
    return samples(recordings, roles(["x", "v", "w"], ["dx", "dv", "dw"], 1, (), None))


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.01, 0.05])
@pytest.mark.parametrize("seed", range(5))
def test_a_rate_is_recognised(seed: int, noise: float) -> None:
    data = _glide(seed, noise)
    assert recognised(data, "x", ("x", "v", "w")) == "v"
    assert recognised(data, "x", ("x", "w", "v")) == "v"
    assert recognised(data, "v", ("x", "v", "w")) is None
    assert recognised(data, "w", ("x", "v", "w")) is None


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("seed", range(5))
def test_an_impostor_is_not_a_rate(seed: int, noise: float) -> None:
    names = ("x", "v", "w")
    assert recognised(_glide(seed, noise, gain=1.05), "x", names) is None  # in another unit
    assert recognised(_glide(seed, noise, gain=-1.0), "x", names) is None
    assert recognised(_glide(seed, noise, bias=0.3), "x", names) is None  # drifts away
    assert recognised(_glide(seed, noise), "x", ("x", "w")) is None  # the rate is not there


def test_a_state_at_rest_has_no_rate() -> None:
    t = np.linspace(0.0, 1.0, 50)
    zero = np.zeros(50)
    channels = {"x": zero + 1.0, "v": zero, "dx": zero, "dv": zero}
    data = samples([Recording("rest", t, channels)], roles(["x", "v"], ["dx", "dv"], 1, (), None))
    assert recognised(data, "x", ("x", "v")) is None
