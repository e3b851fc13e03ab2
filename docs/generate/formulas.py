"""Formulas of pages as MathML when the site is built, so that they show without a network.

A hook of MkDocs: named in ``mkdocs.yml`` under ``hooks``.
"""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

_FORMULA = re.compile(
    r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL
)
_ROLE = re.compile(r":math:<code>(.*?)</code>", re.DOTALL)
_DIRECTIVE = re.compile(r"<p>\.\. math::\s*(.*?)</p>", re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """Return a page with its formulas in MathML, those of docstrings included."""
    content = _FORMULA.sub(lambda m: _mathml(m[2] or m[3], m[2] is None), content)
    content = _ROLE.sub(lambda m: _mathml(m[1], False), content)
    return _DIRECTIVE.sub(lambda m: _mathml(m[1], True), content)


def _mathml(latex: str, block: bool) -> str:
    text = convert(html.unescape(latex).strip(), display="block" if block else "inline")
    return f"<p>{text}</p>" if block else text
