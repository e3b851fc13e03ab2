"""Which of the laws that a search wrote for what acts at an equation are weighed by evidence.

What acts there is smoothed, and read off the path of a set that is not the truth. It tells which
laws are far too simple, and hardly which of several that err alike is right: the evidence does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from jaxsr.diagnosis.laws.naming import named
from jaxsr.diagnosis.laws.place import Place
from jaxsr.diagnosis.laws.unnamed import (
    ProposedForce,
    as_candidate,
    estimable,
    has_a_name,
    law_of,
    sizes_of,
)
from jaxsr.diagnosis.likelihood.course import Course
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.evolution.propose import Proposal
from jaxsr.expressions import Term, evaluate

AROUND = 1.05
"""Range, in that of the path about which a law is written, over which other paths may lead."""
CLEARLY, MOST = 0.7, 6
"""Share of a simpler law's error from which another is clearly better, and laws that are weighed.
"""


def laws_of(
    work: Workspace, course: Course, place: Place, proposed: Sequence[Proposal]
) -> list[ProposedForce]:
    """Return laws among proposals: the simplest that explain so much of what acts, and their like.

    Each of the first errs clearly less than all simpler ones. Beside them stand laws that err as
    the best, the simplest first, as different from one another as there are (`unlike`). Those that
    are named forces are left out, and of the first those that are sums of them: these were asked.
    """
    model = work.super_model.given
    laws = _Laws(place, sizes_of(model, work.prepared))
    ordered = sorted(filter(estimable, proposed), key=lambda p: (p.size, p.loss))
    firsts, least = list[Proposal](), np.inf
    for law in ordered:
        if law.loss < CLEARLY * least and laws.finite(law):
            least = law.loss
            firsts.append(law)
    chosen = [law for law in firsts if not laws.named(law)][-MOST:]
    alike = [p for p in ordered if p.loss * CLEARLY <= least and p not in firsts]
    chosen += unlike(laws, course, chosen, firsts, [p for p in alike if laws.finite(p)])
    state = model.states.index(place.site.state)
    return [as_candidate(model, work.prepared, state, p) for p in chosen]


class _Laws:
    """Proposals as laws at an equation."""

    def __init__(self, place: Place, sizes: Mapping[str, float]) -> None:
        self.place, self.sizes = place, sizes

    def of(self, proposal: Proposal) -> Term:
        """Return the law over the states themselves."""
        return law_of(proposal, self.sizes)

    def finite(self, proposal: Proposal) -> bool:
        """Whether it is a number where the motion leads."""
        return finite_around(self.of(proposal), self.place.signals)

    def named(self, proposal: Proposal) -> bool:
        """Whether it is a named force, or a sum of them."""
        known = has_a_name(proposal)
        return known or bool(named(self.place.site, self.of(proposal), self.place.signals))

    def seen(self, proposals: Sequence[Proposal], course: Course) -> np.ndarray:
        """What each explains of what acts, re-calibration included, shape (rows, proposals)."""
        rows = list[np.ndarray]()
        still = np.zeros(next(iter(self.place.signals.values())).size)
        for law in proposals:  # one by one: recordings may be long
            with np.errstate(all="ignore"):
                force = still + evaluate(self.of(law), self.place.signals)
            seen = course.motion.integrate(force[:, None])[:, 0]
            rows.append(seen + self.place.reach @ law.fixed)
        return np.stack(rows, -1)


def unlike(
    laws: _Laws,
    course: Course,
    chosen: Sequence[Proposal],
    firsts: Sequence[Proposal],
    others: Sequence[Proposal],
) -> list[Proposal]:
    r"""Return laws of `others` that make `chosen` up to `MOST`.

    A law is taken where what it explains differs from that of all before, and of `firsts`, by
    :math:`\mathrm{mean}(\Delta^2) > \tau L`, L the loss: :math:`\tau` falls by halves from what is
    clearly better until there are enough, or until a difference is worth less than one row.
    """
    found: list[Proposal] = []
    if not others:
        return found
    seen = laws.seen([*firsts, *others], course)
    rows, known = len(seen), list(range(len(firsts)))
    share = 1.0 - CLEARLY
    while share * rows > 1.0:
        for k, law in enumerate(others, len(firsts)):
            if len(chosen) + len(found) >= MOST:
                return found
            apart = np.mean((seen[:, known] - seen[:, [k]]) ** 2, axis=0)
            if k not in known and (apart > share * law.loss).all():
                known.append(k)
                if not has_a_name(law):  # what is a sum of named forces is dear to say
                    found.append(law)
        share *= 0.5
    return found


def finite_around(law: Term, signals: Mapping[str, np.ndarray]) -> bool:
    """Whether a law is a number where the motion leads, and a little beyond its ranges.

    Where it is none it makes none of every set, were its coefficient zero.
    """
    for reach in (1.0, AROUND):
        middle = {n: 0.5 * (x.min() + x.max()) for n, x in signals.items()}
        wider = {n: middle[n] + reach * (x - middle[n]) for n, x in signals.items()}
        with np.errstate(all="ignore"):
            if not np.isfinite(evaluate(law, wider)).all():
                return False
    return True
