"""Python simulators: a JAX vector field beside a TOML of its states, inputs and parameters."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from jaxsr._result import InputError
from jaxsr.models.reading import read_model
from jaxsr.models.simulator import Simulator


def read_python_simulator(text: str) -> Simulator:
    """Load ``path/file.py:function`` with its table in ``path/file.toml``.

    Raises
    ------
    InputError
        The file, its table or the function is missing, or the file cannot be run.
    """
    path_text, _, name = text.rpartition(":")
    if not path_text or not name.isidentifier():
        raise InputError(f"{text!r} names no function", remedy="Write path/file.py:function")
    path = Path(path_text)
    if not path.is_file():
        raise InputError("no such Python file", str(path), "Check the path")
    table = path.with_suffix(".toml")
    if not table.is_file():
        raise InputError("no table of states and parameters", str(table), "Write it")
    model = read_model(table)
    if model.base != f"{path.name}:{name}":
        raise InputError(
            f"base is {model.base!r}", f"{table} [model]", f'Write base = "{path.name}:{name}"'
        )
    spec = importlib.util.spec_from_file_location(f"jaxsr_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError("cannot be loaded as Python", str(path))
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"fails on import: {type(error).__name__}: {error}", str(path)) from error
    function = getattr(module, name, None)
    if not callable(function):
        raise InputError(f"has no function {name!r}", str(path))
    return Simulator(model, function)
