"""Make the bundled demo recordings with MuJoCo, and prove that they say what they should.

A two-link arm (MJCF, its own masses and lengths) follows multisine references under computed
torque. The commanded torques are held over each sample; the encoders add white noise and
quantise. Each set conceals at most one effect, which only `demo_truth.json` tells.

    python benchmarks/make_demo.py            # rewrite the recordings and the truth
    python benchmarks/make_demo.py --verify   # also integrate arm.toml with SciPy and compare

MuJoCo is imported here only; the package itself never needs it.
"""

import argparse
import json
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import sympy
from scipy.integrate import solve_ivp
from sympy.parsing.sympy_parser import parse_expr

HERE = Path(__file__).resolve().parent
DEMO = HERE.parent / "jaxsr" / "datasets" / "demo"
TRUTH = HERE / "demo_truth.json"

SEED = 20240
SAMPLE_TIME = 0.01  # s
TIMESTEP = 2.5e-5  # s; MuJoCo softens dry friction over about two steps
SUBSTEPS = round(SAMPLE_TIME / TIMESTEP)
ENCODER_STEP = 2 * np.pi / 2**13  # rad
ENCODER_NOISE = 4e-4  # rad, standard deviation before quantisation (the step adds 2.2e-4)
TORQUE_DECIMALS = 4  # the command is rounded before it acts, so the file holds it exactly
DURATIONS = {"train": 20.0, "validation": 10.0}  # s
COLUMNS = ("time_s", "encoder1_rad", "encoder2_rad", "torque1_Nm", "torque2_Nm")

Pair = tuple[float, float]
Force = Callable[[np.ndarray, np.ndarray], Pair]  # generalised force from (q, w)
Rates = Callable[[np.ndarray, np.ndarray, Pair], np.ndarray]


@dataclass(frozen=True)
class Arm:
    """Mechanical data of the arm, in SI units; centres of mass are measured along the links."""

    gravity: float = 9.81
    m1: float = 4.0
    l1: float = 0.45
    com1: float = 0.20
    i1: float = 0.09
    rotor1: float = 0.15
    m2: float = 2.5
    com2: float = 0.22
    i2: float = 0.04
    damping1: float = 2.0
    damping2: float = 0.4

    def base_parameters(self) -> dict[str, float]:
        """Return the parameters of arm.toml that this arm has."""
        d = self.i2 + self.m2 * self.com2**2
        return {
            "a": self.rotor1 + self.i1 + self.m1 * self.com1**2 + self.m2 * self.l1**2 + d,
            "b": self.m2 * self.l1 * self.com2,
            "d": d,
            "g1": (self.m1 * self.com1 + self.m2 * self.l1) * self.gravity,
            "g2": self.m2 * self.com2 * self.gravity,
            "Fv1": self.damping1,
            "Fv2": self.damping2,
        }


@dataclass(frozen=True)
class Effect:
    """One concealed effect: how MuJoCo makes it, and the force it is in the model's terms."""

    mechanism: str
    sites: tuple[str, ...]
    parameters: dict[str, tuple[float, str]]  # name -> value, unit
    force: Force
    joint2: str = ""  # attributes of the second joint in MJCF
    elements: str = ""  # further MJCF
    applied: bool = False  # the force has no MJCF element and is applied at every step


FC, KC, KD = 0.5, 0.8, 0.4
# Width of the smoothed sign in the check below; MuJoCo's own is about Fc/d * TIMESTEP.
STICK_WIDTH = 5e-5  # rad/s

EFFECTS: dict[str, Effect | None] = {
    "set1": Effect(
        mechanism="coulomb_friction",
        sites=("equation:w2",),
        parameters={"Fc": (FC, "N*m")},
        force=lambda q, w: (0.0, -FC * np.tanh(w[1] / STICK_WIDTH)),
        # The hardest friction constraint that MuJoCo accepts at this step.
        joint2=f'frictionloss="{FC}" solreffriction="{2 * TIMESTEP} 1" '
        'solimpfriction="0.9999 0.9999 0.001 0.5 2"',
    ),
    "set2": Effect(
        mechanism="coupling_stiffness",
        sites=("equation:w1", "equation:w2"),
        parameters={"kc": (KC, "N*m/rad")},
        force=lambda q, w: (-KC * (q[0] - q[1]), KC * (q[0] - q[1])),
        elements=f'<tendon><fixed stiffness="{KC}" springlength="0">'
        '<joint joint="q1" coef="1"/><joint joint="q2" coef="-1"/></fixed></tendon>',
    ),
    "set3": Effect(
        mechanism="quadratic_drag",
        sites=("equation:w1",),
        parameters={"kd": (KD, "N*m*s**2/rad**2")},
        force=lambda q, w: (-KD * w[0] * abs(w[0]), 0.0),
        applied=True,
    ),
    "set4": None,
}


