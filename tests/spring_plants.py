"""A mass on a spring that hardens, of which one value is not what the file says."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.models import Model, parse_model
from jaxsr.recordings import Recording

VALUES = {"m": 2.0, "k": 40.0, "k3": 400.0, "c": 1.2}
SAMPLES, STEP, NOISE = 300, 0.02, 0.005


def given(wrong: str, factor: float, driven: bool = True) -> Model:
    """Return the model file with one value off by a factor; without `driven` nothing pushes it.

    A shaken support drives it then, so that forces are told up to a factor alone, and the mass is
    fixed.
    """
    said = VALUES | {wrong: factor * VALUES[wrong]}
    bounds = {n: f", bounds = [{0.2 * v}, {5.0 * v}]" for n, v in said.items()}
    if not driven:
        bounds["m"] = ""
    rows = [f"{n} = {{ value = {v}{bounds[n]} }}" for n, v in said.items()]
    push = "u" if driven else "-m*u"
    return parse_model(
        f"""
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "({push} - k*q - k3*q**3 - c*v)/m"
[readings]
y = "q"
[parameters]
"""
        + "\n".join(rows)
    )


def recordings(seed: int, driven: bool = True) -> list[Recording]:
    """Two recordings of the plant under a multisine."""
    rng, found = np.random.default_rng(seed), []
    time = np.arange(SAMPLES) * STEP
    m, k, k3, c = VALUES.values()
    for number in range(2):
        rates, phases = rng.uniform((1.0, 3.0, 5.0), (3.0, 5.0, 9.0)), rng.uniform(0.0, 6.0, 3)
        size = 6.0 if driven else 3.0
        u = size * np.sin(rates * time[:, None] + phases).sum(1)

        def field(t: float, x: np.ndarray, u: np.ndarray = u) -> list[float]:
            push = np.interp(t, time, u) * (1.0 if driven else -m)
            return [x[1], (push - k * x[0] - k3 * x[0] ** 3 - c * x[1]) / m]

        run = solve_ivp(
            field, (0.0, time[-1]), [0.0, 0.0], t_eval=time, max_step=STEP, rtol=1e-8, atol=1e-10
        )
        y = run.y[0] + NOISE * np.std(run.y[0]) * rng.standard_normal(SAMPLES)
        found.append(Recording(f"run{number}.csv", time, {"u": u, "y": y}))
    return found
