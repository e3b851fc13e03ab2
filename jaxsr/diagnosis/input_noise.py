r"""Noise of a recorded input that never acted: told from motion by the readings.

An input is a measurement as well. Its noise :math:`\eta` enters a simulation and comes out as
:math:`G\eta` in the readings, G what the model makes of its input; where that is as large as the
sensors' noise, a model whose G is smaller (a larger inductance, a lag, a balance of large forces)
wins against the true one. Which of two courses acted, the recorded one :math:`u` or a smooth one
:math:`S u`, the readings tell: the given structure is re-calibrated with either, and the smooth
one is taken where it makes them likelier by more than its constant, the smoothing width, costs,

.. math:: \sum_k n_k \log\frac{\sum e_k^2(u)}{\sum e_k^2(S u)} > m \log n,

n the number of independent residuals, m that of inputs that are smoothed (Schwarz).

References
----------
Soderstrom, Errors-in-Variables Methods in System Identification (2018), section 1.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import build_arena, neutral_values
from jaxsr.diagnosis.shooting.blocks import correlation_length
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.integration import choose_stepping
from jaxsr.diagnosis.shooting.scoring import horizons
from jaxsr.models import Model, Simulator
from jaxsr.models.least_squares import Fit
from jaxsr.models.segments import Prepared
from jaxsr.models.states import spread
from jaxsr.recordings import noise_level, quantisation_step
from jaxsr.views import smooth

VISIBLE, ROUGH = 1e-3, 0.2
"""Noise of an input, relative to its deviation, from which it may matter, and from which its
course is too rough to be told from noise."""
STEPS = 1.3
"""Noise, relative to that of a converter's steps, from which there is other noise."""


def noisy_inputs(model: Model, prepared: Sequence[Prepared]) -> tuple[str, ...]:
    """Return the inputs that carry noise in every recording in which they move."""
    if model.input_hold == "bandlimited":
        return ()
    return tuple(
        name
        for k, name in enumerate(model.inputs)
        if all(_is_noisy(p.time, p.inputs[:, k]) for p in prepared)
    )


def _is_noisy(time: np.ndarray, u: np.ndarray) -> bool:
    known = np.isfinite(u)
    if known.sum() < 8 or not known.all() or np.ptp(u) == 0.0:
        return False
    noise, size = noise_level(time, u), float(np.std(u))
    step = quantisation_step(u) or 0.0
    return VISIBLE * size < noise < ROUGH * size and noise > STEPS * step / np.sqrt(12.0)


def quieted(
    model: Model, prepared: Sequence[Prepared], names: Sequence[str]
) -> tuple[Prepared, ...]:
    """Return recordings with the noise of some inputs smoothed out."""
    columns = [model.inputs.index(n) for n in names]
    found = []
    for item in prepared:
        inputs = item.inputs.copy()
        for k in columns:
            inputs[:, k] = smooth(item.time, inputs[:, k], "savitzky_golay")
        found.append(replace(item, inputs=inputs))
    return tuple(found)


def idle_noise(
    simulator: Simulator, prepared: tuple[Prepared, ...], stop: Callable[[], bool]
) -> tuple[str, ...]:
    """Return the inputs whose noise did not act, as the readings tell.

    Parameters
    ----------
    simulator : Simulator
        The given model.
    prepared : tuple of Prepared
    stop : callable
        Asked between iterations; what is not known by then is left as recorded.
    """
    model = simulator.model
    names = noisy_inputs(model, prepared)
    if not names or model.events or model.driven:
        return ()
    plain = _recalibrated(simulator, prepared, stop)
    smoothed = _recalibrated(simulator, quieted(model, prepared, names), stop)
    if stop() or not (plain.usable and smoothed.usable):
        return ()
    gain, number = 0.0, 0.0
    for before, after in zip(plain.residual, smoothed.residual, strict=True):
        independent = np.count_nonzero(after) / correlation_length(after[None])
        sizes = np.sum(before**2) + 1e-300, np.sum(after**2) + 1e-300
        gain += independent * float(np.log(sizes[0] / sizes[1]))
        number += independent
    return names if gain > len(names) * np.log(max(number, 2.0)) else ()


def _recalibrated(
    simulator: Simulator, prepared: tuple[Prepared, ...], stop: Callable[[], bool]
) -> Fit:
    """Estimate the given structure over short segments."""
    super_model = SuperModel.build(simulator.model, [])
    given = neutral_values(super_model)
    own = Simulator(super_model.model)
    stepping = choose_stepping(own, prepared, given)
    scale = 0.01 * spread(np.concatenate([p.outputs for p in prepared]))
    arena = build_arena(super_model, prepared, stepping, horizons(prepared)[0], scale, own)
    return enter(arena, (), given, None, stop).fit
