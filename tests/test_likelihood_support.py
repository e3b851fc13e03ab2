"""What a model with many equations is asked about: both forms of an actuator's limit."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.likelihood import support
from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.support import MOST
from jaxsr.diagnosis.likelihood.table import tabled
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import state_scale
from jaxsr.models import parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

COUNT = 6
TIME = np.arange(200) * 0.02


def chain(pushed: tuple[int, ...] = (2,)) -> str:
    """A chain of masses between springs, some of them pushed."""
    places, speeds = (", ".join(f'"{s}{k}"' for k in range(1, COUNT + 1)) for s in "xv")
    inputs = ", ".join(f'"F{k}"' for k in pushed)
    lines = ["[model]", 'name = "chain"', f"states = [{places}, {speeds}]", f"inputs = [{inputs}]"]
    outputs = ", ".join(f'"y{k}"' for k in range(1, COUNT + 1))
    lines += [f"outputs = [{outputs}]", "[equations]"]
    lines += [f'x{k} = "v{k}"' for k in range(1, COUNT + 1)]
    for k in range(1, COUNT + 1):
        left = f"(x{k} - x{k - 1})" if k > 1 else "x1"
        right = f"(x{k} - x{k + 1})" if k < COUNT else f"x{COUNT}"
        push = f"F{k} " if k in pushed else ""
        lines.append(f'v{k} = "{push}- k*{left} - k*{right} - 0.7*v{k}"')
    lines += ["[readings]", *(f'y{k} = "x{k}"' for k in range(1, COUNT + 1))]
    lines += ["[parameters]", "k = { value = 700.0, bounds = [300.0, 1500.0] }"]
    return "\n".join(lines)


def recorded(
    rng: np.random.Generator, also: tuple[int, ...] = (), dragged: int | None = None
) -> Recording:
    """The chain behind an actuator that gives no more than half of the largest command.

    Or behind one that gives all of it, and one of the masses with a drag of its own.
    """
    waves = np.sin(np.outer(TIME, rng.uniform(2.0, 30.0, 5)) + rng.uniform(0.0, 6.0, 5))
    command = 8.0 * waves.sum(axis=1)
    others = {f"F{k}": np.sin(rng.uniform(2.0, 30.0) * TIME) for k in also}
    most = (0.5 if dragged is None else 1.0) * np.abs(command).max()
    stiffness = 700.0 * (2.0 * np.eye(COUNT) - np.eye(COUNT, k=1) - np.eye(COUNT, k=-1))

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        force = np.zeros(COUNT)
        force[1] = np.clip(np.interp(t, TIME, command), -most, most)
        force[[k - 1 for k in also]] = [np.interp(t, TIME, others[f"F{k}"]) for k in also]
        if dragged is not None:
            v = x[COUNT + dragged - 1]
            force[dragged - 1] -= 1.5 * v * abs(v)
        return np.concatenate([x[COUNT:], force - stiffness @ x[:COUNT] - 0.7 * x[COUNT:]])

    start = np.zeros(2 * COUNT)
    run = solve_ivp(rate, (0.0, TIME[-1]), start, t_eval=TIME, rtol=1e-7, atol=1e-9)
    noise = 1e-4 * rng.normal(size=(COUNT, TIME.size))
    readings = {f"y{k + 1}": run.y[k] + noise[k] for k in range(COUNT)}
    return Recording("run", TIME, {"F2": command, **others, **readings})


def test_every_form_of_a_limit_is_offered_where_candidates_are_many() -> None:
    """A round limit is another law than a sharp one: without it, two others were told."""
    model = parse_model(chain())
    course = followed(model, [Prepared.build(model, recorded(np.random.default_rng(0)))])
    assert course is not None
    every = offered(model, course)
    assert MOST <= len(every) < 2 * MOST  # some were left out
    limits = {c.terms for c in every if c.mechanism == "input_saturation"}
    assert len(limits) == 2
    assert any("tanh" in text for terms in limits for _, text in terms)


def test_variants_take_no_place_of_a_law_that_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three actuators variants are many: kept all, they left 10 places to the forces."""
    model = parse_model(chain((1, 2, 3)))
    course = followed(model, [Prepared.build(model, recorded(np.random.default_rng(1), (1, 3)))])
    assert course is not None

    def laws() -> Counter[tuple[str, object]]:
        """What is ranked: forces by their names, limits of an actuator by their formulas."""
        some = (c for c in offered(model, course) if c.terms and not c.states)
        ranked = [c for c in some if not c.inertia and c.mechanism != "constant_force"]
        return Counter((c.label, c.terms * c.site.startswith("input:")) for c in ranked)

    few = laws()
    monkeypatch.setattr(support, "MOST", 10**6)
    every = laws()
    assert every.total() > few.total() > 0  # some were left out
    assert few.keys() == every.keys() or max(few.values()) == 1
    forces = {label for label, _ in few if "@equation:" in label}
    assert len(forces) > 20


