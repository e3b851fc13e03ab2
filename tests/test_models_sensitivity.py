"""Derivatives carried from sample to sample, as machine code and by NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr._machine_code import compiled
from jaxsr.models import sensitivity
from jaxsr.models.carrying import carry
from jaxsr.models.sensitivity import condensed


@pytest.mark.parametrize("steps", [1, 64, 1000])
@pytest.mark.parametrize("size", [0.97, 1.02])
def test_machine_code_gives_what_numpy_gives(steps, size, monkeypatch):
    """Motions that fade and that grow, with parameters and defects."""
    rng = np.random.default_rng(steps)
    slopes = 0.1 * rng.normal(size=(3, 5, steps, 4))
    slopes[:, :3] = size * np.linalg.qr(rng.normal(size=(3, 3)))[0][:, :, None, None]
    defects = rng.normal(size=(3, steps, 4))
    found = condensed(slopes, defects)
    monkeypatch.setattr(sensitivity, "compiled", lambda function: None)
    single = condensed(slopes, defects)
    for a, b in zip(found, single, strict=True):
        assert a.shape == b.shape
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-11 * np.abs(b).max())


def test_what_is_not_finite_stays_where_it_is(monkeypatch):
    """Samples before it are told; a path is then closed up to there."""
    slopes, defects = np.full((1, 1, 100, 1), 0.5), np.ones((1, 100, 1))
    defects[0, 70] = np.nan
    _, shift = condensed(slopes, defects)
    assert np.isfinite(shift[0, :71]).all() and np.isnan(shift[0, 71:]).all()
    monkeypatch.setattr(sensitivity, "compiled", lambda function: None)
    np.testing.assert_allclose(shift, condensed(slopes, defects)[1], rtol=1e-12)


def test_it_is_compiled_once_however_arrays_lie():
    rng = np.random.default_rng(3)
    slopes, defects = rng.normal(size=(2, 3, 20, 4)), rng.normal(size=(2, 40, 4))
    lying = (
        defects[:, :20],
        defects[:, ::2],
        np.asfortranarray(defects[:, :20]),
        np.ascontiguousarray(defects[:, :20].transpose(1, 2, 0)).transpose(2, 0, 1),
    )
    for rows in lying:
        condensed(slopes, rows)
    machine = compiled(carry)
    assert machine is not None and len(machine.signatures) == 1
