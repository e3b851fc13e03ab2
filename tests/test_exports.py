"""Models in other languages: what comes back computes what the model computes."""

from __future__ import annotations

import ctypes
import math
import re
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy

import jaxsr
from jaxsr.expressions import define_primitive, evaluate
from jaxsr.models import Model, Simulator, parse_model, read_model
from jaxsr.models.exports import ENDINGS, export_text

MODELS = Path(jaxsr.__file__).parent / "datasets"
# Every function of the grammar; names that are words of the other languages; a step at zero.
EVERYTHING = """
[model]
name = "all of it */ \\"quoted\\" \\\\ %"
time = "time"
states = ["x", "double", "end", "der"]
inputs = ["u", "i"]
outputs = ["y", "void"]
[definitions]
s1 = "sin(x)*cos(end) + tan(0.3*u)"
[equations]
x = "double + sign(u - 0.5) + floor(3*x) + Heaviside(u - 0.5) + Heaviside(x) + pi"
double = "s1**2 + Piecewise((x**3, And(x > 0, k > 1)), (Abs(x)**1.7, Or(x < -1, Not(u > 0))))"
end = "asin(x/9) + acos(x/9) + atan(x) + atan2(x, end) + Max(x, u, 0.1) - Min(x, u)*s1"
der = "sinh(x) - cosh(u) + tanh(x) + exp(-x) + log(k + x**2) + sqrt(Abs(i)) + x**(-2)/3 - time/7"
[inertia]
end = { end = "2 + s1**2", der = "0.1*x" }
der = { end = "0.1*x", der = "k" }
[readings]
y = "x*d(end)"
void = "Piecewise((x, x >= 0), (u, True)) + lambda_"
[parameters]
k = 2.5
lambda_ = 1e-5
"""
BOUNCE = """
[model]
name = "bouncing ball"
states = ["q", "v"]
inputs = ["u"]
outputs = ["height"]
[equations]
q = "v"
v = "u/m - 9.81"
[readings]
height = "q"
[parameters]
m = { value = 0.5, unit = "kg" }
tau = { value = 0.02, unit = "s" }
[initial]
q = 1.0
v = 0.0
[delays]
u = "tau"
height = 0.005
[units]
q = "m"
v = "m/s"
u = "kg*m/s**2"
[[events]]
when = "q"
direction = -1
reset = { v = "-0.8*v" }
"""
TEXTS = {"all": EVERYTHING, "bounce": BOUNCE}
FILES = ("models/emps.toml", "models/triple_pendulum.toml", "models/kvlcc2.toml", "demo/arm.toml")


def model_of(name: str) -> Model:
    if name in TEXTS:
        return parse_model(TEXTS[name])
    return read_model(MODELS / name)


CASES = [*TEXTS, *FILES]


def points(model: Model, count: int = 40) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Return times, states and inputs; steps are met where they jump, at u = 0.5 and x = 0."""
    rng = np.random.default_rng(5)
    found = []
    for k in range(count):
        x = rng.uniform(-2.0, 2.0, len(model.states))
        u = rng.uniform(-2.0, 2.0, len(model.inputs))
        if k == 0:
            u[:] = 0.5
        found.append((float(rng.uniform(0.0, 9.0)), x, u))
    return found


def expected(model: Model, t: float, x: Any, u: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return rates and readings as the model's own terms give them."""
    names = {model.time: t, **{n: p.value for n, p in model.parameters.items()}}
    names |= dict(zip(model.states, x, strict=True)) | dict(zip(model.inputs, u, strict=True))
    with np.errstate(all="ignore"):
        rates = [evaluate(model.rate_terms[s], names) for s in model.states]
        readings = [evaluate(model.reading_terms[y], names) for y in model.outputs]
    return np.array(rates, dtype=float), np.array(readings, dtype=float)


def same(got: Any, wanted: np.ndarray, rtol: float = 1e-11) -> None:
    np.testing.assert_allclose(np.asarray(got, dtype=float), wanted, rtol=rtol, atol=rtol)


