"""The likelihood against dense normal distributions, quadrature and closed forms."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.signal import lfilter
from scipy.special import comb
from scipy.stats import multivariate_normal, norm

from jaxsr.diagnosis.likelihood import kalman, recursions
from jaxsr.diagnosis.likelihood.estimate import Belief
from jaxsr.diagnosis.likelihood.evidence import Gram, Prior
from jaxsr.diagnosis.likelihood.kalman import Latent, System, smoothed, whitened
from jaxsr.diagnosis.likelihood.local import LocalModel, linearised
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.likelihood.truncated import factored
from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.recordings import Recording

STEPS, STATES, FORCES, OUTPUTS, CONSTANTS = 9, 2, 1, 2, 2
NONE = 1e12


def drawn(seed: int) -> tuple[LocalModel, Latent, Noise, np.ndarray]:
    """A piece of a linear system that varies in time, with two readings, a few of them missing."""
    rng = np.random.default_rng(seed)
    innovation = rng.normal(size=(STEPS + 1, 1, OUTPUTS))
    innovation[rng.uniform(size=innovation.shape) < 0.2] = np.nan
    local = LocalModel(
        0.1 * rng.normal(size=(STEPS, 1, STATES)),
        np.eye(STATES) + 0.3 * rng.normal(size=(STEPS, 1, STATES, STATES)),
        rng.normal(size=(STEPS, 1, STATES, CONSTANTS)),
        innovation,
        rng.normal(size=(STEPS + 1, 1, OUTPUTS, STATES)),
        rng.normal(size=(STEPS + 1, 1, OUTPUTS, CONSTANTS)),
    )
    latent = Latent(
        rng.normal(size=(STEPS, 1, STATES, FORCES)),
        np.array([0.7]),
        0.8,
        rng.normal(size=(STEPS + 1, 1, OUTPUTS, FORCES)),
    )
    coloured, rho = np.array([0.0, 0.4]), np.array([0.0, 0.6])
    smoothing = np.array([0.0, 0.3 * (seed % 2)])
    noise = Noise(rng.uniform(0.1, 0.5, OUTPUTS), coloured, rho, smoothing)
    return local, latent, noise, rng.uniform(0.5, 2.0, STATES)


def dense(
    local: LocalModel, latent: Latent, noise: Noise, start: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Mean (by 1 and constants) and covariance of all states and of all readings."""
    size = STATES + FORCES
    # everything as a linear map of the start and of independent shocks
    shocks = size + STEPS * FORCES
    scale = np.zeros(shocks)
    scale[:STATES], scale[STATES:size] = np.sqrt(start), latent.scale
    scale[size:] = np.repeat(latent.scale, STEPS) * np.sqrt(1.0 - latent.decay**2)
    state = np.eye(size, shocks) * scale
    mean = np.zeros((size, 1 + CONSTANTS))
    states, means, readings, read_means = [], [], [], []
    for t in range(STEPS + 1):
        states.append(state[:STATES])
        means.append(mean[:STATES])
        assert latent.read is not None
        readings.append(local.reading[t, 0] @ state[:STATES] + latent.read[t, 0] @ state[STATES:])
        by = local.reading_by_constant[t, 0]
        read_means.append(  # the forces' mean is zero
            local.reading[t, 0] @ mean[:STATES] + np.column_stack([np.zeros(OUTPUTS), by])
        )
        if t == STEPS:
            break
        move = np.zeros((size, size))
        move[:STATES, :STATES] = local.by_state[t, 0]
        move[:STATES, STATES:] = latent.entering[t, 0]
        move[STATES:, STATES:] = latent.decay
        state, mean = move @ state, move @ mean
        state[STATES:, size + t * FORCES : size + (t + 1) * FORCES] += np.diag(
            scale[size + t * FORCES : size + (t + 1) * FORCES]
        )
        mean[:STATES] += np.column_stack([local.defect[t, 0], local.by_constant[t, 0]])
    z = np.concatenate(readings)
    covariance = z @ z.T + np.diag(np.tile(noise.white, STEPS + 1))
    for k in range(OUTPUTS):
        covariance[k::OUTPUTS, k::OUTPUTS] += coloured(noise, k)
    x = np.concatenate(states)
    return np.concatenate(means), x @ z.T, np.concatenate(read_means), covariance


