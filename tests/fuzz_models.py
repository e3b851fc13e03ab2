"""Hostile model files: seeded mutations of valid ones, wrong types at every key, and bombs.

``python tests/fuzz_models.py FIRST LAST`` reads the files of these seeds one after the other in
one process and prints a JSON line for each that is not as it should be, then one of totals.
"""

from __future__ import annotations

import copy
import json
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from hostile_values import EXPRESSIONS, KEYS, LONG, NUMBERS, OTHERS, RAW, UNITS, Raw

SECONDS = 2.0

EVERYTHING: dict[str, Any] = {
    "model": {
        "name": "every table",
        "time": "t",
        "states": ["q", "v", "z"],
        "inputs": ["u"],
        "outputs": ["y", "w"],
        "input_hold": "zero",
        "sample_time": 0.01,
    },
    "definitions": {"stretch": "q - z", "pull": "k*stretch"},
    "equations": {"q": "v", "v": "u - Fc*sign(v) - pull", "z": "(q - z)/tau"},
    "inertia": {"v": {"v": "M"}},
    "readings": {"y": "q + y0", "w": "v"},
    "parameters": {
        "M": {"value": 2.0, "unit": "kg", "bounds": [1.0, 3.0]},
        "k": {"value": 10.0, "unit": "N/m"},
        "Fc": {"value": 0.1, "unit": "N", "bounds": [0.0, 1.0]},
        "tau": {"value": 0.1, "unit": "s"},
        "y0": {"value": 0.0, "unit": "m"},
        "s": 1e-4,
    },
    "per_recording": {"y0": {"a file.csv": 0.1, "b.csv": -2.0}},
    "initial": {"q": 0.25, "v": "free"},
    "delays": {"u": 0.002, "y": "tau"},
    "clock": {"y": "1 + s"},
    "noise": {"y": 1e-6},
    "resolution": {"y": 1e-5},
    "events": [{"when": "q", "direction": -1, "reset": {"v": "-0.8*v"}}],
    "units": {"t": "s", "q": "m", "v": "m/s", "z": "m", "u": "N", "y": "m", "w": "m/s"},
    "columns": {"t": "time_s", "u": "motor force (N)"},
}
SMALL: dict[str, Any] = {
    "model": {"states": ["x"], "outputs": ["y"]},
    "equations": {"x": "-x"},
    "readings": {"y": "x"},
}
JOINTS: dict[str, Any] = {
    "model": {"states": ["q1", "q2", "w1", "w2"], "inputs": ["u1"], "outputs": ["y1", "y2"]},
    "definitions": {"c2": "cos(q2)", "m12": "h*c2 + j"},
    "equations": {"q1": "w1", "q2": "w2", "w1": "u1 + h*sin(q2)*w2**2", "w2": "-Fv*w2"},
    "inertia": {"w1": {"w1": "3*j + 2*h*c2", "w2": "m12"}, "w2": {"w1": "m12", "w2": "j"}},
    "readings": {"y1": "q1", "y2": "Piecewise((q2, q2 > 0), (-q2, True))"},
    "parameters": {"h": 1.0, "j": {"value": 2.0, "bounds": [1, 3]}, "Fv": 0.5},
}
VALID = (EVERYTHING, SMALL, JOINTS)


def toml(document: Any) -> str:
    """Return any document as TOML text, tables inline but for the top level."""
    if not isinstance(document, dict):
        return f"x = {_value(document)}\n"
    plain = [f"{_key(k)} = {_value(v)}" for k, v in document.items() if not isinstance(v, dict)]
    tables = [
        "\n".join([f"[{_key(k)}]", *(f"{_key(i)} = {_value(j)}" for i, j in v.items())])
        for k, v in document.items()
        if isinstance(v, dict)
    ]
    return "\n".join([*plain, *tables]) + "\n"


def _key(key: str) -> str:
    return _text(key)


def _text(text: str) -> str:
    escaped = (f"\\u{ord(c):04x}" if ord(c) < 32 or c in '"\\\x7f' else c for c in text)
    return f'"{"".join(escaped)}"'


def _value(value: Any) -> str:
    match value:
        case Raw():
            return value.text
        case bool():
            return str(value).lower()
        case str():
            return _text(value)
        case dict():
            return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + "}"
        case list():
            return "[" + ", ".join(map(_value, value)) + "]"
    return repr(value)


