r"""How round a corner is, as one more constant: Newton's step for the width of jumps.

About the mode of a set, the steps of integration are linear in its constants and in the logarithm
:math:`\ell` of the width. One column more, a difference of two widths, makes :math:`\ell` part of
the same normal equations (`evidence.Gram`), which tell where it is likeliest, all constants and the
path moving along, and how much that is likelier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.estimate import Belief, Estimate
from jaxsr.diagnosis.likelihood.evidence import Prior, modes
from jaxsr.diagnosis.likelihood.local import LocalModel, linearised
from jaxsr.diagnosis.likelihood.scales import Scales, grams, log_odds, sizes_about
from jaxsr.models.least_squares import Problem

APART = 1.0 / 16.0
"""Logarithm of the ratio of two widths whose difference is a derivative."""
BROAD = 2.0
"""Deviation of the logarithm of a width that is believed beforehand, about the present one."""


@dataclass(frozen=True)
class WidthStep:
    """Where the likeliest width lies.

    Attributes
    ----------
    change : float
        Of the logarithm of the width.
    gain : float
        Of log evidence.
    """

    change: float
    gain: float


def width_step(
    problem: Problem,
    found: Estimate,
    chosen: np.ndarray,
    helpers: np.ndarray,
    belief: Belief,
    scales: Scales,
) -> WidthStep | None:
    """Return Newton's step of the width of a problem's jumps from a set at its mode.

    Parameters
    ----------
    chosen, helpers : ndarray of int
        Parameters that are estimated, and those that stand for latent forces; one may be both.
    belief : Belief
        Of the chosen ones.
    scales : Scales
        Beside which it was estimated.

    Returns
    -------
    WidthStep or None
        None where a width says nothing, or nothing finite.
    """
    active = list(dict.fromkeys([*map(int, chosen), *map(int, helpers)]))
    local = _with_width(problem, found, active)
    forces = tuple(1 + active.index(int(j)) for j in helpers)
    scales = replace(scales, forces=forces, decay=found.decay)
    own = belief.about(found.theta[chosen])
    prior = Prior(
        np.append(0.0, own.mean),
        np.append(BROAD, own.deviation),
        np.append(-np.inf, own.low),
        np.append(np.inf, own.high),
    )
    mixing = np.eye(1 + len(chosen))
    mixing[1:, 1:] = belief.mixing
    # Beside a likelier width another force may be left, or none.
    shares = sizes_about(found.share, scales.shares)
    try:
        every = range(1 + len(chosen))
        found_modes = modes(grams(local, scales, shares), every, prior, mixing)
    except np.linalg.LinAlgError:
        return None
    steps = []
    for share, mode in zip(shares, found_modes, strict=True):
        # What one constant more costs, all widths have to pay.
        cost = np.log(mode.deviation[0] / BROAD) if mode.deviation[0] > 0.0 else np.nan
        log = mode.log_evidence - cost + float(log_odds(share))
        steps.append(WidthStep(float(mode.change[0]), float(log - found.log_evidence)))
    likely = [s for s in steps if np.isfinite(s.gain)]
    return max(likely, key=lambda s: s.gain, default=None)


def _with_width(problem: Problem, found: Estimate, active: Sequence[int]) -> LocalModel:
    """Return the linearisation about a mode with the width's column before the others."""
    simulator, stepping, segments = problem.simulator, problem.stepping, problem.segments
    theta, path = found.theta, found.path
    local = linearised(simulator, stepping, segments, theta, path, active)
    widths = tuple(float(np.exp(APART)) * w for w in stepping.widths)
    wider = replace(stepping, widths=widths)
    other = linearised(simulator, wider, segments, theta, path, ())
    step, reading = other.defect - local.defect, local.innovation - other.innovation
    by, own = (np.nan_to_num(c / APART, posinf=0.0, neginf=0.0)[..., None] for c in (step, reading))
    return replace(
        local,
        by_constant=np.concatenate([by, local.by_constant], -1),
        reading_by_constant=np.concatenate([own, local.reading_by_constant], -1),
    )
