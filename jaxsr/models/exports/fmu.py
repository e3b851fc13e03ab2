"""A model as a Functional Mock-up Unit of FMI 2 for co-simulation, built by pythonfmu."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

from jaxsr._result import InputError
from jaxsr._staging import staging_folder
from jaxsr.models.exports.python import numpy_text
from jaxsr.models.exports.system import System, one_line

LONGEST_STEP = 1e-3
"""Longest step of the integration inside the unit, in s, unless the model has a sample time."""
LIMIT = 300.0
"""Seconds that pythonfmu may take."""

SLAVE = '''

import math

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class {name}(Fmi2Slave):
    """Runs the rates above by Runge and Kutta's method of order 4, inputs held within a step."""

    description = {about!r}

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.at, self.x = 0.0, numpy.array({start!r})
        self.u, self.p = numpy.zeros({inputs}), dict(parameters)
        self.longest = {longest!r}
        for k, name in enumerate(inputs):
            self.number(name, Fmi2Causality.input, self.u, k)
        for name in self.p:
            self.number(name, Fmi2Causality.parameter, self.p, name)
        for k, name in enumerate(states):
            self.number(f"start.{{name}}", Fmi2Causality.parameter, self.x, k)
        for k, name in enumerate(outputs):
            self.reading(name, lambda k=k: float(readings(self.at, self.x, self.u, self.p)[k]))
        for k, name in enumerate(states):
            self.reading(name if name not in outputs else f"state.{{name}}", self.state(k))

    def state(self, k):
        return lambda: float(self.x[k])

    def number(self, name, causality, table, key):
        kinds = Fmi2Variability.continuous, Fmi2Variability.tunable
        self.register_variable(
            Real(
                name,
                causality=causality,
                variability=kinds[causality == Fmi2Causality.parameter],
                getter=lambda: float(table[key]),
                setter=lambda value: table.__setitem__(key, value),
            ),
            nested=False,
        )

    def reading(self, name, getter):
        self.register_variable(
            Real(name, causality=Fmi2Causality.output, getter=getter), nested=False
        )

    def setup_experiment(self, start_time, *others):
        self.at = start_time

    def do_step(self, current_time, step_size):
        count = max(1, math.ceil(step_size / self.longest - 1e-9))
        h = step_size / count
        for k in range(count):
            t, x, u, p = current_time + k * h, self.x, self.u, self.p
            a = rates(t, x, u, p)
            b = rates(t + h / 2, x + h / 2 * a, u, p)
            c = rates(t + h / 2, x + h / 2 * b, u, p)
            d = rates(t + h, x + h * c, u, p)
            self.x += h / 6 * (a + 2 * b + 2 * c + d)
        self.at = current_time + step_size
        return bool(numpy.isfinite(self.x).all())
'''


def fmu_bytes(system: System, name: str) -> bytes:
    """Return the unit, a file that holds all it needs but Python and NumPy.

    Raises
    ------
    InputError
        pythonfmu is not installed, or cannot build it.
    """
    if importlib.util.find_spec("pythonfmu") is None:
        raise InputError("needs pythonfmu", "fmu", "Install it: pip install pythonfmu")
    with staging_folder(Path(tempfile.gettempdir())) as folder:
        script = folder / f"{name}.py"
        script.write_text(slave_text(system, name), encoding="utf-8")
        command = [sys.executable, "-m", "pythonfmu", "build", "-f", str(script)]
        done = subprocess.run(
            [*command, "-d", str(folder)],
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
        made = list(folder.glob("*.fmu"))
        if done.returncode != 0 or not made:
            last = (done.stderr.strip().splitlines() or ["no word of why"])[-1]
            raise InputError(f"pythonfmu cannot build it: {last[:200]}", system.model.name)
        return made[0].read_bytes()


def slave_text(system: System, name: str) -> str:
    """Return the script of the unit: the model's NumPy functions and what FMI asks for."""
    model = system.model
    given = [model.initial.get(state) for state in model.states]
    start = [float(v) if isinstance(v, int | float) else 0.0 for v in given]
    period = model.sample_time
    fields = {
        "name": f"{name[:1].upper()}{name[1:]}",
        "about": one_line(" ".join([model.name, *system.remarks]), 300),
        "start": start,
        "inputs": len(model.inputs),
        "longest": LONGEST_STEP if period is None else min(LONGEST_STEP, period),
    }
    return numpy_text(system, name) + SLAVE.format(**fields)
