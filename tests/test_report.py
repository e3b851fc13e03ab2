"""Reports: what the pages say, and that they stand alone."""

from __future__ import annotations

import copy
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from test_report_documents import (
    chain_document,
    chain_fits,
    drive_document,
    drive_evidence,
)

from jaxsr._result import Verdict
from jaxsr.report import (
    Considered,
    Evidence,
    ForceResidual,
    Trajectory,
    write_diagnosis_report,
    write_discovery_report,
)
from jaxsr.report.mismatch import mismatches
from jaxsr.report.trajectories import free_runs

VOID = {"meta", "img", "br", "mspace", "link", "hr"}
NUMBER = re.compile(r"−?\d+\.?\d*(?:×10[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+)?")
PLAIN = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−", "0123456789--")


class Page(HTMLParser):
    """A parsed page: its elements, its text, its links; unbalanced tags fail."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.source = path.read_text(encoding="utf-8")
        self.stack: list[str] = []
        self.tags: list[str] = []
        self.targets: list[str] = []
        self.cells: list[str] = []
        self.text = ""
        self._cell: str | None = None
        self.feed(self.source)
        assert not self.stack, f"open elements: {self.stack}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.targets += [value or "" for name, value in attrs if name in ("src", "href")]
        assert not any(name.startswith("on") for name, _ in attrs)
        if tag == "td":
            self._cell = ""
        if tag not in VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in VOID

    def handle_endtag(self, tag: str) -> None:
        assert self.stack and self.stack.pop() == tag
        if tag == "td" and self._cell is not None:
            self.cells.append(" ".join(self._cell.split()))
            self._cell = None

    def handle_data(self, data: str) -> None:
        if self.stack and self.stack[-1] not in ("style", "script"):
            self.text += data + " "
            if self._cell is not None:
                self._cell += data


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Page, Path]:
    directory = tmp_path_factory.mktemp("drive")
    write_diagnosis_report(drive_document(), drive_evidence(), directory)
    return Page(directory / "report.html"), directory


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Page, Path]:
    directory = tmp_path_factory.mktemp("chain")
    write_discovery_report(chain_document(), chain_fits(), directory)
    return Page(directory / "report.html"), directory


def diagnose(directory: Path, document: dict, evidence: Evidence) -> Page:
    write_diagnosis_report(document, evidence, directory)
    return Page(directory / "report.html")


def values(item: object) -> list[float]:
    """Return every number in a document, also those inside its texts."""
    if isinstance(item, bool) or item is None:
        return []
    if isinstance(item, int | float):
        return [float(item)]
    if isinstance(item, str):
        return [float(n) for n in re.findall(r"\d+\.?\d*(?:e-?\d+)?", item)]
    children = item.values() if isinstance(item, dict) else item
    keys = values(list(item)) if isinstance(item, dict) else []
    return keys + [v for child in children for v in values(child)]


def printed(text: str) -> list[tuple[float, float]]:
    """Return the numbers of a text, each with half a unit of its last digit."""
    found = []
    for match in NUMBER.findall(text):
        mantissa, _, power = match.partition("×10")
        scale = 10.0 ** int(power.translate(PLAIN) or 0)
        decimals = len(mantissa.partition(".")[2])
        found.append((float(mantissa.translate(PLAIN)) * scale, 0.5 * 10.0**-decimals * scale))
    return found


def test_verdict_comes_first_and_names_mechanism_and_site(drive: tuple[Page, Path]) -> None:
    text = drive[0].text
    verdict = text.index("The model leaves out Coulomb friction in the equation of v.")
    order = [
        "What was found",
        "What changes",
        "Before and after",
        "Free runs",
        "Where the mismatch",
    ]
    places = [verdict, *(text.index(heading) for heading in order), text.index("What else was")]
    assert places == sorted(places)


def test_finding_shows_value_interval_unit_probability_and_place(drive: tuple[Page, Path]) -> None:
    page = drive[0]
    row = page.cells.index("Fc")
    # The interval 20.1142 ... 20.6931 is 0.58 wide: two digits of that are hundredths.
    assert page.cells[row : row + 4] == ["Fc", "20.40", "20.11 … 20.69", "N"]
    flat = " ".join(page.text.split())
    assert "93 % probable" in flat
    assert "Stribeck friction (6 %)" in flat
    assert "−0.02 < v < 0.02 m/s" in flat
    assert "81 % of the given model's mismatch (squared error) comes back" in flat
    assert "-Fc*sign(v)" in flat


def test_diff_marks_only_what_changed(drive: tuple[Page, Path]) -> None:
    source = drive[0].source
    assert "− v = &#34;force - Fv*v&#34;" in source
    assert "+ v = &#34;force - Fv*v<mark> - Fc*sign(v)</mark>&#34;" in source
    assert "− M = { value = <mark>95</mark>, unit" in source
    assert "+ M = { value = <mark>95.3</mark>, unit" in source


def test_fit_table_holds_every_error_and_marks_the_headline(drive: tuple[Page, Path]) -> None:
    page, fit = drive[0], drive_document()["fit"]
    for role in ("train", "held_out"):
        for model in ("given", "recalibrated", "explained"):
            shown = [
                cell
                for error in fit[role][model]
                for cell in page.cells
                if cell.endswith(" %")
                and any(abs(n - 100 * error) <= tol * 1.0001 for n, tol in printed(cell))
            ]
            assert len(shown) >= len(fit[role][model])
    assert page.source.count("the verdict rests here") == 1
    head = re.search(r'<th class="num headline">(.*?)<small', page.source)
    assert head is not None and head[1] == "2.5 s"


@pytest.mark.parametrize("which", ["drive", "chain"])
def test_every_number_in_a_table_comes_from_the_document(
    which: str, request: pytest.FixtureRequest
) -> None:
    page, _ = request.getfixturevalue(which)
    if which == "drive":
        evidence = drive_evidence()
        tried = [[c.error, c.relative, *c.mechanisms, c.reason] for c in evidence.considered]
        given = [row.before for row in evidence.diff]
        known = values([drive_document(), tried, given])
    else:
        known = values(chain_document())
    known = np.array(known + [100 * v for v in known] + [-v for v in known])
    cells = [cell for cell in page.cells if NUMBER.search(cell)]
    assert len(cells) > 10
    for cell in cells:
        for number, tolerance in printed(re.sub(r"N·s²/m²", "N", cell)):
            assert np.min(np.abs(known - number)) <= tolerance * 1.0001, cell


@pytest.mark.parametrize("which", ["drive", "chain"])
def test_page_stands_alone(which: str, request: pytest.FixtureRequest) -> None:
    page, directory = request.getfixturevalue(which)
    assert page.targets and all(t.startswith("data:image/png;base64,") for t in page.targets)
    assert not {"link", "iframe", "object"} & set(page.tags)
    # The report of a diagnosis carries numbers and one script, which its policy names by its hash.
    assert page.tags.count("script") == (2 if which == "drive" else 0)
    assert re.findall(r"<script[^>]*>", page.source) == re.findall(
        r'<script(?: type="application/json" id="evidence")?>', page.source
    )
    assert "http:" not in page.source and "https:" not in page.source
    assert "@import" not in page.source and "url(" not in page.source
    figures = list(directory.glob("*.png"))
    assert len(figures) == page.tags.count("img")
    assert all(figure.read_bytes().startswith(b"\x89PNG") for figure in figures)
    names = {path.name for path in directory.iterdir()}
    assert names == {figure.name for figure in figures} | {"report.html"}


@pytest.mark.long
def test_markup_in_names_stays_text(tmp_path: Path) -> None:
    bad = "<script>alert('x')</script>"

    def spoil(item: object) -> object:
        if isinstance(item, dict):
            keep = ("verdict", "schema", "measure")
            return {
                (f"{k}{bad}" if k in ("Fc", "M", "a.csv") else k): v if k in keep else spoil(v)
                for k, v in item.items()
            }
        if isinstance(item, list):
            return [spoil(child) for child in item]
        return f'{item}{bad}" onload="x' if isinstance(item, str) else item

    evidence = drive_evidence()
    evidence = replace(
        evidence,
        model_name=bad,
        diff=[replace(row, key=row.key + bad, before=bad) for row in evidence.diff],
        trajectories=[
            replace(t, output=f"$x^{{{bad}", recording=bad, unit=bad) for t in evidence.trajectories
        ],
        residuals=[replace(r, site=bad, state_name=bad, unit="$") for r in evidence.residuals],
        considered=[replace(c, mechanisms=(bad,), reason=bad) for c in evidence.considered],
    )
    document = spoil(drive_document())
    assert isinstance(document, dict)
    page = diagnose(tmp_path, document, evidence)
    assert page.tags.count("script") == 2 and "<script>alert" not in page.source
    assert "alert(" in page.text
    discovery = spoil(chain_document())
    assert isinstance(discovery, dict)
    fits = [replace(fit, state=bad, recording=bad) for fit in chain_fits()]
    write_discovery_report(discovery, fits, tmp_path / "discovery")
    assert "script" not in Page(tmp_path / "discovery" / "report.html").tags


@pytest.mark.parametrize("verdict", list(Verdict))
def test_bare_document_of_every_verdict_makes_a_page(tmp_path: Path, verdict: Verdict) -> None:
    page = diagnose(tmp_path, {"verdict": str(verdict)}, Evidence("pendulum"))
    assert page.tags.count("h1") == 1 and "img" not in page.tags
    assert "None" not in page.text


def test_figures_for_which_no_time_is_left_are_left_out(tmp_path: Path) -> None:
    """The first one is drawn whatever the time; the page says how many are not."""
    evidence = drive_evidence()
    write_diagnosis_report(drive_document(), evidence, tmp_path, lambda: True)
    page = Page(tmp_path / "report.html")
    assert len(list(tmp_path.glob("free_run_*.png"))) == 1
    assert not list(tmp_path.glob("mismatch_*.png"))
    assert f"{len(evidence.trajectories) - 1} more free runs are not drawn" in page.text


def test_unknown_verdict_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="fine"):
        write_diagnosis_report({"verdict": "fine"}, Evidence("pendulum"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_null_figures_and_no_held_out(tmp_path: Path) -> None:
    document = drive_document()
    fit = document["fit"]
    fit["held_out"] = None
    fit["train"] = {"given": None, "recalibrated": [None] * 3, "explained": [0.1, None, 0.2]}
    fit["force"] = {"equation:v": {"half_width_s": None, "train": None, "held_out": None}}
    finding = document["findings"][0]
    finding.update(probability=None, share=None, where=None, term=None, alternatives=None)
    finding["parameters"]["Fc"] = {"value": None, "ci95": None, "unit": None}
    document["calibration"]["M"]["ci95"] = [None, 110.0]
    document["confusable"] = [["a", "b", None]]
    document["next_experiment"] = None
    evidence = replace(
        drive_evidence(),
        considered=[Considered((), float("nan"), float("inf"), False, "Diverged.")],
    )
    page = diagnose(tmp_path, document, evidence)
    assert "No recording was held out" in page.text
    assert not re.search(r"\b(None|nan|inf)\b", page.text)


def test_empty_discovery(tmp_path: Path) -> None:
    document = {"equations": [], "pareto": {}, "modes": [], "switching": {}, "provenance": {}}
    write_discovery_report(document, [], tmp_path)
    assert "No equation was found." in Page(tmp_path / "report.html").text


def test_modes_and_their_guards_are_shown(tmp_path: Path) -> None:
    document = chain_document()
    part = document["equations"][:1]
    document["modes"] = [{"guard": "Abs(z2) > 0.1", "equations": copy.deepcopy(part)}] * 2
    document["switching"] = {"run1.csv": [[0.0, 1.5, 0], [1.5, 4.0, 1]]}
    write_discovery_report(document, [], tmp_path)
    assert "Mode 1, where" in " ".join(Page(tmp_path / "report.html").text.split())
    assert (tmp_path / "modes.png").exists()


@pytest.mark.slow
def test_many_long_diverging_outputs_stay_small(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    time = np.arange(0, 100, 0.001)
    runs, residuals = [], []
    for number in range(12):
        measured = np.sin(40 * np.pi * time) + 0.01 * rng.standard_normal(len(time))
        wild = np.where(time > 50, np.exp(np.minimum(6 * (time - 50), 700)), measured)
        wild[-500:] = np.nan
        name = f"run_{number}_{'long' * 30}.csv"
        runs.append(
            Trajectory(name, "held_out", "y", None, 2.0, time, measured, None, wild, measured)
        )
        residuals.append(
            ForceResidual(f"equation:v{number}", name, "N", time, wild, measured, "v", time, None)
        )
    missing = np.full(len(time), np.nan)
    runs.append(
        Trajectory("no.csv", "train", "y", "m", 2.0, time, missing, missing, missing, missing)
    )
    evidence = replace(drive_evidence(), trajectories=runs, residuals=residuals)
    page = diagnose(tmp_path, drive_document(), evidence)
    assert page.tags.count("img") <= 10
    assert (tmp_path / "report.html").stat().st_size < 2_000_000
    assert all(figure.stat().st_size < 250_000 for figure in tmp_path.glob("*.png"))


def test_after_the_time_no_figure_is_drawn_but_the_first() -> None:
    evidence = drive_evidence()
    assert len(free_runs(evidence.trajectories, None, lambda: True)) == 1
    assert mismatches(evidence.residuals, [], lambda: True) == []


def test_same_input_gives_the_same_bytes(drive: tuple[Page, Path], tmp_path: Path) -> None:
    write_diagnosis_report(drive_document(), drive_evidence(), tmp_path)
    for path in drive[1].iterdir():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()
