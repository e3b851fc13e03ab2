"""No regular expression that reads formulas, recordings or models takes the square of a length."""

import importlib
import pkgutil
import re
import time
from collections.abc import Iterator

import jaxsr

LENGTH = 20_000
PIECES = "0 a _ , . - + * / ( [ 1, 0. a. 1e a_ (a [a a( /1 é".split()
BLANKS = (" ", "\t", "1 ", "( ", "a ")
BEGINNINGS = ("", "a", "1", "[", "(")
SECONDS = 0.2
"""A thousand times what one pass over such a text takes; its square takes 5 s and more."""


def _patterns() -> Iterator[tuple[str, re.Pattern]]:
    for package in ("expressions", "recordings", "models.formats"):
        path = [f"{jaxsr.__path__[0]}/{package.replace('.', '/')}"]
        for module in pkgutil.iter_modules(path):
            name = f"jaxsr.{package}.{module.name}"
            for key, value in vars(importlib.import_module(name)).items():
                for one in value if isinstance(value, tuple) else (value,):
                    if isinstance(one, re.Pattern):
                        yield f"{name}.{key}", one


def test_a_long_cell_or_name_is_matched_in_one_pass():
    slow, patterns = [], list(_patterns())
    assert len(patterns) > 10
    for name, pattern in patterns:
        for piece in (*PIECES, *BLANKS):
            for begin in BEGINNINGS:
                text = begin + (piece * LENGTH)[:LENGTH] + "!"
                if isinstance(pattern.pattern, bytes):
                    text = text.encode()
                started = time.process_time()
                pattern.fullmatch(text)
                if time.process_time() - started > SECONDS:
                    slow.append((name, begin, piece))
    assert slow == []
