"""The text of a model in another language."""

from __future__ import annotations

import re
from collections.abc import Callable

from jaxsr._result import InputError
from jaxsr.models.exports.system import System, system_of
from jaxsr.models.model import Model

ENDINGS = {
    "c": ".c",
    "matlab": ".m",
    "modelica": ".mo",
    "numpy": ".py",
    "jax": ".py",
    "sympy": ".py",
    "latex": ".tex",
}
"""Languages, and how the names of their files end."""


def export_text(model: Model, to: str, name: str | None = None) -> str:
    """Return a model in another language.

    Parameters
    ----------
    model : Model
    to : str
        One of `ENDINGS`.
    name : str, optional
        Of the function, class or file; from the model's name by default.

    Raises
    ------
    InputError
        The language is none of these, a formula is missing, or the name is no identifier.
    """
    if to not in ENDINGS:
        remedy = f"Use one of {', '.join(ENDINGS)} or fmu"
        raise InputError(f"cannot export to {to!r:.80}", "", remedy)
    return _writer(to)(system_of(model), _named(model, name))


def export_fmu(model: Model, name: str | None = None) -> bytes:
    """Return a model as the file of an FMU.

    Raises
    ------
    InputError
        pythonfmu is missing, a formula is, or the name is no identifier.
    """
    from jaxsr.models.exports.fmu import fmu_bytes

    return fmu_bytes(system_of(model), _named(model, name))


def _named(model: Model, name: str | None) -> str:
    name = identifier(model.name) if name is None else name
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
        raise InputError(f"{name!r:.80} cannot name a function", "", "Use letters, digits and _")
    return name


def _writer(to: str) -> Callable[[System, str], str]:
    """Return what writes a language; SymPy's printers are loaded by now."""
    from jaxsr.models.exports.c import c_text
    from jaxsr.models.exports.latex import latex_text
    from jaxsr.models.exports.matlab import matlab_text
    from jaxsr.models.exports.modelica import modelica_text
    from jaxsr.models.exports.python import jax_text, numpy_text, sympy_text

    writers: dict[str, Callable[[System, str], str]] = {
        "c": c_text,
        "matlab": matlab_text,
        "modelica": modelica_text,
        "numpy": numpy_text,
        "jax": jax_text,
        "sympy": sympy_text,
        "latex": latex_text,
    }
    return writers[to]


def identifier(text: str) -> str:
    """Return a model's name as an identifier: ``EMPS prismatic drive`` as EMPS_prismatic_drive."""
    words = re.findall(r"[A-Za-z0-9]+", text.removesuffix(".toml"))
    name = "_".join(words)[:60]
    return name if name[:1].isalpha() else f"model_{name}".rstrip("_")
