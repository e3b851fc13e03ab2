"""The house of the package: imports run one way, modules stay small."""

from __future__ import annotations

import ast
import json
import statistics
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "jaxsr"

LAYERS = {
    "_result": 0,
    "_types": 0,
    "_versions": 0,
    "_process": 0,
    "_output": 0,
    "_staging": 0,
    "_clock": 0,
    "_cores": 0,
    "_deadline": 0,
    "_machine_code": 0,
    "_files": 0,
    "_progress": 0,
    "_interval": 0,
    "_quoting": 0,
    "_arguments": 0,
    "_options": 0,
    "_resume": 0,
    "_discover_options": 0,
    "_bar": 0,
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
    "monitoring": 9,
    "_datasets_app": 9,
    "_batch_command": 9,
    "_discover_command": 9,
    "_diagnose_command": 9,
    "_simulate_command": 9,
    "_demo_command": 9,
    "_export_command": 9,
    "_monitor_command": 10,
    "cli": 8,
    "__main__": 8,
    "__init__": 9,
}
LONGEST = 400
"""Lines of a module, of benchmarks and tests too."""
MEDIAN = 150
"""Lines of half of the package's modules."""
ARGUMENTS = 10
"""Of a function, `self` apart."""

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


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imported(path: Path) -> frozenset[str]:
    """Return the full names that a module imports."""
    return frozenset(imports(parsed(path), path))


def imported_parts(path: Path) -> set[str]:
    """Return the parts of the house that a module imports, its own aside."""
    names = imported(path)
    found = {name.split(".")[1] for name in names if name.startswith("jaxsr.")}
    # `from jaxsr import X` is a re-export: its home counts as the front door.
    return {name if name in LAYERS else "__init__" for name in found} - {part(path)}


def relative(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


def test_every_part_has_a_layer() -> None:
    assert {part(path) for path in MODULES} <= set(LAYERS)
    for path in MODULES:
        assert (path.parent / "__init__.py").is_file(), f"{relative(path)} is in no package"


def upward(path: Path) -> set[str]:
    """Return the parts that a module imports though they stand no lower than its own."""
    # The front door re-exports names from any layer.
    if part(path) in ("__init__", "__main__", "cli"):
        return set()
    found = {name for name in imported_parts(path) if LAYERS[name] >= LAYERS[part(path)]}
    return {name for name in found if LAYERS[name] > 0} if LAYERS[part(path)] == 0 else found


def test_imports_run_downward() -> None:
    assert {relative(path): found for path in MODULES if (found := upward(path))} == {}


def test_trees_are_python_and_arrays_know_no_trees() -> None:
    arrays = {"jax", "jaxlib", "equinox", "optax", "diffrax"}
    wrong = []
    for path in MODULES:
        roots = {name.split(".")[0] for name in imported(path)}
        trees = any(name.startswith("jaxsr.evolution") for name in imported(path))
        if part(path) == "evolution" and roots & arrays:
            wrong.append(relative(path))
        if part(path) in ("evaluation", "regression") and trees:
            wrong.append(relative(path))
    assert not wrong


def lines(path: Path) -> int:
    return path.read_text(encoding="utf-8").count("\n")


def test_modules_stay_small() -> None:
    files = [p for part in ("jaxsr", "benchmarks", "tests") for p in (ROOT / part).rglob("*.py")]
    long = {str(p.relative_to(ROOT)): lines(p) for p in files if lines(p) > LONGEST}
    assert long == {}
    assert statistics.median(map(lines, MODULES)) <= MEDIAN


def arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return how many arguments a function takes, `self` and `cls` apart."""
    own = function.args
    names = [a.arg for a in (*own.posonlyargs, *own.args, *own.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def crowded(tree: ast.Module) -> Iterator[str]:
    """Yield the functions of a module that take too many arguments."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and arguments(node) > ARGUMENTS:
            yield node.name


def test_functions_take_few_arguments() -> None:
    files = [p for part in ("jaxsr", "benchmarks") for p in (ROOT / part).rglob("*.py")]
    found = {
        f"{path.relative_to(ROOT).as_posix()} {name}"
        for path in files
        for name in crowded(parsed(path))
    }
    assert not found


def test_arguments_are_counted_by_name_position_and_without_self() -> None:
    ten = ", ".join("abcdefghij")
    code = f"class A:\n def f(self, {ten}): ...\n async def g(self, x, /, {ten[:-6]}, *, y, z): ..."
    assert list(crowded(ast.parse(code))) == ["g"]
    two = f"def h({ten}): ...\ndef i({ten}, *, k=0): ..."
    assert list(crowded(ast.parse(two))) == ["i"]


IN_ORDER = (
    *("expressions", "recordings", "evaluation", "views", "regression", "evolution", "models"),
    *("report", "discovery"),
)
"""Packages by rising layer."""
LOADED = """
import importlib, json, sys
found = {}
for name in sys.argv[1:]:
    importlib.import_module("jaxsr." + name)
    found[name] = sorted(m for m in sys.modules if m.startswith("jaxsr."))
print(json.dumps(found))
"""


def test_no_package_loads_one_that_stands_higher() -> None:
    """What is loaded, by names that no text of the package shows too, is of no higher layer."""
    assert [LAYERS[name] for name in IN_ORDER] == sorted(LAYERS[name] for name in IN_ORDER)
    command = [sys.executable, "-c", LOADED, *IN_ORDER]
    found = json.loads(subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout)
    higher = {
        name: [m for m in loaded if LAYERS[m.split(".")[1]] > LAYERS[name]]
        for name, loaded in found.items()
    }
    assert all(f"jaxsr.{name}" in found[name] for name in IN_ORDER)
    assert {name: found for name, found in higher.items() if found} == {}


OWN_TEMPORARIES = {
    "_staging.py",
    "_output.py",  # results that their folder did not take: they are to stay
    "models/native/process.py",  # removed by the process that works in it, when this one is gone
    "models/exports/fmu.py",  # asks for the place alone
    "models/formats/write_back.py",  # asks for the place alone
    "batch/task.py",  # without a name
}


def test_unfinished_files_are_those_that_a_next_run_sweeps() -> None:
    """What is made besides stays for ever after a kill, and after Ctrl-C, which ends at once."""
    found = {
        relative(path)
        for path in MODULES
        if any(name.split(".")[0] == "tempfile" for name in imported(path))
    }
    assert found == OWN_TEMPORARIES


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
    "weak",
    "setup",
    "thinning",
    "failures",
    "compared",
    "rectified",
    "shooting",
    "case",
    "likelihood",
    "input_noise",
    "unsigned",
    "verdict",
    "judging",
    "decision",
    "calibrating",
    "laws",
    "explanations",
    "free_runs",
    "settled",
    "hurried",
    "finding",
    "answer",
    "result",
    "explaining",
    "diagnose",
    "learned",
    "__init__",
)
"""The rooms of the diagnosis, each of which imports from those before it alone."""


def later_rooms(path: Path) -> set[str]:
    """Return the rooms that a module of the diagnosis imports though they come no earlier."""
    room = path.relative_to(PACKAGE / "diagnosis").with_suffix("").parts[0]
    seen = {n.split(".")[2] for n in imported(path) if n.startswith("jaxsr.diagnosis.")} - {room}
    return {name for name in seen if DIAGNOSIS.index(name) >= DIAGNOSIS.index(room)}


def test_rooms_of_the_diagnosis_import_from_those_before() -> None:
    rooms = [path for path in MODULES if part(path) == "diagnosis"]
    assert {relative(path): found for path in rooms if (found := later_rooms(path))} == {}
