"""The notebooks hold the outputs of one run without errors, and run again from a clean start."""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
PAPER = NOTEBOOKS / "paper_cases.ipynb"
EVERY = sorted(NOTEBOOKS.glob("*.ipynb"))
BUDGET = "JAXSR_NOTEBOOK_BUDGET"


def _read(path: Path):
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    return nbformat.read(path, as_version=4)


def _code(path: Path) -> list:
    return [cell for cell in _read(path).cells if cell.cell_type == "code"]


def _prints(cell) -> bool:
    """Whether a cell prints or draws when it runs, not only in functions that it defines."""
    todo: list[ast.AST] = list(ast.parse(cell.source).body)
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Call) and ast.unparse(node.func) in (
            "print",
            "plt.figure",
            "plt.subplots",
        ):
            return True
        if not isinstance(node, ast.FunctionDef):
            todo.extend(ast.iter_child_nodes(node))
    return False


@pytest.mark.parametrize("path", EVERY, ids=lambda path: path.stem)
def test_the_outputs_belong_to_one_run_without_errors(path):
    cells = _code(path)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    kinds = {output.output_type for cell in cells for output in cell.outputs}
    assert "display_data" in kinds and "error" not in kinds
    streams = [o.name for c in cells for o in c.outputs if o.output_type == "stream"]
    assert set(streams) == {"stdout"}
    assert all(cell.outputs for cell in cells if _prints(cell))
    texts = [o.get("text", "") for c in cells for o in c.outputs]
    assert not re.search(r"(?<![\w.])/(home|work|root|tmp|Users)/", "".join(texts))


def test_nothing_but_the_package_and_its_dependencies_is_imported():
    allowed = {"jaxsr", "matplotlib", "numpy", "pandas", "scipy"}
    allowed |= {"dataclasses", "functools", "os", "time"}
    for cell in _code(PAPER):
        for node in ast.walk(ast.parse(cell.source)):
            if isinstance(node, ast.Import):
                assert {alias.name.split(".")[0] for alias in node.names} <= allowed
            elif isinstance(node, ast.ImportFrom):
                assert (node.module or "").split(".")[0] in allowed


@pytest.mark.slow
def test_the_paper_cases_run_and_find_the_laws(tmp_path, monkeypatch):
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    monkeypatch.setenv(BUDGET, os.environ.get(BUDGET, "3"))
    notebook = _read(PAPER)
    client = nbclient.NotebookClient(
        notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}
    )
    with client.setup_kernel():
        for index, cell in enumerate(notebook.cells):
            client.execute_cell(cell, index)
        facts = "[c.complexity for c in clean.equations], unseen_error(clean), np.mean(left**2)"
        terms, error, slider = _evaluated(client, f"[{facts}]")
    assert terms == [1, 1, 3, 3]
    assert error < 1e-2  # per cent: four digits of every constant
    assert slider < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "folder", "sentence"),
    [
        ("emps", None, "The model leaves out Coulomb friction"),
        ("concealed_case", NOTEBOOKS.parent, "quadratic drag"),
    ],
)
def test_the_walks_run_and_find_what_they_tell_of(name, folder, sentence, tmp_path, monkeypatch):
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    if name == "emps" and "JAXSR_DATA_DIR" not in os.environ:
        pytest.skip("needs the EMPS recordings: a folder in JAXSR_DATA_DIR")
    monkeypatch.setenv("JAXSR_CLOCK", "processor")
    monkeypatch.setenv("PYTHONPATH", str(NOTEBOOKS.parent))
    resources = {"metadata": {"path": str(folder or tmp_path)}}
    notebook = _read(NOTEBOOKS / f"{name}.ipynb")
    nbclient.NotebookClient(notebook, timeout=3000, resources=resources).execute()
    said = [o.get("text", "") for c in notebook.cells for o in c.get("outputs", [])]
    assert sentence in "".join(said)


def _evaluated(client, expression: str):
    """Return plain numbers from the notebook's kernel."""
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    cell = nbformat.v4.new_code_cell(f"import json; print(json.dumps({expression}))")
    client.nb.cells.append(cell)
    client.execute_cell(cell, len(client.nb.cells) - 1)
    return ast.literal_eval(cell.outputs[0].text)