@pytest.mark.parametrize("name", CASES)
def test_c_compiled_without_a_warning_computes_the_same(name: str, tmp_path: Path) -> None:
    model = model_of(name)
    source, library = tmp_path / "m.c", tmp_path / "m.so"
    source.write_text(export_text(model, "c", "m"))
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O0", "-fPIC", "-shared")
    command = ["gcc", *strict, str(source), "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    compiled = ctypes.CDLL(str(library))
    p = (ctypes.c_double * max(len(model.parameters), 1)).in_dll(compiled, "m_parameters")

    def call(function: str, t: float, x: np.ndarray, u: np.ndarray, size: int) -> np.ndarray:
        out = (ctypes.c_double * size)()
        arrays = [(ctypes.c_double * max(len(v), 1))(*v) for v in (x, u)]
        getattr(compiled, function)(ctypes.c_double(t), *arrays, p, out)
        return np.array(out)

    for t, x, u in points(model):
        rates, readings = expected(model, t, x, u)
        same(call("m_rates", t, x, u, len(rates)), rates)
        same(call("m_readings", t, x, u, len(readings)), readings)


@pytest.mark.parametrize("name", CASES)
def test_files_for_numpy_and_jax_compute_the_same(name: str) -> None:
    model = model_of(name)
    at = points(model)
    t, x, u = (np.array(part) for part in zip(*at, strict=True))
    wanted = [
        np.stack(part, axis=-1) for part in zip(*(expected(model, *a) for a in at), strict=True)
    ]
    space: dict[str, Any] = {}
    exec(compile(export_text(model, "numpy"), "numpy export", "exec"), space)
    with np.errstate(all="ignore"):
        same(space["rates"](t, x.T, u.T), wanted[0])
        same(space["readings"](t, x.T, u.T), wanted[1])
        same(space["rates"](*at[1]), wanted[0][:, 1])
    with jax.enable_x64(True):
        exec(compile(export_text(model, "jax"), "JAX export", "exec"), space)
        arrays = jnp.asarray(t), jnp.asarray(x.T), jnp.asarray(u.T)
        same(jax.jit(space["rates"])(*arrays), wanted[0])
        same(jax.jit(space["readings"])(*arrays), wanted[1])


@pytest.mark.parametrize("name", CASES)
def test_functions_compute_the_same(name: str) -> None:
    model = model_of(name)
    simulator = Simulator(model)
    at = points(model)
    t, x, u = (np.array(part) for part in zip(*at, strict=True))
    wanted = np.stack([expected(model, *a)[0] for a in at], axis=-1)
    same(simulator.to_numpy()(t, x.T, u.T), wanted)
    same(simulator.to_numpy()(*at[1]), wanted[:, 1])
    with jax.enable_x64(True):
        arrays = jnp.asarray(t), jnp.asarray(x.T), jnp.asarray(u.T)
        same(jax.jit(simulator.to_jax())(*arrays), wanted)
        jumps = name == "all"  # where the simulator smooths a sign, it is another function
        if not jumps:
            own = simulator.rates(t, tuple(x.T), tuple(u.T), simulator.values())
            same(own, wanted, 1e-9)


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_formulas_in_sympy_compute_the_same(name: str) -> None:
    model = model_of(name)
    space: dict[str, Any] = {}
    exec(compile(export_text(model, "sympy"), "SymPy export", "exec"), space)
    rates = Simulator(model).sympy()
    symbols = {str(s): s for e in rates.values() for s in e.free_symbols}
    names = (*model.states, *model.inputs)
    for t, x, u in points(model, 4)[1:]:
        values = {model.time: t, **dict(zip(names, [*x, *u], strict=True))}
        values |= {n: p.value for n, p in model.parameters.items()}
        at = {symbols[n]: v for n, v in values.items() if n in symbols}
        wanted, seen = expected(model, t, x, u)
        same([float(e.subs(at)) for e in rates.values()], wanted)
        own = {
            k: v for key, v in values.items() for k in space["rates"] if str(k).strip("_") == key
        }
        free = {
            s
            for e in (*space["rates"].values(), *space["readings"].values())
            for s in e.free_symbols
        }
        own |= {s: values[n] for s in free for n in values if str(s) in (n, n + "_")}
        same([float(e.subs(own)) for e in space["rates"].values()], wanted)
        same([float(e.subs(own)) for e in space["readings"].values()], seen)


def matlab(text: str) -> Callable[..., Any]:
    """Return the function of a MATLAB file, its statements read as Python."""
    lines = text.split("\n")
    start = next(k for k, line in enumerate(lines) if line.startswith("dx = zeros"))
    out, depth = [], 0
    for line in lines[start:]:
        code = line.strip().rstrip(";")
        code = re.sub(r"\.([*/^])", r"\1", code).replace("^", "**").replace("~=", "!=")
        code = code.replace("~", " not ").replace("&", " and ").replace("|", " or ")
        code = re.sub(r"\b(x|u|p|dx|y)\((\d+)\)", lambda m: f"{m[1]}[{int(m[2]) - 1}]", code)
        code = re.sub(r"zeros\((\d+), 1\)", r"[0.0]*\1", code)
        if code in ("end", "else") or code.startswith("elseif"):
            depth -= 1
        if code == "end":
            continue
        head = re.match(r"(if|elseif) (.*)", code)
        code = f"{'elif' if head[1] == 'elseif' else 'if'} {head[2]}:" if head else code
        code = "else:" if code == "else" else code
        if code:
            out.append("    " * (depth + 1) + code)
        depth += code.endswith(":")
    space = functions()
    exec("def f(t, x, u, p):\n" + "\n".join([*out, "    return dx, y"]), space)
    return space["f"]


def functions() -> dict[str, Any]:
    """Return the elementary functions of MATLAB and Modelica."""
    names = "exp log sqrt sin cos tan asin acos atan atan2 sinh cosh tanh floor pi".split()
    space = {name: getattr(math, name) for name in names}
    return space | {"abs": abs, "max": max, "min": min, "NaN": math.nan, "sign": np.sign}


@pytest.mark.parametrize("name", CASES)
def test_matlab_says_the_same(name: str) -> None:
    model = model_of(name)
    text = export_text(model, "matlab", "m")
    function = matlab(text)
    p = [parameter.value for parameter in model.parameters.values()]
    assert f"p = [{'; '.join(repr(float(v)) for v in p)}]" in text
    for t, x, u in points(model):
        rates, readings = expected(model, t, x, u)
        dx, y = function(t, x, u, p)
        same(dx, rates)
        same(y, readings)


def modelica(text: str) -> tuple[dict[str, str], list[tuple[str, str]]]:
    """Return the declared parameters, and both sides of every equation, as Python."""
    values = dict(re.findall(r"parameter Real (\w+)(?:\(.*\))? = (.*);", text))
    body = text.split("\nequation\n")[1].split("\n  when ")[0]
    rows = []
    for line in body.split("\n"):
        if " = " in line and line.endswith(";"):
            left, right = line.strip().rstrip(";").split(" = ", 1)
            rows.append(
                tuple(branches(s).replace("^", "**").replace("<>", "!=") for s in (left, right))
            )
    return values, rows


def branches(text: str) -> str:
    """Turn ``(if a then b else if c then d else e)`` into Python's conditionals."""
    start = text.find("(if ")
    if start < 0:
        return text
    depth, parts, last = 0, [""], start + 4
    for k in range(start, len(text)):
        depth += (text[k] == "(") - (text[k] == ")")
        if depth == 0:
            break
        mark = re.match(r" then | else if | else ", text[k:]) if depth == 1 else None
        if mark and k >= last:
            parts[-1] = text[last:k]
            parts.append("")
            last = k + len(mark[0])
    parts[-1] = text[last:k]
    *pairs, shown = map(branches, parts)
    for when, value in zip(pairs[-2::-2], pairs[-1::-2], strict=True):
        shown = f"(({value}) if ({when}) else ({shown}))"
    return f"{text[:start]}({shown}){branches(text[k + 1 :])}"


@pytest.mark.parametrize("name", CASES)
def test_modelica_says_the_same(name: str) -> None:
    """Its equations hold for the model's rates: both sides are the same number."""
    model = model_of(name)
    text = export_text(model, "modelica", "M").replace("(0.0/0.0)", "NaN")  # of no branch
    values, rows = modelica(text)
    assert len(rows) >= len(model.states) + len(model.outputs)
    for t, x, u in points(model, 5):
        rates, readings = expected(model, t, x, u)
        space = {**functions(), "time": t, **{n: float(v) for n, v in values.items()}}
        for names, numbers in ((model.states, x), (model.inputs, u), (model.outputs, readings)):
            space |= {
                f"{n}_" if n in ("der", "end") else n: v
                for n, v in zip(names, numbers, strict=True)
            }
        derivatives = dict(zip(x, rates, strict=True))
        space["der"], space["delay"] = derivatives.__getitem__, lambda value, tau: value
        for left, right in rows:
            if re.fullmatch(r"s\d+_*|\w+_delayed", left):
                space[left] = eval(right, dict(space))
            else:
                same(eval(left, dict(space)), eval(right, dict(space)))


def test_modelica_holds_delays_starts_and_jumps() -> None:
    text = export_text(parse_model(BOUNCE), "modelica")
    for line in (
        "model bouncing_ball ",
        'Real q(unit = "m", start = 1.0, fixed = true);',
        'input Real u(unit = "kg.m/s2");',
        "u_delayed = delay(u, tau);",
        "height = delay(q, 0.005);",
        "when q <= 0 then",
        "reinit(v, -0.8*pre(v));",
        "end bouncing_ball;",
    ):
        assert line in text, line


def test_latex_shows_the_mass_matrix_and_rounds() -> None:
    text = export_text(parse_model(BOUNCE.replace("9.81", "9.8123456")), "latex")
    assert r"\dot{v} &= -9.812 + \frac{u}{m}" in text
    arm = export_text(read_model(MODELS / "demo" / "arm.toml"), "latex")
    assert r"\dot{w_{2}}" in arm.split("&=")[2] and arm.count(r"\\") == 5


def test_what_two_functions_cannot_hold_is_said() -> None:
    for to in ("c", "matlab", "numpy", "jax", "sympy", "latex"):
        text = export_text(parse_model(BOUNCE), to)
        assert "Not in here: u acts tau s late." in text, to
        assert "where q crosses zero, v becomes -0.8*v" in text, to


def test_a_six_link_chain_takes_a_page_each(tmp_path: Path) -> None:
    """A mass matrix solved by elimination: written out it would have more terms than atoms."""
    n = 6
    states = [f"q{k}" for k in range(n)] + [f"w{k}" for k in range(n)]
    rows = {
        f"w{i}": {f"w{j}": f"{n - max(i, j)}*cos(q{i} - q{j})" for j in range(n)} for i in range(n)
    }
    tables = [f"states = {states!r}\noutputs = ['y']".replace("'", '"'), "[equations]"]
    tables += [f'q{k} = "w{k}"\nw{k} = "-sin(q{k}) - 0.1*w{k}"' for k in range(n)]
    tables += ["[inertia]"] + [
        f"{i} = {{ {', '.join(f'{j} = {chr(34)}{e}{chr(34)}' for j, e in row.items())} }}"
        for i, row in rows.items()
    ]
    model = parse_model("\n".join(["[model]", *tables, '[readings]\ny = "q0"']))
    for to in set(ENDINGS) - {"latex"}:
        assert len(export_text(model, to)) < 40_000, to


def test_refusals_name_what_and_why(tmp_path: Path) -> None:
    model = parse_model(BOUNCE)
    with pytest.raises(jaxsr.InputError, match="cannot export to 'fortran'"):
        export_text(model, "fortran")
    with pytest.raises(jaxsr.InputError, match="cannot name a function"):
        export_text(model, "c", "2; rm")
    define_primitive("softly", lambda x: np.logaddexp(x, 0.0), jax=lambda x: jnp.logaddexp(x, 0.0))
    plain = BOUNCE.replace("[units]", "[columns]")
    own = parse_model(plain.replace("u/m - 9.81", "softly(u)/m"))
    with pytest.raises(jaxsr.InputError, match="v uses softly, a function without a formula"):
        export_text(own, "c")
    assert Simulator(own).to_numpy()(0.0, [0.0, 0.0], [0.0])[1] == pytest.approx(2 * math.log(2))
    with pytest.raises(jaxsr.InputError, match="1 states for 2"):
        Simulator(model).to_numpy()(0.0, [0.0])
    with pytest.raises(jaxsr.InputError, match="no parameter 'mass'"):
        Simulator(model).to_numpy()(0.0, [0.0, 0.0], [0.0], {"mass": 1.0})


def test_rates_are_a_right_hand_side_for_scipy_and_can_be_differentiated() -> None:
    from scipy.integrate import solve_ivp

    text = BOUNCE.split("[delays]")[0]
    simulator = Simulator(parse_model(text))
    rates = simulator.to_numpy()
    fall = solve_ivp(lambda t, x: rates(t, x, [0.0]), (0.0, 0.4), [1.0, 0.0], rtol=1e-9)
    assert fall.y[0, -1] == pytest.approx(1.0 - 0.5 * 9.81 * 0.16)
    slope = jax.jacobian(lambda u: simulator.to_jax()(0.0, jnp.zeros(2), u))(jnp.zeros(1))
    assert np.asarray(slope).tolist() == [[0.0], [2.0]]
    u, m = (sympy.Symbol(n, real=True) for n in ("u", "m"))
    left = simulator.sympy()["v"] - (u / m - sympy.Float(9.81))
    assert abs(float(left.subs({u: 1.3, m: 0.7}))) < 1e-12 and not left.free_symbols


def test_a_parameter_is_replaced_by_name() -> None:
    function: Callable[..., Mapping[str, Any]] = Simulator(parse_model(BOUNCE)).to_numpy()
    assert function(0.0, [0.0, 0.0], [1.0], {"m": 4.0})[1] == pytest.approx(0.25 - 9.81)
