"""Recordings of a cart on a spring, and that cart as an FMU for co-simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxsr.models import parse_model

CART = """
[model]
name = "cart"
states = ["q", "v"]
inputs = ["F"]
outputs = ["y"]
[equations]
q = "v"
v = "LAW"
[readings]
y = "q"
[initial]
q = 0.1
v = 0.0
"""


def recorded(folder: Path, law: str, name: str = "a.csv", seed: int = 0, count: int = 500) -> Path:
    """Write a recording of a cart with another law, columns ``t q F``."""
    from jaxsr import Simulator
    from jaxsr.models.simulation import simulate_to_csv
    from jaxsr.recordings import Recording

    rng, time = np.random.default_rng(seed), np.arange(count) * 0.02
    waves = zip([0.7, 1.3, 2.1, 3.3, 5.1], rng.uniform(0, 6, 5), strict=True)
    force = np.sum([4.0 * np.sin(w * time + p) for w, p in waves], axis=0)
    model = parse_model(CART.replace("LAW", law))
    run = simulate_to_csv(Simulator(model), Recording("r", time, {"F": force}))
    run["y"] += 2e-4 * rng.normal(size=time.size)
    path = folder / name
    run[["t", "y", "F"]].rename(columns={"y": "q"}).to_csv(path, index=False)
    return path


SLAVE = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Cart(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.q, self.v, self.F, self.m, self.c, self.k = 0.1, 0.0, 0.0, 2.0, 0.5, 8.0
        {memory}
        self.register_variable(Real("q", causality=Fmi2Causality.output))
        self.register_variable(Real("v", causality=Fmi2Causality.output))
        self.register_variable(Real("F", causality=Fmi2Causality.input))
        for name in ("m", "c", "k"):
            self.register_variable(
                Real(
                    name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable
                )
            )

    def do_step(self, current_time, step_size):
        h = step_size / 10
        for _ in range(10):
            self.v += h * (self.F - self.c * self.v - self.k * self.q{force}) / self.m
            self.q += h * self.v
        {after}
        return True
"""


def slave_fmu(folder: Path, force: str = "", memory: str = "pass", after: str = "pass") -> Path:
    """Build the cart as an FMU for co-simulation, in Python, without a compiler.

    Parameters
    ----------
    folder : Path
    force : str
        What is added to the force, in Python.
    memory, after : str
        Statements that start a state that no variable shows, and that end a step.
    """
    from pythonfmu.builder import FmuBuilder

    script = folder / "cart.py"
    script.write_text(SLAVE.format(force=force, memory=memory, after=after))
    return Path(FmuBuilder.build_FMU(script, dest=folder))
