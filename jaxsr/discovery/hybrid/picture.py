"""What the report draws of modes."""

from __future__ import annotations

import numpy as np

from jaxsr.discovery.hybrid.assemble import Hybrid
from jaxsr.discovery.samples import Samples
from jaxsr.expressions import to_text
from jaxsr.report.mode_plane import ModePlane

_GRID = 160  # points of the plane on a side


def mode_plane(hybrid: Hybrid, samples: Samples) -> ModePlane:
    """Return the samples in the plane of two states, with the boundary between modes.

    The states of the guards come first; where there is only one state, it is drawn over time. The
    boundary is drawn where it depends on these two alone.
    """
    time, *_ = samples.variables
    guarded = {
        n for region in hybrid.regions for r in region for g in r for n in g.variable.variables
    }
    states = sorted(samples.targets, key=lambda s: s not in guarded)[:2]
    names = (states[0], states[1]) if len(states) > 1 else (time, states[0])
    names = tuple(sorted(names, key=list(samples.variables).index))
    x, y = (samples.variables[n] for n in names)
    boundary = np.zeros((0, 0), int)
    if guarded <= set(names):
        grid = np.meshgrid(*(np.linspace(v.min(), v.max(), _GRID) for v in (x, y)))
        point = dict(zip(names, (g.ravel() for g in grid), strict=True))
        boundary = hybrid.labels(point).reshape(_GRID, _GRID)
    clusters = hybrid.table.clusters
    wholes = {row.number: row for row in reversed(hybrid.table.rows)}
    rows = [wholes[k] for k in range(len(clusters))]
    return ModePlane(
        x, y, (names[0], names[1]), hybrid.labels(samples.variables), boundary,
        clusters.centroids[:, 0], np.array([row.error for row in rows]),
        np.array([-1 if row.mode is None else row.mode for row in rows]),
        clusters.coordinates[0], tuple(to_text(mode.guard, 4) for mode in hybrid.modes),
    )  # fmt: skip
