"""Which cases there are: every system in turn, sensing and families dealt out evenly."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.generality.laws import FAMILIES
from benchmarks.generality.places import places
from benchmarks.generality.sensing import SENSING
from benchmarks.generality.systems import SYSTEMS

NOTHING, WRONG_VALUE = "nothing", "wrong_value"
DECK = (*FAMILIES, NOTHING, WRONG_VALUE, *FAMILIES, NOTHING, NOTHING, WRONG_VALUE)
"""What is dealt: of 21 cases three have nothing wrong, and two a value."""


@dataclass(frozen=True)
class Ticket:
    """A case to be made: names of its system, its sensing and its family."""

    name: str
    system: str
    sensing: str
    family: str

    def rng(self, seed: int) -> np.random.Generator:
        """Return the case's own generator: a case does not depend on the others."""
        return np.random.default_rng([seed, zlib.crc32(self.name.encode())])


def dealt(seed: int, per_system: int, systems: Sequence[str] = ()) -> list[Ticket]:
    """Return tickets; every system has `per_system` of them.

    Rounds come one after the other, so that the first cases are spread over all systems.
    """
    rng = np.random.default_rng(seed)
    names = list(systems) or list(SYSTEMS)
    families: list[str] = []
    kinds: list[str] = []
    tickets = []
    for turn in range(per_system):
        for name in names:
            if len(families) < len(DECK):
                families += [str(f) for f in rng.permutation(DECK)]
            if len(kinds) < len(SENSING):
                kinds += [str(k) for k in rng.permutation(list(SENSING))]
            system = SYSTEMS[name]
            family = next(f for f in families if f in offered(name))
            kind = next(k for k in kinds if k != "inertial" or system.inertial)
            families.remove(family)
            kinds.remove(kind)
            tickets.append(Ticket(f"{name}-{turn:03d}-{kind}-{family}", name, kind, family))
    return tickets


def offered(system: str) -> set[str]:
    """Return the families that a system has a place for."""
    own = {f for f, laws in FAMILIES.items() if any(places(SYSTEMS[system], w) for w in laws)}
    return own | {NOTHING, WRONG_VALUE}
