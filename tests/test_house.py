"""The house of the package: imports run one way, modules stay small."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "jaxsr"

LAYERS = {
    "_result": 0,
    "_types": 0,
    "_process": 0,
    "_output": 0,
    "_staging": 0,
    "_clock": 0,
    "_deadline": 0,
    "_files": 0,
    "_progress": 0,
    "_interval": 0,
    "_quoting": 0,
    "_arguments": 0,
    "expressions": 1,
    "recordings": 1,
    "evaluation": 2,
    "views": 2,
    "regression": 3,
    "evolution": 4,
    "models": 4,
    # Reports are drawn from plain values, so that a diagnosis or a discovery can save its own.
    "report": 5,
    "discovery": 6,
    "diagnosis": 7,
    "datasets": 8,
    "_job": 8,
    "_saved": 8,
    "batch": 9,
    "_datasets_app": 9,
    "_batch_command": 9,
    "_export_command": 9,
    "cli": 8,
    "__main__": 9,
    "__init__": 9,
}
LONGEST = 400

MODULES = sorted(PACKAGE.rglob("*.py"))


def part(path: Path) -> str:
    """Return the name in `LAYERS` of a file's module or package."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(tree: ast.Module, path: Path) -> Iterator[str]:
    """Yield the full names that a module imports, inside functions too."""
    package = ("jaxsr", *path.relative_to(PACKAGE).parent.parts)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            home = ".".join((*base, node.module or "")).strip(".")
            yield from (f"{home}.{alias.name}" for alias in node.names)


def imported_parts(path: Path) -> set[str]:
    """Return the parts of the house that a module imports, its own aside."""
    names = imports(ast.parse(path.read_text(encoding="utf-8")), path)
    found = {name.split(".")[1] for name in names if name.startswith("jaxsr.")}
    # `from jaxsr import X` is a re-export: its home counts as the front door.
    return {name if name in LAYERS else "__init__" for name in found} - {part(path)}


def relative(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


def test_every_part_has_a_layer() -> None:
    assert {part(path) for path in MODULES} <= set(LAYERS)
    for path in MODULES:
        assert (path.parent / "__init__.py").is_file(), f"{relative(path)} is in no package"


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_imports_run_downward(path: Path) -> None:
    # The front door re-exports names from any layer.
    if part(path) in ("__init__", "__main__", "cli"):
        return
    upward = {name for name in imported_parts(path) if LAYERS[name] >= LAYERS[part(path)]}
    if LAYERS[part(path)] == 0:
        upward -= {name for name in upward if LAYERS[name] == 0}
    assert not upward, f"{relative(path)} imports {sorted(upward)}, which stand no lower"


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_trees_are_python_and_arrays_know_no_trees(path: Path) -> None:
    names = set(imports(ast.parse(path.read_text(encoding="utf-8")), path))
    roots = {name.split(".")[0] for name in names}
    if part(path) == "evolution":
        assert not roots & {"jax", "jaxlib", "equinox", "optax", "diffrax"}
    if part(path) in ("evaluation", "regression"):
        assert not any(name.startswith("jaxsr.evolution") for name in names)


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_modules_stay_small(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST


def test_the_walk_sees_every_form_of_import() -> None:
    code = (
        "import jax.numpy as jnp\nfrom jaxsr.models import Simulator\nfrom ..views import weak\n"
        "def f():\n    from . import sibling\n    from jaxsr import diagnose\n"
    )
    seen = set(imports(ast.parse(code), PACKAGE / "evolution" / "loop.py"))
    assert seen == {
        "jax.numpy",
        "jaxsr.models.Simulator",
        "jaxsr.views.weak",
        "jaxsr.evolution.sibling",
        "jaxsr.diagnose",
    }


DIAGNOSIS = (
    "open_mass",
    "mechanisms",
    "screening",
    "setup",
    "thinning",
    "failures",
    "compared",
    "case",
    "contest",
    "likelihood",
    "input_noise",
    "judging",
    "locating",
    "search",
    "laws",
    "comparison",
    "settled",
    "finding",
    "answer",
    "result",
    "explaining",
    "diagnose",
    "learned",
    "__init__",
)
"""The rooms of the diagnosis, each of which imports from those before it alone."""


@pytest.mark.parametrize(
    "path", [p for p in MODULES if part(p) == "diagnosis"], ids=lambda p: relative(p)
)
def test_rooms_of_the_diagnosis_import_from_those_before(path: Path) -> None:
    room = path.relative_to(PACKAGE / "diagnosis").with_suffix("").parts[0]
    names = imports(ast.parse(path.read_text(encoding="utf-8")), path)
    seen = {n.split(".")[2] for n in names if n.startswith("jaxsr.diagnosis.")} - {room}
    later = {name for name in seen if DIAGNOSIS.index(name) >= DIAGNOSIS.index(room)}
    assert not later, f"{relative(path)} imports {sorted(later)}, which stand no lower"
