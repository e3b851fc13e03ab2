"""Diagnosis: what physics a simulator left out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from jaxsr.diagnosis.diagnose import diagnose
from jaxsr.diagnosis.finding import Estimate, Finding, Rival
from jaxsr.diagnosis.result import Diagnosis

if TYPE_CHECKING:
    from jaxsr.diagnosis.learned import Learned, learn_simulator

__all__ = ["Diagnosis", "Estimate", "Finding", "Learned", "Rival", "diagnose", "learn_simulator"]


def __getattr__(name: str) -> Any:
    # Learning a simulator loads all of discovery, which a diagnosis has no use for.
    if name not in ("Learned", "learn_simulator"):
        raise AttributeError(f"module 'jaxsr.diagnosis' has no attribute {name!r}")
    from jaxsr.diagnosis import learned

    return getattr(learned, name)
