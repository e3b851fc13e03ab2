"""The README and the documentation say what is so: their blocks, their links, their length."""

from __future__ import annotations

import importlib
import json
import re
import shlex
import sys
import tomllib
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
import typer
from docs_blocks import PAGES, ROOT, Block, blocks, of

from jaxsr import cli
from jaxsr._arguments import expand_file_lists
from jaxsr._job import RUN
from jaxsr._process import Run
from jaxsr.batch import read_cases
from jaxsr.models import parse_model

README, START = ROOT / "README.md", ROOT / "docs" / "start-here.md"
CHANGES = ROOT / "CHANGELOG.md"
_LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)|!\[[^\]]*\]\(([^)\s]+)\)|src=\"([^\"]+)\"")
_FENCED = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)


def quick(block: Block) -> bool:
    """Whether a Python block runs in moments, on nothing but what it makes.

    Those that search run in `test_docs_long`, those that read results in `test_docs_commands`; one
    asks a queue of Slurm for workers, and is compiled only.
    """
    slow = re.search(r"\bjaxsr\.(diagnose|discover|load|Symbolic\w+)\(", block.text)
    return not slow and block.page.name != START.name and "dask_jobqueue" not in block.text


def page_name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def prose(page: Path) -> str:
    return _FENCED.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """Return the anchors that headings get, on the site and on GitHub."""
    heads = re.findall(r"^#+ +(.+)$", prose(page), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-") for h in heads]
    return {re.sub(r"-+", "-", p) for p in plain} | set(plain)


def test_readme_is_one_screen() -> None:
    assert len(README.read_text(encoding="utf-8").split()) <= 700


def test_every_package_is_in_the_table_of_layers() -> None:
    table = (ROOT / "docs" / "contributing.md").read_text(encoding="utf-8")
    packages = {path.parent.name for path in (ROOT / "jaxsr").glob("*/__init__.py")}
    assert packages <= set(re.findall(r"`(\w+)/`", table))


def test_the_release_is_dated_once_and_everywhere_the_same() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    released = re.search(r"^## \[(\d[\d.]*)\] - (.+)$", CHANGES.read_text("utf-8"), re.MULTILINE)
    assert released is not None and released[1] == project["version"]
    assert f"\nversion: {released[1]}\ndate-released: {released[2]}\n" in cited


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_links_lead_somewhere(page: Path) -> None:
    broken = []
    for groups in _LINK.findall(prose(page)):
        target = next(g for g in groups if g)
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = unquote(target).partition("#")
        goal = (page.parent / path).resolve() if path else page
        if not goal.is_file() or (anchor and anchor not in anchors(goal)):
            broken.append(target)
    assert not broken


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_nothing_names_files_that_readers_lack(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"CONTRACT\.md|DESIGN\.md|(?<![\w.])/(home|work|root|tmp)/", text)


@pytest.mark.parametrize("block", of("toml"), ids=str)
def test_toml_blocks_are_model_files_or_cases(block: Block, tmp_path: Path) -> None:
    if block.title == "cases.toml":
        (tmp_path / block.title).write_text(block.text)
        assert len(read_cases(tmp_path / block.title)) > 1
    else:
        assert parse_model(block.text, str(block)).states


@pytest.mark.parametrize("block", of("json"), ids=str)
def test_json_blocks_are_json(block: Block) -> None:
    json.loads(block.text)


@pytest.mark.parametrize("block", of("python"), ids=str)
def test_python_blocks_are_python(block: Block) -> None:
    """They compile, and what they import from jaxsr is there; those that search run elsewhere."""
    compile(block.text, str(block), "exec")
    for module, names in re.findall(r"^from (jaxsr[\w.]*) import (.+)$", block.text, re.MULTILINE):
        for name in names.split(","):
            assert hasattr(importlib.import_module(module), name.strip()), (module, name)
    for name in re.findall(r"\bjaxsr\.(\w+)", block.text):
        if name != "__file__":
            assert hasattr(importlib.import_module("jaxsr"), name), name


@pytest.mark.long
@pytest.mark.parametrize("block", [b for b in of("python") if quick(b)], ids=str)
def test_short_python_blocks_run(
    block: Block, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from jaxsr.diagnosis.mechanisms import FAMILIES

    monkeypatch.chdir(tmp_path)
    before = list(FAMILIES)
    try:
        exec(compile(block.text, str(block), "exec"), {})
    finally:
        FAMILIES[:] = before


def commands() -> list[Any]:
    """Return every line that calls jaxsr, named by its page."""
    found: dict[str, Path] = {}
    for block in (b for page in PAGES for b in blocks(page) if b.language in ("", "console")):
        for part in re.split(r"\n|&&", block.text):
            if part.strip().startswith("jaxsr "):
                found.setdefault(part.strip(), block.page)
    return [pytest.param(line, id=f"{page.name}: {line}") for line, page in found.items()]


@pytest.mark.parametrize("line", commands())
def test_commands_are_understood(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """Every command of the pages is parsed and checked; its job is not run."""
    monkeypatch.chdir(tmp_path)
    arguments = shlex.split(line)[1:]
    out = arguments[arguments.index("--out") + 1] if "--out" in arguments else None
    for word in arguments:
        path = Path(word.split(":")[0])
        if path.suffix in (".toml", ".csv", ".py", ".fmu", ".xml") and word != out:
            path.parent.mkdir(exist_ok=True)
            path.write_text(word)
    token = RUN.set(Run(0.0, lambda run: None))
    try:
        command = typer.main.get_command(cli.app)
        asked = expand_file_lists(arguments)
        job = command.main(args=asked, prog_name="jaxsr", standalone_mode=False)
    finally:
        RUN.reset(token)
    assert callable(job) or (job == 0 and capsys.readouterr().out)


def test_every_mechanism_has_a_page_and_a_source() -> None:
    index = (ROOT / "docs" / "mechanisms.md").read_text(encoding="utf-8")
    pages = {page.stem: page for page in (ROOT / "docs" / "mechanisms").glob("*.md")}
    assert set(pages) == set(re.findall(r"\(mechanisms/(\w+)\.md\)", index))
    bare = [
        name
        for name, page in pages.items()
        if not re.search(
            r"^\*Source\*: \w.*\w.*\.$", page.read_text(encoding="utf-8"), re.MULTILINE
        )
    ]
    assert not bare


def test_generated_pages_are_those_of_the_code_and_the_results() -> None:
    """``python -m docs.generate`` writes them anew."""
    sys.path.insert(0, str(ROOT))
    from docs.generate.__main__ import differing, pages

    assert differing(pages()) == []