def coloured(noise: Noise, sensor: int) -> np.ndarray:
    """Covariance of the coloured part of one sensor; a filter starts beside what it smooths."""
    apart = np.abs(np.subtract.outer(np.arange(STEPS + 1), np.arange(STEPS + 1)))
    rho, pole = (float(poles[sensor]) for poles in noise.poles)
    if not pole:
        return noise.coloured[sensor] * rho**apart
    driven = noise.driving[sensor] * rho**apart
    # c_t = b^t c_0 + sum_{s < t} b^(t - s) d_s
    by = np.tril(pole ** np.maximum(np.subtract.outer(*2 * [np.arange(STEPS + 1)]), 0), -1)
    start = pole ** np.arange(STEPS + 1)
    return by @ driven @ by.T + noise.coloured[sensor] * np.outer(start, start)


def engine(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take compiled recursions, or NumPy with readings taken in one by one or at once."""
    if name == "compiled":
        assert kalman.compiled(recursions.filtered) is not None
        return
    monkeypatch.setattr(kalman, "compiled", lambda function: None)
    monkeypatch.setattr(kalman, "FEW", 2 if name == "one by one" else 0)


@pytest.mark.parametrize("way", ["compiled", "one by one", "at once"])
@pytest.mark.parametrize("seed", range(5))
def test_innovations_have_the_likelihood_of_the_dense_covariance(
    seed: int, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine(way, monkeypatch)
    local, latent, noise, start = drawn(seed)
    found = whitened(System.of(local, [latent], [noise], start))
    _, _, mean, covariance = dense(local, latent, noise, start)
    y = local.innovation.reshape(-1)
    seen = np.isfinite(y)
    assert found.count == seen.sum()
    for change in np.random.default_rng(seed).normal(size=(3, CONSTANTS)):
        rows = found.rows[0] @ np.concatenate([[1.0], change])
        got = -0.5 * (seen.sum() * np.log(2.0 * np.pi) + found.log_determinant[0] + np.sum(rows**2))
        at = (mean @ np.concatenate([[1.0], change]))[seen]
        wanted = multivariate_normal(at, covariance[np.ix_(seen, seen)]).logpdf(y[seen])
        assert got == pytest.approx(wanted, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("way", ["compiled", "at once"])
@pytest.mark.parametrize("seed", range(5))
def test_smoothed_states_are_the_conditional_means(
    seed: int, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine(way, monkeypatch)
    local, latent, noise, start = drawn(seed)
    mean, across, read, covariance = dense(local, latent, noise, start)
    y = local.innovation.reshape(-1)
    seen = np.isfinite(y)
    weight = np.linalg.solve(covariance[np.ix_(seen, seen)], y[seen] - read[seen, 0])
    wanted = mean[:, 0] + across[:, seen] @ weight
    got = smoothed(System.of(local, [latent], [noise], start), STATES)
    np.testing.assert_allclose(got[:, :, 0].T.reshape(-1), wanted, atol=1e-9)


@pytest.mark.parametrize("way", ["compiled", "one by one", "at once"])
def test_lanes_do_not_touch_each_other(way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three pieces under three choices of latent force and noise: each as if it were alone."""
    engine(way, monkeypatch)
    drawings = [drawn(seed) for seed in range(3)]
    local = LocalModel(
        *(
            np.concatenate([getattr(d[0], field.name) for d in drawings], axis=1)
            for field in fields(LocalModel)
            if field.name != "apart"
        )
    )
    start = drawings[0][3]
    entering = np.concatenate([d[1].entering for d in drawings], axis=1)
    read = np.concatenate([np.asarray(d[1].read) for d in drawings], axis=1)
    latent = [
        replace(d[1], entering=entering, read=read, scale=d[1].scale * (1 + k))
        for k, d in enumerate(drawings)
    ]
    noise = [d[2].scaled(1.0 + k) for k, d in enumerate(drawings)]
    noise[1] = replace(noise[1], correlation=np.array([0.0, 0.3]))
    noise[2] = replace(noise[2], coloured=np.zeros(2))
    together = whitened(System.of(local, latent, noise, start))
    for choice in range(3):
        for piece in range(3):
            mine = drawings[piece][1]
            own = replace(latent[choice], entering=mine.entering, read=mine.read)
            alone = whitened(System.of(drawings[piece][0], [own], [noise[choice]], start))
            lane = 3 * choice + piece
            np.testing.assert_allclose(together.rows[lane], alone.rows[0], atol=1e-12)
            assert together.log_determinant[lane] == pytest.approx(alone.log_determinant[0])


@pytest.mark.parametrize("states", [9, recursions.WIDE + 4])
@pytest.mark.parametrize("missing", [0.0, 0.5])
def test_compiled_recursions_are_those_of_numpy(
    missing: float, states: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six readings of few or many states, 300 samples, some missing or none: equal to rounding."""
    rng = np.random.default_rng(7)
    steps, pieces, outputs = 300, 2, 6
    innovation = rng.normal(size=(steps + 1, pieces, outputs))
    innovation[rng.uniform(size=innovation.shape) < missing] = np.nan
    local = LocalModel(
        0.1 * rng.normal(size=(steps, pieces, states)),
        0.95 * np.eye(states) + 0.02 * rng.normal(size=(steps, pieces, states, states)),
        rng.normal(size=(steps, pieces, states, 3)),
        innovation,
        rng.normal(size=(steps + 1, pieces, outputs, states)),
        rng.normal(size=(steps + 1, pieces, outputs, 3)),
    )
    entering = rng.normal(size=(steps, pieces, states, 2))
    latent = [Latent(entering, size * np.ones(2), 0.9) for size in (0.0, 0.3)]
    coloured = np.where(np.arange(outputs) < 2, 0.1, 0.0)
    noise = Noise(rng.uniform(0.1, 0.5, outputs), coloured, np.full(outputs, 0.6))
    system = System.of(local, latent, [noise] * 2, np.ones(states))
    one = System.of(local, latent[1:], [noise], np.ones(states))
    found, path = whitened(system), smoothed(one, states)
    monkeypatch.setattr(kalman, "compiled", lambda function: None)
    wanted = whitened(system)
    np.testing.assert_allclose(found.rows, wanted.rows, atol=1e-9)
    np.testing.assert_allclose(found.log_determinant, wanted.log_determinant, rtol=1e-12)
    np.testing.assert_allclose(path, smoothed(one, states), atol=1e-9)


def test_lost_digits_are_no_answer_compiled_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    local, latent, noise, start = drawn(0)
    system = System.of(local, [latent], [noise.scaled(0.0)], 0.0 * start)
    system = replace(system, noise=system.noise - 1.0, process=0.0 * system.process)
    assert np.isnan(whitened(system).log_determinant).all()
    monkeypatch.setattr(kalman, "compiled", lambda function: None)
    assert np.isnan(whitened(system).log_determinant).all()


def test_evidence_is_the_integral_over_the_constants() -> None:
    rng = np.random.default_rng(3)
    rows = np.column_stack([rng.normal(size=30), rng.normal(size=(30, 2))])
    gram = Gram(rows.T @ rows, 1.7, 30)
    prior = Prior(
        np.array([0.3, -0.2]), np.array([0.8, 1.5]), np.array([0.0, -NONE]), NONE * np.ones(2)
    )

    def density(b: float, a: float) -> float:
        left = rows[:, 0] + rows[:, 1:] @ (a, b)
        log = -0.5 * (30 * np.log(2.0 * np.pi) + 1.7 + left @ left)
        weight = norm.pdf(a, 0.3, 0.8) / norm.sf(0.0, 0.3, 0.8) * norm.pdf(b, -0.2, 1.5)
        return float(np.exp(log + 60.0) * weight)

    wanted = np.log(dblquad(density, 0.0, 2.0, -2.0, 2.0, epsrel=1e-5)[0]) - 60.0
    got = gram.evidence([0, 1], prior, scaled=False)
    # the marginal share on the right side, not that at the mode: equal where columns are unlike
    assert got.log_evidence == pytest.approx(wanted, abs=1e-3)


def test_evidence_of_fewer_constants_is_that_of_certainty_about_the_others() -> None:
    rng = np.random.default_rng(4)
    rows = np.column_stack([rng.normal(size=50), rng.normal(size=(50, 2))])
    gram = Gram(rows.T @ rows, 0.0, 50)
    free = Prior(np.zeros(2), np.array([1.0, 1e-6]), -NONE * np.ones(2), NONE * np.ones(2))
    both = gram.evidence([0, 1], free)
    one = gram.evidence([0], free.of([0]))
    assert both.log_evidence == pytest.approx(one.log_evidence, abs=1e-6)
    assert both.change[0] == pytest.approx(one.change[0], abs=1e-6)


def test_the_noise_that_fits_best_is_found() -> None:
    rng = np.random.default_rng(5)
    rows = np.column_stack([3.0 * rng.normal(size=4000), rng.normal(size=(4000, 1))])
    prior = Prior(np.zeros(1), np.ones(1), -NONE * np.ones(1), NONE * np.ones(1))
    found = Gram(rows.T @ rows, 0.0, 4000).evidence([0], prior)
    assert found.noise == pytest.approx(9.0, rel=0.1)


def test_the_factor_of_a_matrix_that_rounding_made_indefinite() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        columns = rng.normal(size=(40, 3)) * 10.0 ** rng.uniform(4.0, 9.0, 3)
        wide = columns @ rng.normal(size=(3, 6))  # of rank three
        inner = wide.T @ wide
        inner = inner - np.eye(6) * 1e-15 * np.trace(inner)  # as far as rounding may go
        factor = factored(np.eye(6) + inner)
        assert np.allclose(factor, np.tril(factor)) and (np.diag(factor) > 0.0).all()
        error = factor @ factor.T - (np.eye(6) + inner)
        assert np.abs(error).max() < 1e-13 * np.trace(inner) + 1e-9


def test_coloured_noise_is_known_by_its_neighbours() -> None:
    """High differences see the upper end of the spectrum alone."""
    rng = np.random.default_rng(3)
    for rho, pole in ((0.5, 0.0), (0.8, 0.0), (0.95, 0.0), (0.8, 0.5)):
        walk = np.asarray(
            lfilter([1.0], np.convolve([1.0, -rho], [1.0, -pole]), rng.normal(size=200_000))
        )
        differences = np.diff(walk / walk.std(), 12)
        seen = np.mean(differences**2) / comb(24, 12)
        noise = Noise(np.zeros(1), np.ones(1), np.full(1, rho), np.full(1, pole))
        assert abs(seen / noise.between_neighbours[0] - 1.0) < 0.1


def test_smoothed_noise_keeps_its_size() -> None:
    """The recursion c' = b (c + d), d' = a d + e has the variance and correlations that it says."""
    for a, b in ((0.6, 0.14), (0.8, 0.8), (0.95, 0.5)):
        noise = Noise(np.zeros(1), np.array([2.0]), np.array([a]), np.array([b]))
        shock = np.random.default_rng(5).normal(size=400_000) * np.sqrt(1.0 - a * a)
        driving = np.sqrt(noise.driving[0]) * np.asarray(lfilter([1.0], [1.0, -a], shock))
        walk = np.asarray(lfilter([0.0, b], [1.0, -b], driving))
        assert abs(walk.var() / 2.0 - 1.0) < 0.05
        first = (walk[1:] * walk[:-1]).mean() / walk.var()
        assert abs(first - (a + b) / (1.0 + a * b)) < 0.01


def test_what_stands_above_the_noise_that_a_sensor_can_have_is_no_noise() -> None:
    rng = np.random.default_rng(4)
    rows = 10.0 * rng.normal(size=(500, 2))
    prior = Prior(np.zeros(1), np.ones(1), -NONE * np.ones(1), NONE * np.ones(1))
    loud = Gram(rows.T @ rows, 0.0, 500).evidence([0], prior)
    held = Gram(rows.T @ rows, 0.0, 500, loudest=4.0).evidence([0], prior)
    assert abs(loud.noise / 100.0 - 1.0) < 0.2 and held.noise == 4.0
    assert held.log_evidence < loud.log_evidence - 1000.0


def test_what_readings_leave_below_the_finest_noise_is_as_large_as_that() -> None:
    rng = np.random.default_rng(4)
    rows = 1e-8 * rng.normal(size=(500, 2))
    prior = Prior(np.zeros(1), np.ones(1), -NONE * np.ones(1), NONE * np.ones(1))
    gram = Gram(rows.T @ rows, 0.0, 500, quietest=1.0)
    assert gram.evidence([0], prior).noise == 1.0
    # Nothing beside noise: of 500 samples nothing is left, and the column tells nothing.
    log = gram.evidence([], prior.of([])).log_evidence
    assert log == pytest.approx(-250.0 * np.log(2.0 * np.pi), abs=1e-6)


def test_what_lies_beyond_a_bound_is_no_part_of_the_evidence() -> None:
    """The data ask for a value outside: the integral is over the inside, the mode on the edge."""
    rng = np.random.default_rng(6)
    columns = rng.normal(size=(40, 2)) + rng.normal(size=(40, 1))
    rows = np.column_stack([-columns @ (1.5, 0.4) + 0.3 * rng.normal(size=40), columns])
    gram = Gram(rows.T @ rows, 0.0, 40)
    low, high = np.array([-1.0, -NONE]), np.array([1.0, NONE])
    prior = Prior(np.zeros(2), np.ones(2), low, high)

    def density(b: float, a: float) -> float:
        left = rows[:, 0] + rows[:, 1:] @ (a, b)
        weight = norm.pdf(a) * norm.pdf(b) / (2.0 * norm.cdf(1.0) - 1.0)
        return float(np.exp(-0.5 * (40 * np.log(2.0 * np.pi) + left @ left) + 50.0) * weight)

    wanted = np.log(dblquad(density, -1.0, 1.0, 0.0, 2.0, epsrel=1e-6)[0]) - 50.0
    got = gram.evidence([0, 1], prior, scaled=False)
    assert got.log_evidence == pytest.approx(wanted, abs=2e-3)
    assert got.change[0] == 1.0
    inner, pull = columns.T @ columns, columns.T @ rows[:, 0]
    assert got.change[1] == pytest.approx(-(pull[1] + inner[1, 0]) / (inner[1, 1] + 1.0))


def test_a_constant_that_is_never_below_another_one() -> None:
    """Static friction below sliding friction, as the data ask for, is no part of the evidence."""
    rng = np.random.default_rng(7)
    columns = rng.normal(size=(40, 2)) + rng.normal(size=(40, 1))
    rows = np.column_stack([-columns @ (1.0, 0.9) + 0.3 * rng.normal(size=40), columns])
    none = NONE * np.ones(2)
    belief = Belief(np.zeros(2), np.array([1.0, 2.0]), -none, none, floors=((1, 0),))
    given = np.array([0.4, 0.7])

    def density(peak: float, low: float) -> float:
        left = rows[:, 0] + columns @ (low, low + peak)
        weight = norm.pdf(low) * 2.0 * norm.pdf(peak, 0.0, 2.0)
        return float(np.exp(-0.5 * (40 * np.log(2.0 * np.pi) + left @ left) + 50.0) * weight)

    wanted = np.log(dblquad(density, 0.0, 2.0, 0.0, 2.0, epsrel=1e-6)[0]) - 50.0
    moved = rows[:, 0] + columns @ given
    about = np.column_stack([moved, columns])
    gram = Gram(about.T @ about, 0.0, 40)
    found = gram.mode(belief.mixing, belief.about(given), scaled=False)
    assert found.log_evidence == pytest.approx(wanted, abs=5e-3)
    low, high = given + found.change
    assert high == pytest.approx(low)  # on the edge
    summed = columns.sum(axis=1)
    assert low == pytest.approx(-(summed @ rows[:, 0]) / (summed @ summed + 1.0))
    assert belief.inside(np.array([1.0, 0.5])).tolist() == [1.0, 1.0]


RUNAWAY = """
[model]
states = ["q", "z"]
outputs = ["y"]
[equations]
q = "-q"
z = "q - rate*z"
[readings]
y = "q"
[parameters]
rate = { value = 1.0, bounds = [0.1, 1e30] }
"""


@pytest.mark.parametrize(("rate", "leads"), [(1.0, True), (1e17, False)])
def test_a_state_that_runs_away_within_a_sample_leads_nowhere(rate: float, leads: bool) -> None:
    """And it cuts no other state from what it was before, which would be evidence for it."""
    time = 0.1 * np.arange(20)
    simulator = Simulator(parse_model(RUNAWAY))
    run = Recording("run", time, {"y": np.exp(-time)})
    item = Prepared.build(simulator.model, run)
    segments = build_segments(simulator.model, [item], [(0, 0, 20)], 1)
    path = np.stack([np.exp(-time), 0.0 * time])[..., None]
    local = linearised(simulator, Stepping("rk4", 1), segments, np.array([rate]), path, [0])
    assert local.leads_on == leads
    np.testing.assert_allclose(local.by_state[:, 0, 0], [[np.exp(-0.1), 0.0]] * 19, atol=1e-6)