def mjcf(arm: Arm, effect: Effect | None) -> str:
    """Write the arm in MJCF: links hang along -z, both hinges turn about y."""
    joint2, elements = (effect.joint2, effect.elements) if effect else ("", "")
    return f"""
<mujoco>
  <compiler angle="radian" autolimits="false"/>
  <option timestep="{TIMESTEP}" integrator="RK4" gravity="0 0 -{arm.gravity}" tolerance="1e-14"
          iterations="200"><flag contact="disable"/></option>
  <worldbody>
    <body>
      <inertial pos="0 0 -{arm.com1}" mass="{arm.m1}" diaginertia="{arm.i1} {arm.i1} {arm.i1}"/>
      <joint name="q1" type="hinge" axis="0 1 0" armature="{arm.rotor1}"
             damping="{arm.damping1}"/>
      <body pos="0 0 -{arm.l1}">
        <inertial pos="0 0 -{arm.com2}" mass="{arm.m2}"
                  diaginertia="{arm.i2} {arm.i2} {arm.i2}"/>
        <joint name="q2" type="hinge" axis="0 1 0" damping="{arm.damping2}" {joint2}/>
      </body>
    </body>
  </worldbody>
  {elements}
  <actuator><motor joint="q1"/><motor joint="q2"/></actuator>
</mujoco>"""


@dataclass(frozen=True)
class Reference:
    """A multisine of both joints: q(t) = sum_k amplitude_k sin(rate_k t + phase_k)."""

    amplitude: np.ndarray  # rad, (joints, lines)
    rate: np.ndarray  # rad/s, (lines,)
    phase: np.ndarray  # rad, (joints, lines)

    @classmethod
    def draw(cls, rng: np.random.Generator, duration: float) -> "Reference":
        """Draw phases; scale the largest swings to 1.4 rad (joint 1) and 1.8 rad (joint 2)."""
        frequency = np.array([0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.1, 1.3, 1.7])  # Hz
        amplitude = np.ones((2, 1)) / (1.0 + (frequency / 0.6) ** 2)
        amplitude = amplitude * rng.uniform(0.6, 1.4, amplitude.shape)
        phase = rng.uniform(0.0, 2 * np.pi, amplitude.shape)
        raw = cls(amplitude, 2 * np.pi * frequency, phase)
        t = np.arange(0.0, duration, SAMPLE_TIME)
        largest = np.max(np.abs([raw.at(ti)[0] for ti in t]), axis=0)
        return cls(amplitude * (np.array([1.4, 1.8]) / largest)[:, None], raw.rate, phase)

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration of both joints."""
        angle = self.rate * t + self.phase
        position = np.sum(self.amplitude * np.sin(angle), axis=1)
        velocity = np.sum(self.amplitude * self.rate * np.cos(angle), axis=1)
        return position, velocity, -np.sum(self.amplitude * self.rate**2 * np.sin(angle), axis=1)


def command(arm: Arm, reference: Reference, t: float, q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return the torque for one sample: independent feed-forward and PD on the true state.

    The true state, because feedback of a noisy reading would correlate torque with noise.
    """
    q_ref, w_ref, acceleration = reference.at(t)
    p = arm.base_parameters()
    inertia = np.array([p["a"] + p["b"], p["d"]])
    gravity = p["g2"] * np.sin(q.sum())
    load = np.array([p["g1"] * np.sin(q[0]) + gravity, gravity])
    friction = np.array([p["Fv1"], p["Fv2"]]) * w_ref
    feedback = np.array([60.0, 15.0]) * (q_ref - q) + np.array([8.0, 2.0]) * (w_ref - w)
    return np.round(inertia * acceleration + friction + load + feedback, TORQUE_DECIMALS)


