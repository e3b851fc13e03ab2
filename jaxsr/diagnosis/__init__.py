"""Diagnosis: what physics a simulator left out."""

from jaxsr.diagnosis.diagnose import diagnose
from jaxsr.diagnosis.learned import Learned, learn_simulator
from jaxsr.diagnosis.result import Diagnosis

__all__ = ["Diagnosis", "Learned", "diagnose", "learn_simulator"]
