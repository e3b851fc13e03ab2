"""Whether what was found is a law: one decision, and why not where it is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxsr.discovery.equation import Equation
from jaxsr.discovery.evidence import Evidence

LAW, SEVERAL, UNDECIDED = "law", "several", "undecided"
MOST_LEFT = 0.1
"""Share of what trivial predictions miss, in mean square, that a law may miss too."""
_ROUGH = 0.5  # step between neighbours over that of unrelated samples, mean squares
_FORGOTTEN = 2.5  # standard errors of an autocorrelation of independent steps
_FEW = 40  # rows below which a walk, a law and noise look alike
_HALF = 0.5  # share of what is left above which the law predicts nothing to speak of
OUT_OF_TIME = "the time ended before the law could be run over data held back"
CANNOT_RUN = "the law cannot be run over these recordings"


@dataclass(frozen=True)
class Alternative:
    """Equations that the data cannot tell from those shown, and the errors of their free runs."""

    equations: tuple[Equation, ...]
    free_run_nrmse: float
    by_state: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Verdict:
    """What a discovery claims.

    Attributes
    ----------
    verdict : str
        "law", "several" or "undecided".
    reason : str
        Why it is undecided, in a sentence; the experiment that splits several laws; else empty.
    free_run_nrmse : float or None
        Of the written model over data held back.
    by_state : dict of str to float
        The same for every state with a sensor.
    alternatives : tuple of Alternative
    description_length : float or None
        Of the free runs, in nats: what choosing the law costs less what it gains on trivial
        predictions. By it laws of one set of data are compared.
    """

    verdict: str
    reason: str = ""
    free_run_nrmse: float | None = None
    by_state: dict[str, float] = field(default_factory=dict)
    alternatives: tuple[Alternative, ...] = ()
    description_length: float | None = None


def nrmse(evidence: Sequence[Evidence]) -> tuple[float, dict[str, float]]:
    """Return the error of free runs over data held back, of all outputs and of each.

    Root of the mean over outputs of mean square over variance; of all data where what is held back
    is too short for a window.
    """
    squares = {e.state: (e.whole if e.held is None else e.held).mse for e in evidence}
    every = float(np.sqrt(np.mean(list(squares.values()))))
    return every, {state: float(np.sqrt(square)) for state, square in squares.items()}


def decided(evidence: Sequence[Evidence], rows: int) -> tuple[str, str]:
    """Return "law" or "undecided", and why the latter.

    A law predicts, in free run over a few of an output's own correlation times, all but a tenth of
    what standing still and the mean miss, the sensor's noise taken off, on all data and on data
    held back; and that gain is worth more nats than choosing the law costs. Outputs that show no
    motion above their noise tell nothing.
    """
    moving = [e for e in evidence if e.moves]
    if not moving:
        return UNDECIDED, _nothing_seen(evidence)
    failed = [e for e in moving if not e.left <= MOST_LEFT]
    if failed:
        return UNDECIDED, _unpredicted(max(failed, key=lambda e: e.left), rows)
    unpaid = [e for e in moving if e.net <= 0.0]
    if unpaid:
        worst = min(unpaid, key=lambda e: e.net)
        return UNDECIDED, (
            f"too few rows for what was tried: on {rows} rows the law of {worst.state} gains "
            f"{max(worst.gain, 0.0):.0f} nats on standing still, and choosing it costs "
            f"{worst.cost:.0f}"
        )
    return LAW, ""


def _nothing_seen(evidence: Sequence[Evidence]) -> str:
    names = ", ".join(e.state for e in evidence)
    if any(e.roughness > _ROUGH for e in evidence):
        return (
            f"noise, or aliased: neighbouring samples of {names} have as little to do with each "
            "other as distant ones; sample faster"
        )
    if all(e.whole.trivial <= e.whole.floor for e in evidence):
        return f"noise: {names} moves by no more than its noise"
    return f"nothing moves: {names} stays where it is"


def _unpredicted(worst: Evidence, rows: int) -> str:
    runs = worst.whole
    _, first, last = runs.rows[0]
    state, left = worst.state, f"{100.0 * min(worst.left, 1.0):.0f} %"
    what = (
        f"run freely over {last - first} samples, the law of {state} misses "
        f"{left} of what standing still misses"
    )
    if worst.roughness > _ROUGH:
        return f"aliased: neighbouring samples of {state} differ like distant ones; {what}"
    if rows < _FEW:
        return f"too few rows ({rows}): {what}"
    chance = _FORGOTTEN / np.sqrt(max(rows, 1))
    if worst.left > _HALF and abs(worst.persistence) < chance:
        return f"a random walk: the steps of {state} depend on nothing recorded; {what}"
    if worst.whole.floor > _HALF * worst.whole.trivial:
        return f"noise: {what}"
    return f"a missing input or state: {what}, far more than its noise"
