"""No ring of imports anywhere in the package, not even for type checkers or inside functions."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Set
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).resolve().parents[1]

_READS = "Simulator.from_file reads every format by a module that makes a Simulator"
KNOWN = {
    ("jaxsr.models.simulator", "jaxsr.models.python_base"): _READS,
    ("jaxsr.models.simulator", "jaxsr.models.formats.step_map"): _READS,
    ("jaxsr.models.simulator", "jaxsr.models.formats.fmu"): _READS,
    ("jaxsr.models.simulator", "jaxsr.models.formats.opening"): _READS,
    ("jaxsr.models.simulator", "jaxsr.models.simulation"): (
        "Simulator.simulate runs by what estimates a Simulator's starts"
    ),
}
"""Imports (where, what) that close a ring, each with the reason why it stays."""


def module_files() -> dict[str, Path]:
    """Return the file of every module, by its full name."""
    found = {}
    for path in sorted((ROOT / "jaxsr").rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(code: str, package: tuple[str, ...], modules: frozenset[str]) -> Iterator[str]:
    """Yield the modules that a module names in any import, wherever it stands."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            yield from modules.intersection(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            home = ".".join((*base, *filter(None, [node.module])))
            for alias in node.names:
                yield from modules.intersection([f"{home}.{alias.name}"]) or modules.intersection(
                    [home]
                )


def graph(files: Mapping[str, Path]) -> set[tuple[str, str]]:
    """Return the pairs of modules of which the first imports from the second."""
    return {
        (name, other)
        for name, path in files.items()
        for other in imported(
            path.read_text(encoding="utf-8"),
            path.relative_to(ROOT).parent.parts,
            frozenset(files),
        )
        if other != name
    }


def rings(edges: Set[tuple[str, str]]) -> list[set[str]]:
    """Return the groups of modules that import each other, directly or by way of others."""
    names = sorted({name for edge in edges for name in edge})
    number = {name: k for k, name in enumerate(names)}
    rows, columns = np.array([[number[a], number[b]] for a, b in sorted(edges)]).T
    links = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(names),) * 2)
    count, group = connected_components(links, connection="strong")
    groups = [{names[k] for k in np.flatnonzero(group == g)} for g in range(count)]
    return [ring for ring in groups if len(ring) > 1]


@pytest.fixture(scope="module")
def edges() -> set[tuple[str, str]]:
    return graph(module_files())


@pytest.mark.long
def test_no_ring_but_the_known_ones(edges: set[tuple[str, str]]) -> None:
    assert [sorted(ring) for ring in rings(edges - KNOWN.keys())] == []


def test_every_known_import_still_closes_a_ring(edges: set[tuple[str, str]]) -> None:
    """So that the list never excuses more than there is."""
    without = edges - KNOWN.keys()
    assert KNOWN.keys() <= edges
    assert [edge for edge in KNOWN if not rings(without | {edge})] == []


def test_the_graph_sees_every_form_of_import() -> None:
    modules = frozenset({"p", "p.a", "p.b", "p.s", "p.s.c", "p.s.d", "p.e"})
    code = (
        "from typing import TYPE_CHECKING\nimport p.a\nfrom p.b import Thing\n"
        "if TYPE_CHECKING:\n    from . import d\n"
        "def f():\n    from ..e import g\n    from p import a, name\n    from p.s import x\n"
    )
    seen = set(imported(code, ("p", "s"), modules))
    assert seen == {"p.a", "p.b", "p.s.d", "p.e", "p", "p.s"}


def test_rings_are_found_through_others() -> None:
    edges = {("a", "b"), ("b", "c"), ("c", "a"), ("c", "d"), ("e", "a")}
    assert rings(edges) == [{"a", "b", "c"}]
    assert rings(edges - {("c", "a")}) == []
