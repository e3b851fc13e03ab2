"""Templates of ``explained.py``: an FMU run with what was added, and a step function again."""

RUN_FMU = '''\
"""What {name} leaves out: run it with what a diagnosis added.

    python explained.py recording.csv run.csv

takes time and inputs from a recording, and writes the states. The FMU is looked for beside this
file; FMPy and NumPy are needed.
"""

import math
import sys
from pathlib import Path

import numpy as np

FMU = Path(__file__).with_name({name!r})
STATES = {listed}
INPUTS = {inputs}
COLUMNS = {columns}
TIME = {time!r}
PARAMETERS = {parameters}
START = {start}
SUBSTEPS = 10

{lines}


class Plant:
    """The FMU's own rates, by model exchange."""

    def __init__(self, path, time):
        import fmpy
        from fmpy import fmi2, fmi3

        about = fmpy.read_model_description(str(path), validate=False)
        self.two = about.fmiMajorVersion == 2
        kind = fmi2.FMU2Model if self.two else fmi3.FMU3Model
        self.fmu = kind(
            guid=about.guid,
            unzipDirectory=fmpy.extract(str(path)),
            modelIdentifier=about.modelExchange.modelIdentifier,
            instanceName="explained",
        )
        self.fmu.instantiate()
        where = {{v.name: v.valueReference for v in about.modelVariables}}
        self.inputs = [where[n] for n in INPUTS]
        self.count = len(about.derivatives)
        self.set([where[n] for n in PARAMETERS], list(PARAMETERS.values()))
        if self.two:
            self.fmu.setupExperiment(startTime=time)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=time)
        self.fmu.exitInitializationMode()
        step = self.fmu.newDiscreteStates if self.two else self.fmu.updateDiscreteStates
        while step()[0]:
            pass
        self.fmu.enterContinuousTimeMode()

    def set(self, references, values):
        if references:
            (self.fmu.setReal if self.two else self.fmu.setFloat64)(references, values)

    def rates(self, t, x, u):
        from ctypes import c_double

        n = self.count
        self.fmu.setTime(t)
        self.fmu.setContinuousStates((c_double * n)(*x[:n]), n)
        self.set(self.inputs, list(u))
        dx = (c_double * n)()
        (self.fmu.getDerivatives if self.two else self.fmu.getContinuousStateDerivatives)(dx, n)
        return np.array([*dx, *[0.0] * (len(x) - n)]) + added(t, x, u)


def run(time, inputs, start=START):
    """Return the states, shape (samples, states); inputs lie on lines between samples."""
    plant, x = Plant(FMU, time[0]), np.array(start, dtype=float)
    rows = [x]
    for k in range(len(time) - 1):
        h = (time[k + 1] - time[k]) / SUBSTEPS
        for j in range(SUBSTEPS):
            t = time[k] + j * h
            at = [inputs[k] + (inputs[k + 1] - inputs[k]) * (j + s) / SUBSTEPS for s in (0, 0.5, 1)]
            k1 = plant.rates(t, x, at[0])
            k2 = plant.rates(t + h / 2, x + h / 2 * k1, at[1])
            k3 = plant.rates(t + h / 2, x + h / 2 * k2, at[1])
            k4 = plant.rates(t + h, x + h * k3, at[2])
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        rows.append(x)
    return np.array(rows)


if __name__ == "__main__":
    table = np.genfromtxt(sys.argv[1], delimiter=",", names=True, deletechars="", encoding="utf-8")
    given = np.stack([table[c] for c in COLUMNS], axis=1) if COLUMNS else np.zeros((len(table), 0))
    found = run(table[TIME], given)
    whole = np.column_stack([table[TIME], found])
    np.savetxt(sys.argv[2], whole, delimiter=",", header=",".join([TIME, *STATES]), comments="")
'''
RUN_STEP = '''\
"""What {name} leaves out: its step function with what a diagnosis added.

    from explained import step
    x = step(x, u)

{name} is looked for beside this file.
"""

import importlib.util
import math
from pathlib import Path

import numpy as np

_where = Path(__file__).with_name({name!r})
_spec = importlib.util.spec_from_file_location({stem!r}, _where)
_module = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_module)
STATES = {listed}
INPUTS = {inputs}
PARAMETERS = {parameters}
START = {start}
STEP = {step}

{lines}


def step(x, u, p=PARAMETERS):
    """Take the states a step of STEP seconds further, what is added by an Euler step."""
    x, n = np.asarray(x, dtype=float), {count}
    own = _module.{function}({call})
    return np.concatenate([own, x[n:]]) + STEP * added(0.0, x, u)
'''
