"""Friction on a sum or a difference of two speeds: wrists and differentials, whose motors share
gears, rub where both speeds meet.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.dissipative import is_speed
from jaxsr.diagnosis.mechanisms.site import Site


def coupled(site: Site) -> Iterator[Candidate]:
    r"""Yield dry and viscous friction on v + n vj with the next axis of the model, n = 1 or -1.

    .. math:: F = F_c\,\mathrm{sign}(v + n v_j) + F_v\,(v + n v_j)

    opposes v with -F and vj with -n F, so that it never gives power. It is offered where, at one
    of the two axes, it takes more from the residual forces than the same friction on its own speed.
    """
    other = _next(site)
    if other is None:
        return
    v, vj, f = site.state, other.state, site.force_unit
    if f != other.force_unit or site.model.units.get(v) != site.model.units.get(vj):
        return
    for way, sign in ((1.0, "+"), (-1.0, "-")):
        if not _seen(site, vj, way):
            continue
        speed = f"{v} {sign} {vj}"
        friction = f"({{Fc}}*sign({speed}) + {{Fv}}*({speed}))"
        yield Candidate(
            "coupled_friction",
            "dissipative",
            site.name,
            (
                ParameterSpec("Fc", f, low=0.0),
                ParameterSpec("Fv", site.per(v), low=0.0),
                ParameterSpec("n", "1", neutral=way, coefficient=False, fixed=True),
            ),
            f"Friction along {{site}} acts on the {'sum' if way > 0 else 'difference'} of its "
            f"speed and {vj}.",
            terms=((v, f"- {friction}"), (vj, f"- {{n}}*{friction}")),
            source="Janot, Vandanjon & Gautier, IEEE Trans. Control Syst. Technol. 22 (2014)",
        )


def _next(site: Site) -> Site | None:
    """Return the axis that follows in the model, of positions or speeds as this one is."""

    def moves(of: Site) -> bool:
        return of.position is not None or is_speed(of)

    order = site.model.states.index
    later = [o for o in site.others if order(o.state) > order(site.state) and moves(o)]
    return min(later, key=lambda o: order(o.state), default=None) if moves(site) else None


def _seen(site: Site, vj: str, way: float) -> bool:
    """Whether residual forces ask for friction on both speeds rather than on one."""
    motion = site.motion
    if motion is None:
        return True
    speeds = {s: motion.signals[s] for s in (site.state, vj)}
    both = speeds[site.state] + way * speeds[vj]

    def share(state: str, speed: np.ndarray) -> float:
        return motion.share(state, np.stack([np.sign(speed), speed], axis=1))[0]

    told = [s for s in speeds if s in motion.residual and motion.residual[s].size > 2]
    return any(share(s, both) > share(s, speeds[s]) for s in told)
