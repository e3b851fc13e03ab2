r"""Dry friction with presliding: contacts that bend before they slip (Dahl, LuGre), as one law.

With z the bending of the contacts in that at which they slip, and x_s = 1/b the way it takes,

.. math:: z' = b\,(v - |v|\,z / g(v)), \qquad F = -k_z z, \qquad
    g(v) = 1 + s\,e^{-(v/v_s)^2},

is Coulomb friction of the size kz where the motion goes on, and a spring of the stiffness kz*b
where it turns. s = 0 is Dahl's law; s and v_s are the Stribeck peak of the LuGre model, whose
viscous part is a damper beside it.

References
----------
Canudas de Wit, Olsson, Astrom & Lischinsky, IEEE Trans. Autom. Control 40 (1995), equations 1 to 4;
Dahl, AIAA J. 14 (1976).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import AddedState, Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site, inverse_unit

WAYS = np.geomspace(1e-4, 0.5, 16)
"""Ways to slip that are looked at, in half the recorded path."""
STABLE, MOST = 2.0, 16
"""Fading of z in a step that RK4 follows, and the most steps between samples."""
SLOW = 0.06
"""First guess of the speed within which a peak acts, in the largest."""


def presliding(site: Site) -> Iterator[Candidate]:
    """Yield Dahl's law and the LuGre model, starting from the way to slip that the motion tells.

    They bring a state along, which is dear: they are offered only where friction that bends first
    takes more from the residual forces than Coulomb friction does.
    """
    q, v = site.position, site.state
    values = site.scale.get(q) if q is not None else None
    if q is None or values is None or not values[-1] > values[0]:
        return
    way = _way(site, 0.5 * float(values[-1] - values[0]))
    if way is None:
        return
    per, speeds = inverse_unit(site.model.units.get(q)), site.scale.get(v)
    slip, steps = way
    start = float(f"{1.0 / slip:.3g}")
    own = (
        ParameterSpec("kz", site.force_unit, low=0.0),
        ParameterSpec("b", per, 0.01 * start, 50.0 * start, start, coefficient=False),
    )

    def make(shape: str, *specs: ParameterSpec) -> Candidate:
        return Candidate(
            "hysteresis",
            "memory",
            site.name,
            (*own, *specs),
            "Dry friction along {site} bends its contacts before they slip (presliding).",
            terms=((v, "- {kz}*{z}"),),
            states=(AddedState("z", f"{{b}}*({v} - Abs({v})*{{z}}{shape})", "1"),),
            substeps=steps,
            source="Canudas de Wit, Olsson, Astrom & Lischinsky, IEEE Trans. Autom. Control 40 "
            "(1995)",
        )

    yield make("")
    if speeds is not None:
        top = float(max(abs(speeds[0]), abs(speeds[-1])))
        yield make(
            f"/(1 + {{s}}*exp(-({v}/{{vs}})**2))",
            ParameterSpec("s", "1", 0.0, 4.0, 0.5, coefficient=False),
            ParameterSpec(
                "vs", site.model.units.get(v), 1e-3 * top, top, SLOW * top, coefficient=False
            ),
        )


def _way(site: Site, reach: float) -> tuple[float, int] | None:
    """Return the way to slip that takes most from the residual forces, and steps to follow it.

    None where Coulomb friction takes as much.
    """
    path, speed, motion = site.signal(site.position), site.signal(site.state), site.motion
    if motion is None or path is None or speed is None:
        return 0.1 * reach, 1
    if site.state not in motion.residual or motion.residual[site.state].size < 8:
        return None
    bent = bending(path, motion.edges, WAYS * reach)
    shares = [motion.share(site.state, column[:, None])[0] for column in bent.T]
    best = int(np.argmax(shares))
    if shares[best] <= motion.share(site.state, np.sign(speed)[:, None])[0]:
        return None
    slip = float(WAYS[best] * reach)
    moved = float(np.quantile(np.abs(np.diff(path)), 0.99))
    return slip, int(np.clip(np.ceil(moved / slip / STABLE), 1, MOST))


def bending(path: np.ndarray, edges: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Return z of Dahl's law along recorded paths, shape (samples, ways).

    Between samples the motion goes one way, along which z fades exactly. Recordings begin unbent.

    Parameters
    ----------
    path : ndarray, shape (samples,)
    edges : ndarray of int
        First samples of the recordings.
    ways : ndarray, shape (ways,)
        Ways to slip.
    """
    found = np.zeros((len(path), len(ways)))
    bounds = [*map(int, edges), len(path)]
    for first, last in pairwise(sorted(set(bounds))):
        way = np.sign(np.diff(path[first:last]))
        turns = first + 1 + np.flatnonzero(np.diff(way))
        for begin, end in pairwise([first, *turns, last - 1]):  # one way from begin to end
            towards, z = np.sign(path[end] - path[begin]), found[begin]
            along = np.abs(path[begin + 1 : end + 1] - path[begin])[:, None]
            found[begin + 1 : end + 1] = towards + (z - towards) * np.exp(-along / ways)
    return found