def test_many_sensors_leave_room_for_forces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Faults of a robot's sensors alone were more than all places: no friction was asked about."""
    model = parse_model(chain())
    course = followed(model, [Prepared.build(model, recorded(np.random.default_rng(2)))])
    assert course is not None
    monkeypatch.setattr(support, "MOST", 30)
    every = offered(model, course)
    at_sensors = sum(bool(c.readings) for c in every)
    laws = [c for c in every if c.terms and not c.states and c.mechanism != "constant_force"]
    assert at_sensors > 12  # two for each of them, at least
    assert len(laws) == 15


def test_gains_are_those_of_the_table_about_the_same_path() -> None:
    """A coefficient's column is a force's, times what the law says along the path."""
    model = parse_model(chain())
    prepared = [Prepared.build(model, recorded(np.random.default_rng(3), dragged=4))]
    course = followed(model, prepared)
    assert course is not None
    response, scale = course.response(), state_scale(model, course.prepared)
    some = [
        c
        for c in force_candidates(model, scale, course.motion)
        if c.mechanism in ("quadratic_drag", "coulomb_friction", "cubic_stiffness")
    ]
    signals = course.motion.signals
    forces = []
    for c in some:
        v = signals[c.terms[0][0]]
        q = signals["x" + c.terms[0][0][1:]]
        law = {"quadratic_drag": v * np.abs(v), "coulomb_friction": np.sign(v)}
        forces.append({c.terms[0][0]: law.get(c.mechanism, q**3)})
    told = response.gains(forces)
    pushes = [c for c in force_candidates(model, scale) if c.mechanism == "constant_force"]
    super_model = SuperModel.build(model, [*some, *pushes])
    null = course.null
    work = Workspace.build(super_model, course.prepared, course.seconds, null.noise)
    table = tabled(work, work.theta, null.path, null.noise, null.decay)
    table = replace(table, grams=[table.grams[0]]) if not null.share else table
    base = list(table.base)
    exact = np.array([table.best([*base, *table.own[i]]) for i in range(len(some))])
    exact -= table.best(base)
    best = int(np.argmax(exact))
    assert (some[best].mechanism, some[best].site) == ("quadratic_drag", "equation:v4")
    assert int(np.argmax(told)) == best
    assert np.corrcoef(told, exact)[0, 1] > 0.98


@pytest.mark.parametrize("seed", range(3))
def test_the_law_that_acts_is_among_few(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    model = parse_model(chain())
    rng = np.random.default_rng([seed, 4])
    mass = int(rng.integers(1, COUNT + 1))
    course = followed(model, [Prepared.build(model, recorded(rng, dragged=mass))])
    assert course is not None
    monkeypatch.setattr(support, "MOST", 20)  # ten places for 150 forces
    every = {c.label for c in offered(model, course)}
    assert f"quadratic_drag@equation:v{mass}" in every
