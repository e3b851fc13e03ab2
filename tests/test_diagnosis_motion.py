"""What groups of signals remove from a residual force, many at once and one by one."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.diagnosis.mechanisms.motion import Motion

SAMPLES, ROWS, BASE = 400, 60, 3


def motion(seed: int) -> Motion:
    """A residual in the weak view of test functions drawn at random."""
    rng = np.random.default_rng(seed)
    functions = rng.normal(size=(ROWS, SAMPLES)) / SAMPLES
    t = np.arange(SAMPLES) * 0.01
    q = np.linalg.qr(rng.normal(size=(ROWS, BASE)))[0]
    own = np.sort(rng.choice(ROWS, ROWS - 20, replace=False))
    return Motion(
        signals={"t": t},
        recordings=("run",),
        edges=np.array([0, SAMPLES]),
        integrate=lambda columns: functions @ columns,
        centre=np.linspace(t[0], t[-1], ROWS),
        spacing=0.1,
        residual={"v": rng.normal(size=own.size)},
        basis={"v": np.linalg.qr(q[own])[0]},
        rows={"v": own},
    )


@pytest.mark.parametrize("seed", range(5))
def test_groups_of_columns_remove_together_what_each_removes_alone(seed: int) -> None:
    found, rng = motion(seed), np.random.default_rng([seed, 1])
    groups = [rng.normal(size=(SAMPLES, 2)) for _ in range(7)]
    groups += [np.repeat(rng.normal(size=(SAMPLES, 1)), 2, axis=1)]  # two columns that are one
    y = found.residual["v"]
    alone = np.array([found.share("v", group)[0] for group in groups])
    np.testing.assert_allclose(found._powers("v", groups) / (y @ y), alone, atol=1e-9)
    assert (alone > 0.0).all()


def test_lines_are_those_of_a_wave_that_is_there() -> None:
    plain = motion(3)
    path = np.sin(2.0 * plain.signals["t"]) * 3.0
    wave = plain.of("v", plain.integrate(np.sin(4.0 * path + 0.6)[:, None]))[:, 0]
    q = plain.basis["v"]
    found = Motion(**{**vars(plain), "residual": {"v": wave - q @ (q.T @ wave)}})

    def pair(n: float) -> np.ndarray:
        return np.stack([np.sin(n * path), np.cos(n * path)], axis=1)

    line = found.lines("v", pair, np.linspace(0.5, 12.0, 200))[0]
    assert line.value == pytest.approx(4.0, abs=0.02)
    assert line.phase == pytest.approx(0.6, abs=0.05)
    assert line.share > 0.99
