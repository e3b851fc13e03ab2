"""Python simulators: a JAX vector field beside a TOML of its states, inputs and parameters.

``m.py`` holds ``f(t, x, u, p) -> dx``, ``m.toml`` the table, with ``[model] base = "m.py:f"``. What
a diagnosis adds stands there as well: in [additions], beside the rates that f returns, and in
[equations], for states that f knows nothing of. So ``jaxsr simulate m.py:f data.csv --model
explained.toml`` runs the explained model.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxsr._result import InputError
from jaxsr.models.model import Model
from jaxsr.models.reading import read_model
from jaxsr.models.simulator import Simulator
from jaxsr.models.vector_field import vector_field


def read_python_simulator(text: str, table: str | Path | None = None) -> Simulator:
    """Load ``path/file.py:function`` with its table, ``path/file.toml`` unless one is given.

    Parameters
    ----------
    text : str
    table : path, optional
        A model file that stands on this function, such as an explained.toml.

    Raises
    ------
    InputError
        The file, its table or the function is missing, the file cannot be run, or the function
        is no vector field of the table's states.
    """
    path_text, _, name = text.rpartition(":")
    if not path_text or not name.isidentifier():
        raise InputError(f"{text!r} names no function", remedy="Write path/file.py:function")
    path = Path(path_text)
    if not path.is_file():
        raise InputError("no such Python file", str(path), "Check the path")
    table = path.with_suffix(".toml") if table is None else Path(table)
    if not table.is_file():
        raise InputError("no table of states and parameters", str(table), "Write it")
    model = read_model(table)
    if model.base != f"{path.name}:{name}":
        raise InputError(
            f"base is {model.base!r}", f"{table} [model]", f'Write base = "{path.name}:{name}"'
        )
    return with_function(model, _loaded(path, name), f"{path.name}:{name}")


def with_function(model: Model, function: Callable[..., Any], where: str = "") -> Simulator:
    """Return the simulator of a model whose rates a function ``f(t, x, u, p) -> dx`` gives.

    Raises
    ------
    InputError
        The function is no vector field of the model's states, see `vector_field`.
    """
    where = where or getattr(function, "__name__", "function")
    base = model.base or where
    return Simulator(replace(model, base=base, vector_field=vector_field(function, model, where)))


def _loaded(path: Path, name: str) -> Callable[..., Any]:
    """Run a Python file, and return one of its functions."""
    spec = importlib.util.spec_from_file_location(f"jaxsr_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError("cannot be loaded as Python", str(path))
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())[:120]
        raise InputError(f"fails on import: {what}", str(path)) from None
    function = getattr(module, name, None)
    if not callable(function):
        raise InputError(f"has no function {name!r}", str(path), "Check the name after the colon")
    return function
