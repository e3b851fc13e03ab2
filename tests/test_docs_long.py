"""The longer blocks of the README and of the documentation, run as a reader would run them."""

from __future__ import annotations

import contextlib
import io
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from docs_blocks import ROOT, Block, blocks

import jaxsr

pytestmark = pytest.mark.slow
SEARCHES = re.compile(r"\bjaxsr\.(diagnose|discover|SymbolicSparseRegressor)\(")
DOCS = ROOT / "docs"


def following(page: Path) -> list[tuple[Block, Block | None]]:
    """Return the blocks of a page that search, each with the output that stands below it."""
    found = blocks(page)
    pairs = []
    for block, after in zip(found, [*found[1:], None], strict=True):
        if block.language == "python" and SEARCHES.search(block.text):
            said = after if after is not None and after.language == "" else None
            pairs.append((block, said))
    return pairs


@pytest.mark.parametrize(
    ("block", "said"),
    [pair for page in (ROOT / "README.md", DOCS / "discover.md") for pair in following(page)],
    ids=str,
)
def test_examples_answer_what_stands_below_them(
    block: Block, said: Block | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shown = io.StringIO()
    with contextlib.redirect_stdout(shown):
        exec(compile(block.text, str(block), "exec"), {})
    if said is not None:
        assert shown.getvalue() == said.text


def test_start_here_works_for_a_stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Save what has a file name, type every command, and find the friction that was hidden."""
    monkeypatch.chdir(tmp_path)
    said = ""
    for block in blocks(DOCS / "start-here.md"):
        if block.title:
            Path(block.title).write_text(block.text, encoding="utf-8")
        for line in (part.strip() for part in block.text.split("\n")):
            if block.language == "" and line.startswith("jaxsr diagnose motor.toml"):
                said += run([sys.executable, "-m", *shlex.split(line)])
            elif block.language == "" and line.startswith(("python make", "jaxsr simulate")):
                words = shlex.split(line)
                run([sys.executable, *(words[1:] if words[0] == "python" else ["-m", *words])])
        if block.language == "" and block.text.startswith("Verdict:"):
            assert said == block.text
    found = jaxsr.load("results")
    ((low, high),) = (f["parameters"]["Fc"]["ci95"] for f in found.findings)
    assert low < 0.03 < high and high - low < 3e-4
    for name, truth in (("J", 0.002), ("b", 0.004)):
        assert json.loads(json.dumps(found.document["calibration"]))[name]["value"] == (
            pytest.approx(truth, rel=1e-2)
        )
    assert len(Path("explained.csv").read_text().splitlines()) == 601


def run(command: list[str]) -> str:
    environment = {"PYTHONPATH": str(ROOT), "PATH": "", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=1800)
    assert done.returncode == 0, done.stderr
    return done.stdout
