"""The recordings that can be fetched."""

from __future__ import annotations

from collections.abc import Mapping

from jaxsr.datasets import entries, entries_rigs
from jaxsr.datasets.dataset import Dataset

DATASETS: Mapping[str, Dataset] = {
    dataset.name: dataset for dataset in (*entries.ENTRIES, *entries_rigs.ENTRIES)
}
