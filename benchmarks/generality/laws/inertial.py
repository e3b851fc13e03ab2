"""Masses, weights, and couplings between axes."""

from __future__ import annotations

import numpy as np

from benchmarks.generality.law import Law

LAWS = (
    Law("added_mass", "inertial", "structure", "inertia", lambda rng, s: {"ma": 1.0}, ("ma",),
        lambda m, c: -c["ma"] * m.v),  # here v stands for the acceleration
    Law("constant_force", "inertial", "structure", "force",
        lambda rng, s: {"F0": float(rng.choice([-1.0, 1.0]))}, ("F0",),
        lambda m, c: c["F0"] + 0.0 * m.v),
    Law("gravity", "inertial", "structure", "force", lambda rng, s: {"mg": 1.0}, ("mg",),
        lambda m, c: -c["mg"] * np.sin(m.q), needs="turning"),
    Law("coupling_stiffness", "inertial", "structure", "pair", lambda rng, s: {"kc": 1.0},
        ("kc",), lambda m, c: -c["kc"] * m.q, needs="position"),
    Law("coupling_damping", "inertial", "structure", "pair", lambda rng, s: {"cc": 1.0}, ("cc",),
        lambda m, c: -c["cc"] * m.v),
)  # fmt: skip