def _places(node: Any, path: tuple = ()) -> Iterator[tuple]:
    """Yield the path of everything in a document, containers too."""
    if path:
        yield path
    pairs = node.items() if isinstance(node, dict) else ()
    pairs = enumerate(node) if isinstance(node, list) else pairs
    for key, value in pairs:
        yield from _places(value, (*path, key))


def _draw(rng: np.random.Generator, values: Any) -> Any:
    return copy.deepcopy(values[int(rng.integers(len(values)))])


def _hostile_value(rng: np.random.Generator, old: Any) -> Any:
    if isinstance(old, str) and rng.random() < 0.6:
        return _draw(rng, UNITS if rng.random() < 0.4 else EXPRESSIONS)
    if isinstance(old, int | float) and rng.random() < 0.6:
        return _draw(rng, NUMBERS)
    return _draw(rng, _draw(rng, (EXPRESSIONS, UNITS, NUMBERS, OTHERS, RAW)))


def _mutated(rng: np.random.Generator, document: dict[str, Any]) -> dict[str, Any]:
    """Return a document with one value, key or table changed."""
    document = copy.deepcopy(document)
    path = _draw(rng, list(_places(document)))
    holder: Any = document
    for key in path[:-1]:
        holder = holder[key]
    last, kind = path[-1], rng.random()
    if kind < 0.6:
        holder[last] = _hostile_value(rng, holder[last])
    elif kind < 0.7:
        del holder[last]
    elif kind < 0.85 and isinstance(holder, dict):
        holder[_draw(rng, KEYS)] = holder.pop(last)
    elif isinstance(holder, dict):
        holder[_draw(rng, KEYS)] = _hostile_value(rng, holder[last])
    else:
        holder.append(_hostile_value(rng, holder[last]))
    return document


def _damaged(rng: np.random.Generator, text: str) -> str:
    """Return text with some characters deleted, doubled, swapped or strange."""
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(len(text) + 1))
        match int(rng.integers(5)):
            case 0:
                text = text[:at] + text[at + int(rng.integers(1, 20)) :]
            case 1:
                text = (
                    text[:at]
                    + _draw(rng, list("[]{}\"'=.,#\n\r\t\0\x7f*^()-_0é🙂\ufeff"))
                    + text[at:]
                )
            case 2:
                piece = text[at : at + int(rng.integers(1, 60))]
                text = text[:at] + piece * int(rng.integers(2, 5)) + text[at:]
            case 3:
                text = text[:at]
            case 4:
                lines = text.split("\n")
                rng.shuffle(lines)
                text = "\n".join(lines)
    return text


def _doubling(rng: np.random.Generator) -> str:
    """Return definitions whose written-out form has more symbols than there are atoms."""
    document = copy.deepcopy(SMALL)
    count = int(rng.integers(20, 400))
    form = _draw(
        rng, ["{0} + {0}", "{0}*{0}", "sin({0})", "Max({0}, {0})", "{0}**{0}", "{0}/{0} + x"]
    )
    for name in ("a", "b"):  # twins, equal node by node and not the same objects
        document["definitions"] = document.get("definitions", {})
        document["definitions"] |= {f"{name}0": "x"}
        for k in range(1, count):
            document["definitions"][f"{name}{k}"] = form.format(f"{name}{k - 1}")
    document["equations"]["x"] = f"a{count - 1} - b{count - 1}"
    if rng.random() < 0.5:
        document["units"] = {"x": "m", "t": "s", "y": "kg"}
    return toml(document)


def _many(rng: np.random.Generator) -> str:
    """Return a model of many names, or of one very long one."""
    document, count = copy.deepcopy(SMALL), int(rng.integers(1, 3_000))
    match int(rng.integers(5)):
        case 0:
            document["parameters"] = {f"p{k}": {"value": 1, "bounds": [0, 2]} for k in range(count)}
        case 1:
            names = [f"x{k}" for k in range(count)]
            document["model"]["states"] = names
            document["equations"] = {n: f"-{n}" for n in names}
            document["readings"]["y"] = "x0"
        case 2:
            document["definitions"] = {f"d{k}": f"x + {k}" for k in range(count)}
        case 3:
            document["events"] = [{"when": "x", "reset": {"x": "-x"}}] * count
        case 4:
            names = [f"w{k}" for k in range(count % 25 + 1)]
            document["model"]["states"] = names
            document["equations"] = dict.fromkeys(names, "1")
            document["readings"]["y"] = "w0"
            document["inertia"] = {n: {m: "cos(w0)" for m in names} for n in names}
    return toml(document)


