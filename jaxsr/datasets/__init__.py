"""Real recordings from their origin, checksummed, one CSV per experiment with its model file."""

from jaxsr.datasets.arm import arm_model
from jaxsr.datasets.dataset import Dataset, SourceFile
from jaxsr.datasets.fetch import fetch, list_datasets

__all__ = ["Dataset", "SourceFile", "arm_model", "fetch", "list_datasets"]