@dataclass(frozen=True)
class Run:
    """A noise-free run at the sample instants; torque[k] acts from t[k] to t[k + 1]."""

    t: np.ndarray  # s, (samples,)
    q: np.ndarray  # rad, (samples, 2)
    w: np.ndarray  # rad/s, (samples, 2)
    torque: np.ndarray  # N m, (samples, 2)
    effect: np.ndarray = field(repr=False)  # N m, (samples, 2), the concealed force


def simulate(rng: np.random.Generator, arm: Arm, effect: Effect | None, duration: float) -> Run:
    """Run MuJoCo under computed torques held over each sample."""
    model = mujoco.MjModel.from_xml_string(mjcf(arm, effect))
    data = mujoco.MjData(model)
    reference = Reference.draw(rng, duration)
    data.qpos[:], data.qvel[:], _ = reference.at(0.0)
    samples = round(duration / SAMPLE_TIME)
    q, w, torque, hidden = np.zeros((4, samples, 2))
    for k in range(samples):
        q[k], w[k] = data.qpos, data.qvel
        torque[k] = command(arm, reference, k * SAMPLE_TIME, q[k], w[k])
        hidden[k] = effect.force(q[k], w[k]) if effect else 0.0
        data.ctrl[:] = torque[k]
        if effect and effect.applied:
            for _ in range(SUBSTEPS):
                data.qfrc_applied[:] = effect.force(data.qpos, data.qvel)
                mujoco.mj_step(model, data)
        else:
            mujoco.mj_step(model, data, SUBSTEPS)
    return Run(np.arange(samples) * SAMPLE_TIME, q, w, torque, hidden)


