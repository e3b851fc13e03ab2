"""Parameters that end on a bound: said before any physics is believed."""

from __future__ import annotations

from jaxsr.diagnosis.calibrating.restarts import TOUCHING
from jaxsr.diagnosis.judging.refine import Estimate
from jaxsr.models import Model


def bound_rows(given: Model, recalibrated: Estimate, explained: Estimate) -> list[dict[str, str]]:
    """Return a remark for every free parameter that either estimate has on a bound."""
    rows = []
    for name in given.free_parameters:
        low, high = given.parameters[name].bounds or (float("-inf"), float("inf"))
        for estimate, whose in ((explained, ""), (recalibrated, "re-calibrated alone, ")):
            value, room = estimate.interval(name)[0], TOUCHING * (high - low)
            side = low if value <= low + room else high if value >= high - room else None
            if side is not None:
                rows.append(_row(name, side, side == low, whose))
                break
    return rows


def _row(name: str, bound: float, lower: bool, whose: str) -> dict[str, str]:
    """Say on which bound a parameter ends, and what to do about it."""
    remedy = "widen it, or ask whether the model needs the term of this parameter"
    if bound != 0.0 or not lower:
        remedy = "widen it, or doubt what else was found: a bound can stand for missing physics"
    message = f"{whose}{name} ends on its bound {bound:.4g}; {remedy}"
    message = message[0].upper() + message[1:] if whose else message
    return {"file": "", "channel": name, "check": "bound", "message": message}
