"""Which submodel holds in which cluster, and where clusters with an event split (Table 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.discovery.equation import Equation
from jaxsr.discovery.hybrid.clusters import Clusters, choose_coordinates, split_place
from jaxsr.discovery.hybrid.piecewise import Mode
from jaxsr.discovery.samples import Samples, thinned

_LOOKED_AT = 3000  # samples that get a cluster each
_SHARE, _FEWEST, _MOST = 7, 20, 150  # K: a seventh of the samples, within bounds


@dataclass(frozen=True)
class ClusterRow:
    """One cluster, or a part of one on one side of an event.

    Attributes
    ----------
    number : int
    mode : int or None
        Number of the submodel; None where samples of several modes meet.
    samples : int
    error : float
        Mean squares of the training and of the validation samples, added, over the states whose
        law switches.
    terms, operators : int
        Of the submodel's equations of those states.
    ranges : dict of str to (float, float)
        Least and largest value of every state.
    split : tuple of (str, float) or None
        What a cluster with an event is sorted by to tell its parts, and where it changes.
    """

    number: int
    mode: int | None
    samples: int
    error: float
    terms: int
    operators: int
    ranges: dict[str, tuple[float, float]]
    split: tuple[str, float] | None = None

    @property
    def index(self) -> float:
        """Return the paper's complexity index: operators over terms."""
        return self.operators / max(self.terms, 1)


@dataclass(frozen=True, eq=False)
class ClusterTable:
    """The clusters of a system, and their rows: two or more for a cluster with an event."""

    clusters: Clusters
    rows: tuple[ClusterRow, ...]

    def mixed(self) -> list[int]:
        """Return the numbers of the clusters in which events occur."""
        return [row.number for row in self.rows if row.mode is None]


def cluster_table(
    modes: Sequence[Mode],
    labels: tuple[np.ndarray, np.ndarray],
    states: Sequence[str],
    choices: Sequence[Sequence[str]],
    train: Samples,
    judge: Samples,
) -> ClusterTable:
    """Test all submodels on all clusters (the paper's post-processing).

    Parameters
    ----------
    modes : sequence of Mode
    labels : tuple of ndarray of int
        Mode of every training and every validation sample.
    states : sequence of str
        Whose law switches.
    choices : sequence of sequence of str
        Data-driven coordinates to choose from.
    train, judge : Samples
    """
    few, seen = (thinned(np.arange(len(part)), _LOOKED_AT) for part in (train, judge))
    train, judge, labels = train.take(few), judge.take(seen), (labels[0][few], labels[1][seen])
    count = int(np.clip(len(train) // _SHARE, min(_FEWEST, len(train)), _MOST))
    errors = _errors(modes, states, train), _errors(modes, states, judge)
    # purest: a cluster of one mode is fitted exactly by it, so its label tells as much as a fit
    one = np.eye(len(modes))[labels[0]]
    clusters, _ = choose_coordinates(
        train.variables, train.group, choices, count, (np.ones((len(train), 1)), one)
    )
    near = clusters.nearest(judge.variables)
    rows: list[ClusterRow] = []
    for number, members in enumerate(clusters.members):
        own = labels[0][members]
        held = near[number]
        present = np.unique(own).tolist()
        if len(present) == 1:
            held = held[labels[1][held] == present[0]]
            parts = [(present[0], members, held)]
            rows += [_row(number, m, a, b, errors, modes, states, train) for m, a, b in parts]
            continue
        best = min(present, key=lambda m: float(np.mean(errors[0][m][members])))
        split = _event(errors[0][best][members], members, train)
        whole = _row(number, best, members, held, errors, modes, states, train)
        rows.append(
            ClusterRow(number, None, whole.samples, whole.error, whole.terms, whole.operators,
                       whole.ranges, split)
        )  # fmt: skip
        for m in present:
            a, b = members[own == m], held[labels[1][held] == m]
            rows.append(_row(number, m, a, b, errors, modes, states, train))
    return ClusterTable(clusters, tuple(rows))


def _errors(modes: Sequence[Mode], states: Sequence[str], samples: Samples) -> list[np.ndarray]:
    """Return the squared error of every mode's laws on all samples."""
    out = []
    for mode in modes:
        total = np.zeros(len(samples))
        for state in states:
            total += (samples.targets[state] - mode[state].predict(samples)) ** 2
        out.append(np.nan_to_num(total, nan=1e300, posinf=1e300))
    return out


def _row(
    number: int, mode: int, members: np.ndarray, held: np.ndarray,
    errors: tuple[list[np.ndarray], list[np.ndarray]], modes: Sequence[Mode],
    states: Sequence[str], train: Samples,
) -> ClusterRow:  # fmt: skip
    laws: list[Equation] = [modes[mode][s] for s in states]
    error = float(np.mean(errors[0][mode][members]))
    error += float(np.mean(errors[1][mode][held])) if len(held) else 0.0
    names = [s for s in train.targets if s in train.variables]
    ranges = {
        n: (float(train.variables[n][members].min()), float(train.variables[n][members].max()))
        for n in names
    }
    size = sum(law.complexity for law in laws), sum(law.operators for law in laws)
    return ClusterRow(number, mode, len(members), error, *size, ranges)


def _event(error: np.ndarray, members: np.ndarray, train: Samples) -> tuple[str, float]:
    """Return the variable by which a cluster's residuals part best, and where (step c)."""
    time = next(iter(train.variables))
    found = []
    for name in (time, *train.targets):
        place, share = split_place(np.sqrt(error), train.variables[name][members])
        found.append((share, name, place))
    _, name, place = max(found)
    return name, place
