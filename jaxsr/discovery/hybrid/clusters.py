"""Clusters: the K nearest neighbours of every time point (section 5.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from jaxsr._result import InputError

_ALIKE = 0.5  # of a cluster's radius: recordings that near at one time share a centroid
_RIDGE = 1e-9
_EXACT = 1e-13


@dataclass(frozen=True, eq=False)
class Clusters:
    """One cluster for each time point.

    Attributes
    ----------
    coordinates : tuple of str
        States that span the plane in which distances are taken.
    scale : ndarray, (coordinates,)
        Standard deviation of each, by which distances are divided.
    centroids : ndarray, (clusters, coordinates)
    members : ndarray of int, (clusters, K)
        Samples of each cluster, nearest first.
    """

    coordinates: tuple[str, ...]
    scale: np.ndarray
    centroids: np.ndarray
    members: np.ndarray

    def __len__(self) -> int:
        return len(self.members)

    def nearest(self, variables: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the samples of other recordings nearest to the same centroids (clusters, K)."""
        points = np.column_stack([variables[name] for name in self.coordinates]) / self.scale
        count = min(self.members.shape[1], len(points))
        return _neighbours(points, self.centroids / self.scale, count)[1]


def build_clusters(
    variables: Mapping[str, np.ndarray],
    group: np.ndarray,
    coordinates: Sequence[str],
    count: int,
) -> Clusters:
    """Return the clusters of all time points.

    A time point is a sample of the longest recording. Samples of the other recordings at the same
    place in time that lie within half a cluster's radius of it are averaged into its centroid;
    a recording that runs elsewhere gives centroids of its own.

    Parameters
    ----------
    variables : mapping of str to ndarray, (samples,)
    group : ndarray of int, (samples,)
        Number of the recording.
    coordinates : sequence of str
        Names among the variables.
    count : int
        K, the samples of a cluster.

    Raises
    ------
    InputError
        There are fewer samples than a cluster shall have.
    """
    if not 2 <= count <= len(group):
        raise InputError(f"clusters of {count} from {len(group)} samples", "clusters")
    points = np.column_stack([variables[name] for name in coordinates])
    scale = np.std(points, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    near, _ = _neighbours(points / scale, points / scale, count)
    centroids = _centroids(points / scale, group, near[:, -1])
    _, members = _neighbours(points / scale, centroids, count)
    return Clusters(tuple(coordinates), scale, centroids * scale, members)


def _neighbours(
    points: np.ndarray, centres: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return distances and numbers of the points nearest to each centre (centres, count)."""
    distances, members = KDTree(points).query(centres, k=count)
    shape = len(centres), count
    return np.reshape(distances, shape), np.reshape(members, shape)


def _centroids(points: np.ndarray, group: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Average samples of recordings that run alike; see :func:`build_clusters`."""
    parts = [np.flatnonzero(group == number) for number in np.unique(group)]
    parts.sort(key=len, reverse=True)
    out, taken = [], np.zeros(len(points), dtype=bool)
    for place, rows in enumerate(parts):
        for step, row in enumerate(rows.tolist()):
            if taken[row]:
                continue
            alike = [row]
            for other in parts[place + 1 :]:
                if step < len(other) and not taken[other[step]]:
                    apart = float(np.linalg.norm(points[other[step]] - points[row]))
                    if apart < _ALIKE * radius[row]:
                        alike.append(int(other[step]))
            taken[alike] = True
            out.append(np.mean(points[alike], axis=0))
    return np.array(out)


def cluster_errors(clusters: Clusters, columns: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return what a linear fit of its own leaves in each cluster, relative (clusters,).

    All clusters take their rows from the same evaluated columns; their normal equations are
    solved in one batch.

    Parameters
    ----------
    clusters : Clusters
    columns : ndarray, (samples, terms)
        Fewer terms than the clusters have samples.
    targets : ndarray, (samples, states)
    """
    total = np.mean(targets**2, axis=0)
    out = np.empty(len(clusters))
    for start in range(0, len(clusters), 256):
        rows = clusters.members[start : start + 256]
        theta, y = columns[rows], targets[rows]
        size = np.sqrt(np.mean(theta**2, axis=1, keepdims=True)) + 1e-300
        theta = theta / size
        gram = np.einsum("cki,ckj->cij", theta, theta) / rows.shape[1]
        gram += _RIDGE * np.eye(gram.shape[1])
        xi = np.linalg.solve(gram, np.einsum("cki,ckm->cim", theta, y) / rows.shape[1])
        left = np.mean((y - np.einsum("cki,cim->ckm", theta, xi)) ** 2, axis=1)
        out[start : start + 256] = np.mean(left / total, axis=1) + _EXACT
    return out


def choose_coordinates(
    variables: Mapping[str, np.ndarray],
    group: np.ndarray,
    choices: Sequence[Sequence[str]],
    count: int,
    fitted: tuple[np.ndarray, np.ndarray],
) -> tuple[Clusters, np.ndarray]:
    """Return the clusters of the coordinates that make them purest, and their errors.

    Purest: the mean log of what a local fit leaves is smallest. A cluster that mixes modes leaves
    more than one that does not.

    Parameters
    ----------
    variables, group, count
        As of :func:`build_clusters`.
    choices : sequence of sequence of str
        Coordinates to compare; all states, displacements, velocities.
    fitted : tuple of ndarray
        Columns (samples, terms) and targets (samples, states) of the local fits.
    """
    best: tuple[float, Clusters, np.ndarray] | None = None
    for names in dict.fromkeys(tuple(choice) for choice in choices if choice):
        clusters = build_clusters(variables, group, names, count)
        errors = cluster_errors(clusters, *fitted)
        level = float(np.mean(np.log(errors)))
        if best is None or level < best[0]:
            best = level, clusters, errors
    if best is None:
        raise InputError("no coordinates to cluster in", "clusters")
    return best[1], best[2]


def split_place(error: np.ndarray, key: np.ndarray) -> tuple[float, float]:
    r"""Return where a cluster's residuals change, sorted by ``key``, and by how much.

    Step c of section 5: with the samples in order of time, displacement or velocity,

    .. math:: \min_\Pi \sum_{k<\Pi} (e_k - \bar e_1)^2 + \sum_{k \ge \Pi} (e_k - \bar e_2)^2.

    Parameters
    ----------
    error : ndarray, (K,)
        Residual of a submodel.
    key : ndarray, (K,)

    Returns
    -------
    key : float
        Halfway between the samples on either side.
    share : float
        Part of the sum of squares about the mean that the split removes.
    """
    order = np.argsort(key, kind="stable")
    e = error[order] - np.mean(error)
    count = np.arange(1, len(e))
    sums = np.cumsum(e)[:-1]
    removed = sums**2 / count + sums**2 / (len(e) - count)  # the mean is zero
    place = int(np.argmax(removed))
    total = float(e @ e) or 1.0
    return float(0.5 * (key[order][place] + key[order][place + 1])), float(removed[place]) / total
