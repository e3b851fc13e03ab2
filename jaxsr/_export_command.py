"""The command ``jaxsr export``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from jaxsr._job import RUN
from jaxsr._output import print_line
from jaxsr._result import InputError


def export(
    result: Annotated[
        str, typer.Argument(metavar="RESULT", help="A folder of results, or a model file.")
    ],
    to: Annotated[
        str,
        typer.Option(
            metavar="LANGUAGE", help="c, matlab, modelica, numpy, jax, sympy, latex, fmu."
        ),
    ],
    out: Annotated[
        str | None, typer.Option(metavar="FILE", help="File to write; standard output by default.")
    ] = None,
    name: Annotated[
        str | None, typer.Option(metavar="NAME", help="Of the function or class.")
    ] = None,
) -> Callable[[str], None]:
    """Write the model that was explained or discovered in another language."""
    if out is not None and Path(out).resolve() == Path(result).resolve():
        raise InputError("would overwrite an input", f"--out {out}", "Name another file")
    if out is not None and Path(out).is_dir():
        raise InputError("is a directory", f"--out {out}", "Name a file")
    if to == "fmu" and out is None:
        raise InputError("an FMU is no text", "--to fmu", "Name its file with --out")

    def job(command: str) -> None:
        from jaxsr._files import atomic_write_text, check_writable

        if out is not None:
            check_writable(Path(out))
        from jaxsr.models.exports import export_fmu, export_text

        if out is None:
            print_line(export_text(_model(result), to, name).removesuffix("\n"))
            return
        model = _model(result)
        fmu = to == "fmu"
        content = export_fmu(model, name) if fmu else export_text(model, to, name)
        atomic_write_text(Path(out), content)
        RUN.get().outcome = f"{out} is whole"
        print_line(f"{to} in {out}")

    return job


def _model(result: str) -> Any:
    """Return the model of a folder of results, or of a model file."""
    import jaxsr

    if Path(result).is_dir():
        return jaxsr.load(result).model
    return jaxsr.Simulator.from_file(result).model
