"""Blocks of recordings, and which of them a fit may see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from jaxsr._result import InputError
from jaxsr.recordings.recording import Recording


@dataclass(frozen=True, order=True)
class Block:
    """Name the samples ``start:stop`` of recording number ``recording``."""

    recording: int
    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start

    def of(self, recordings: Sequence[Recording]) -> Recording:
        """Return the block's samples as a recording."""
        return recordings[self.recording].select(slice(self.start, self.stop))


def blocks(recordings: Sequence[Recording], count: int, min_samples: int = 3) -> list[Block]:
    """Cut every recording into consecutive blocks of nearly equal length.

    Parameters
    ----------
    recordings : sequence of Recording
    count : int
        Blocks per recording; fewer where a block would be shorter than `min_samples`.
    min_samples : int
        Shortest block. A recording shorter than that stays one block.

    Returns
    -------
    list of Block
        In order of recording and time; together they cover every sample once.
    """
    if count < 1 or min_samples < 1:
        raise InputError(f"count={count} and min_samples={min_samples} must be at least 1")
    cut: list[Block] = []
    for number, recording in enumerate(recordings):
        parts = max(1, min(count, len(recording) // min_samples))
        edges = np.linspace(0, len(recording), parts + 1).round().astype(int).tolist()
        cut += [Block(number, a, b) for a, b in pairwise(edges)]
    return cut


def folds(blocks: Sequence[Block], k: int) -> list[tuple[list[Block], list[Block]]]:
    """Deal blocks into `k` folds for cross-validation.

    With at least `k` recordings whole recordings are held back, since blocks of one experiment
    share its initial state and its disturbances; otherwise blocks are held back in turn, so that
    every fold sees early and late samples.

    Parameters
    ----------
    blocks : sequence of Block
    k : int
        Folds, at least 2.

    Returns
    -------
    list of (train, validation)
        Every block is in exactly one validation list.

    Raises
    ------
    InputError
        If there are fewer blocks than folds.
    """
    if k < 2:
        raise InputError(f"k={k} folds", remedy="Cross-validation needs at least 2")
    if len(blocks) < k:
        raise InputError(
            f"{len(blocks)} blocks cannot fill {k} folds",
            remedy="Use fewer folds, longer recordings or shorter blocks",
        )
    ordered = sorted(blocks)
    numbers = sorted({block.recording for block in ordered})
    whole = len(numbers) >= k
    fold_of = [
        (numbers.index(block.recording) if whole else place) % k
        for place, block in enumerate(ordered)
    ]
    return [
        (
            [block for block, fold in zip(ordered, fold_of, strict=True) if fold != held],
            [block for block, fold in zip(ordered, fold_of, strict=True) if fold == held],
        )
        for held in range(k)
    ]