def read_encoders(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    """Add white noise, then quantise."""
    noisy = q + ENCODER_NOISE * rng.standard_normal(q.shape)
    return ENCODER_STEP * np.round(noisy / ENCODER_STEP)


def make_runs(arm: Arm) -> dict[str, tuple[Run, np.ndarray]]:
    """Return the noise-free run and the encoder readings of every file."""
    made = {}
    for i, (name, effect) in enumerate(EFFECTS.items()):
        for j, (part, duration) in enumerate(DURATIONS.items()):
            rng = np.random.default_rng([SEED, i, j])
            run = simulate(rng, arm, effect, duration)
            made[f"{name}_{part}"] = run, read_encoders(rng, run.q)
    return made


def write_recordings(made: dict[str, tuple[Run, np.ndarray]], folder: Path) -> None:
    """Write one CSV a run."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (run, reading) in made.items():
        formats = ("{:.2f}", "{:.6f}", "{:.6f}", "{:.4f}", "{:.4f}")
        values = np.column_stack([run.t, reading, run.torque]) + 0.0  # no negative zeros
        columns = zip(COLUMNS, formats, values.T, strict=True)
        table = pd.DataFrame({c: [f.format(x) for x in v] for c, f, v in columns})
        table.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")


def truth(arm: Arm) -> dict:
    """Return what each set conceals, in the names of the model file and of diagnosis.json."""
    sets = {}
    for name, effect in EFFECTS.items():
        if effect is None:
            sets[name] = {"verdict": "nothing", "mechanism": None, "sites": [], "parameters": {}}
            continue
        parameters = {k: {"value": v, "unit": u} for k, (v, u) in effect.parameters.items()}
        sets[name] = {
            "verdict": "structure",
            "mechanism": effect.mechanism,
            "sites": list(effect.sites),
            "parameters": parameters,
        }
    return {
        "made_with": {"mujoco": mujoco.__version__, "seed": SEED},
        "model_parameters": {k: round(v, 12) for k, v in arm.base_parameters().items()},
        "sensors": {"quantisation_rad": ENCODER_STEP, "noise_rad": ENCODER_NOISE},
        "sets": sets,
    }


def model_rates(path: Path) -> Rates:
    """Return d(q1, q2, w1, w2)/dt of a model file as f(x, torque, extra force)."""
    tables = tomllib.loads(path.read_text())
    states, inputs = tables["model"]["states"], tables["model"]["inputs"]
    names = {n: sympy.Symbol(n) for n in [*states, *inputs, *tables["parameters"]]}

    def parse(text: str) -> sympy.Expr:
        return parse_expr(text, local_dict=names)

    for name, text in tables["definitions"].items():
        names[name] = parse(text)
    right = [parse(tables["equations"][s]) for s in states]
    moving = list(tables["inertia"])
    mass = sympy.Matrix([[parse(tables["inertia"][i][j]) for j in moving] for i in moving])
    values = {names[k]: v["value"] for k, v in tables["parameters"].items()}
    evaluate = sympy.lambdify(
        [names[n] for n in [*states, *inputs]],
        [mass.subs(values), [e.subs(values) for e in right]],
        "numpy",
    )

    def rates(x: np.ndarray, torque: np.ndarray, extra: Pair) -> np.ndarray:
        inertia, right = evaluate(*x, *torque)
        return np.concatenate([right[:2], np.linalg.solve(inertia, np.add(right[2:], extra))])

    return rates


def one_sample_later(rates: Rates, x: np.ndarray, torque: np.ndarray, force: Force) -> np.ndarray:
    """Integrate over one sample under a held torque."""

    def right(t: float, x: np.ndarray) -> np.ndarray:
        return rates(x, torque, force(x[:2], x[2:]))

    solution = solve_ivp(right, (0.0, SAMPLE_TIME), x, method="LSODA", rtol=1e-9, atol=1e-11)
    return solution.y[:, -1]


def verify(made: dict[str, tuple[Run, np.ndarray]], window: float = 2.0) -> dict[str, float]:
    """Integrate arm.toml plus the true effect with SciPy; return the largest error in rad.

    Every second window starts from MuJoCo's state, then runs free with the recorded torques.
    The figure is the largest angle error over joints, samples and the windows of one file:
    set1 3e-5 (MuJoCo's friction is not perfectly hard; the error falls with its step), set2
    6e-9, set3 8e-6 (the drag is held over one step), set4 2e-8; the readings' noise is 4.6e-4.
    """
    rates = model_rates(DEMO / "arm.toml")
    count = round(window / SAMPLE_TIME)
    errors = {}
    for name, (run, _) in made.items():
        effect = EFFECTS[name.partition("_")[0]]
        force: Force = effect.force if effect else lambda q, w: (0.0, 0.0)
        worst = 0.0
        for start in range(0, len(run.t) - count, 2 * count):
            x = np.concatenate([run.q[start], run.w[start]])
            for k in range(start, start + count):
                x = one_sample_later(rates, x, run.torque[k], force)
                worst = max(worst, float(np.max(np.abs(x[:2] - run.q[k + 1]))))
        errors[name] = worst
    return errors


def check_model(arm: Arm) -> None:
    """Raise if arm.toml does not hold this arm's parameters to 1e-6."""
    given = tomllib.loads((DEMO / "arm.toml").read_text())["parameters"]
    for name, value in arm.base_parameters().items():
        if abs(given[name]["value"] / value - 1.0) > 1e-6:
            raise ValueError(f"arm.toml: {name} = {given[name]['value']}, the arm has {value}")


def describe(made: dict[str, tuple[Run, np.ndarray]]) -> None:
    """Print swings, reversals, torques and the effect's size against the torque."""
    for name, (run, _) in made.items():
        torque, hidden = (np.sqrt(np.mean(x**2, axis=0)) for x in (run.torque, run.effect))
        reversals = np.sum(np.diff(np.sign(run.w), axis=0) != 0, axis=0)
        print(
            f"{name:16s} max|q| {np.abs(run.q).max(0).round(2)} rad"
            f"  max|w| {np.abs(run.w).max(0).round(1)} rad/s  reversals {reversals}"
            f"  rms torque {torque.round(2)} N m  effect/torque {(hidden / torque).round(3)}"
        )


def main() -> None:
    """Make everything; see the module's text."""
    parser = argparse.ArgumentParser(description="Make the bundled demo recordings.")
    parser.add_argument("--out", type=Path, default=DEMO, help="folder of the recordings")
    parser.add_argument("--truth", type=Path, default=TRUTH, help="file that tells the effects")
    parser.add_argument("--verify", action="store_true", help="compare with SciPy as well")
    options = parser.parse_args()
    arm = Arm()
    check_model(arm)
    made = make_runs(arm)
    write_recordings(made, options.out)
    options.truth.write_text(json.dumps(truth(arm), indent=2) + "\n")
    describe(made)
    if options.verify:
        for name, error in verify(made).items():
            print(f"{name:16s} largest error over windows of 2 s: {error:.1e} rad")


if __name__ == "__main__":
    main()