def _deep(rng: np.random.Generator) -> str:
    depth = int(rng.integers(20, 20_000))
    heads = (
        *("x = " + "[" * depth, "x = " + "{a=" * depth, "a" + ".a" * depth + " = 1", "[" * depth),
        *(
            "[" + "a." * depth + "a]",
            "[[" + "a." * depth + "b]]",
            "x = { a" + ".a" * depth + " = 1 }",
        ),
        *('"."' + '.".."' * depth + " = 1", '"""' * depth, "'" * depth, "#" * depth),
    )
    head = _draw(rng, heads)
    return head + "\n" + toml(SMALL)


def _changed(rng: np.random.Generator) -> str:
    document = _draw(rng, VALID)
    for _ in range(int(rng.integers(1, 4))):
        document = _mutated(rng, document)
    return toml(document)


def _noise(rng: np.random.Generator) -> str:
    return bytes(rng.integers(0, 256, int(rng.integers(0, 400)), dtype=np.uint8)).decode("latin-1")


KINDS: tuple[tuple[float, Callable[[np.random.Generator], str]], ...] = (
    (0.62, _changed),
    (0.25, lambda rng: _damaged(rng, toml(_draw(rng, VALID)))),
    (0.03, _doubling),
    (0.03, _many),
    (0.04, _deep),
    (0.03, _noise),
)


def hostile(seed: int) -> str:
    """Return the hostile model file of a seed."""
    rng = np.random.default_rng(seed)
    shares = np.array([share for share, _ in KINDS])
    return KINDS[int(rng.choice(len(KINDS), p=shares / shares.sum()))][1](rng)


def wrong_types() -> Iterator[tuple[tuple, str]]:
    """Yield every place of a model of every table with a value of every other type."""
    values = (5, 0.5, True, "", "text", [], ["a", 1], {}, {"a": 1}, float("nan"), 10**400)
    for path in _places(EVERYTHING):
        for value in values:
            document = copy.deepcopy(EVERYTHING)
            holder: Any = document
            for key in path[:-1]:
                holder = holder[key]
            holder[path[-1]] = value
            yield path, toml(document)


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Fail what takes more processor time, and end what would never end."""

    def end(*_: Any) -> None:
        raise TimeoutError(f"no end after {5 * seconds} s")

    old = signal.signal(signal.SIGVTALRM, end)
    signal.setitimer(signal.ITIMER_VIRTUAL, 5 * seconds)
    began = time.process_time()
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, old)
    assert time.process_time() - began < seconds


def outcome(text: str) -> str:
    """Read a file and demand what every file must give; return the error's message."""
    from jaxsr._result import InputError
    from jaxsr.models import model_text, parse_model

    with at_most(SECONDS):
        try:
            model = parse_model(text, "m.toml")
        except InputError as error:
            message = str(error)
            assert message.startswith("m.toml") and message.isprintable(), message
            assert len(message) < 500 and LONG[:81] not in message, message
            assert error.what
            return message
    assert parse_model(model_text(model), "m.toml") == model
    return ""


def main(first: int, last: int) -> None:
    """Read the files of these seeds and report."""
    import jaxsr.models  # noqa: F401  (what loads it is not the first file's time)

    worst = 0.0
    for seed in range(first, last):
        began = time.process_time()
        try:
            outcome(hostile(seed))
        except Exception as error:
            wrong = f"{type(error).__name__}: {str(error)[:200]}"
            print(json.dumps({"case": seed, "wrong": wrong}), flush=True)
        worst = max(worst, time.process_time() - began)
    print(json.dumps({"seconds": worst, "megabytes": most_memory()}))


def most_memory() -> float:
    """Most memory that this process held, in MB.

    On Linux `getrusage` counts what the process that started it held as well.
    """
    status = Path("/proc/self/status")
    if status.exists():
        most = next(x for x in status.read_text().splitlines() if x.startswith("VmHWM"))
        return float(most.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
