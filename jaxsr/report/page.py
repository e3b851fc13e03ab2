"""Write a page: templates, figures inside, everything on disk only when all of it is ready."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from jaxsr._files import atomic_write_text
from jaxsr.report.formatting import (
    DASH,
    is_number,
    number,
    odds,
    percent,
    seconds,
    sureness,
    unit_text,
)
from jaxsr.report.mathml import equation, expression
from jaxsr.report.style import Drawing


def write_page(
    directory: Path, template: str, context: dict[str, Any], drawings: Sequence[Drawing]
) -> None:
    """Render `template` to ``report.html`` in `directory`, with the figures beside it.

    Parameters
    ----------
    directory : Path
        Made when absent.
    template : str
        Name of a template of this package.
    context : dict
        What the template reads.
    drawings : sequence of Drawing
        Every figure of the page, to be written as PNG.

    Raises
    ------
    InputError
        If `directory` cannot be written.
    """
    html = rendered(template, context)
    directory.mkdir(parents=True, exist_ok=True)
    for drawing in drawings:
        partial = directory / f".{drawing.name}.partial"
        partial.write_bytes(drawing.png)
        os.replace(partial, directory / drawing.name)
    atomic_write_text(directory / "report.html", html)


def rendered(template: str, context: dict[str, Any]) -> str:
    """Return what a template of this package makes of a context."""
    return _environment().get_template(template).render(context)


def told(rows: Iterable[Mapping[str, Any]], key: str) -> bool:
    """Whether any row has something in a column: a dash is nothing."""
    return any(row.get(key) not in (None, "", DASH) for row in rows)


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("jaxsr.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        number=number,
        percent=percent,
        odds=odds,
        sureness=sureness,
        seconds=seconds,
        unit=unit_text,
        math=expression,
        picture=_picture,
    )
    environment.globals.update(equation=equation, is_number=is_number, told=told)
    return environment


def _picture(drawing: Drawing) -> Markup:
    """Return a figure as an image that carries its bytes."""
    source = base64.b64encode(drawing.png).decode("ascii")
    return Markup('<img src="data:image/png;base64,{}" alt="{}">').format(
        Markup(source), f"{drawing.caption}. {drawing.note}".strip()
    )
