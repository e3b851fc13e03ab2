"""The report that people explore: what its script is given, what it does in a browser."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import browser
import numpy as np
import pytest
from test_report_documents import chain_document, chain_fits, drive_document, drive_evidence

from jaxsr.report import Evidence, ModelRun, write_diagnosis_report, write_discovery_report
from jaxsr.report.batch_report import Shown, batch_page
from jaxsr.report.copies import edit_text, python_text
from jaxsr.report.exploring import MOST, packed, script
from jaxsr.report.fit_tables import fit_groups
from jaxsr.report.mismatch import by_site
from jaxsr.report.whiteness import LAGS, correlations, left_over, means

RIVAL = ("stribeck_friction@equation:v",)


def with_rivals() -> Evidence:
    """Return evidence with runs of a rival, inputs, and other variables of the residuals."""
    evidence = drive_evidence()
    return replace(
        evidence,
        trajectories=[
            replace(t, rivals={RIVAL: t.explained + 0.01}, inputs={"force": np.sin(t.time)})
            for t in evidence.trajectories
        ],
        residuals=[
            replace(r, variables={r.state_name: r.state, "q": np.cos(r.time)})
            for r in evidence.residuals
        ],
        considered=[
            replace(evidence.considered[0], mechanisms=RIVAL, chosen=False),
            *evidence.considered,
        ],
    )


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("drive")
    write_diagnosis_report(drive_document(), with_rivals(), directory)
    return directory / "report.html"


def numbers(entry: dict) -> np.ndarray:
    kind = "<f8" if entry["wide"] else "<f4"
    return np.frombuffer(base64.b64decode(entry["data"]), kind)


def test_the_page_allows_its_own_script_and_nothing_else(report: Path) -> None:
    page = report.read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    (text,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()
    assert policy is not None
    assert policy[1].endswith(f"script-src 'sha256-{digest}'")
    assert text == script()
    assert not re.search(r"https?:|fetch\(|XMLHttpRequest|import\(|eval\(", text)


def test_the_script_is_given_the_figures_as_numbers() -> None:
    evidence = with_rivals()
    told = json.loads(packed(evidence))
    run, row = evidence.trajectories[0], told["series"][0]
    shared = told["recordings"][run.recording]
    every = -(-len(run.time) // MOST)
    explained = run.explained[::every]
    assert numbers(shared["time"]) == pytest.approx(run.time[::every])
    assert numbers(shared["inputs"]["force"]) == pytest.approx(np.sin(run.time[::every]), abs=1e-6)
    assert numbers(row["explained"]) == pytest.approx(explained, rel=1e-6, nan_ok=True)
    assert numbers(row["rival0"]) == pytest.approx(explained + 0.01, rel=1e-6, nan_ok=True)
    assert told["rivals"][0][0] == "rival0" and "Stribeck" in told["rivals"][0][1]
    part, row = evidence.residuals[0], told["residuals"][0]
    assert numbers(row["variables"]["q"]) == pytest.approx(np.cos(part.time), rel=1e-6)


@pytest.mark.long
def test_a_report_stays_below_3_megabytes_whatever_it_is_about(tmp_path: Path) -> None:
    run, part = drive_evidence().trajectories[0], drive_evidence().residuals[0]
    time = np.linspace(0.0, 2000.0, 200_000)
    long = {name: np.sin(time) for name in ("measured", "given", "recalibrated", "explained")}
    inputs = {f"u{k}": np.cos(time) for k in range(6)}
    runs = [replace(run, output=f"y{k}", time=time, inputs=inputs, **long) for k in range(60)]
    evidence = Evidence("arm", trajectories=runs, residuals=[part] * 30)
    assert len(packed(evidence)) < 1.6e6
    write_diagnosis_report(drive_document(), evidence, tmp_path)
    assert (tmp_path / "report.html").stat().st_size < 3_000_000


def test_names_cannot_end_the_numbers() -> None:
    evidence = with_rivals()
    bad = [replace(evidence.trajectories[0], recording="</script><script>alert(1)</script>")]
    text = packed(replace(evidence, trajectories=bad))
    assert "<" not in text
    assert json.loads(text)["series"][0]["recording"].startswith("</script>")


def test_what_is_copied_can_be_used() -> None:
    edit = drive_document()["findings"][0]["edit"]
    read = tomllib.loads(edit_text(edit))
    assert read["equations"]["v"] == edit["equations.v"]
    assert read["parameters"]["Fc"]["unit"] == "N"
    assert edit_text({"model.states": ["q", "v", "z"]}) == '[model]\nstates = ["q", "v", "z"]'
    compile(python_text(drive_document()), "copied", "exec")


def test_a_part_says_of_what_it_is_a_part(tmp_path: Path) -> None:
    document = drive_document()
    (finding,) = document["findings"]
    told = [{"value": 0.75, "by": "all orders"}, {"value": 0.25, "by": "leaving one out"}, None]
    document["findings"] = [finding | {"part": part} for part in told]
    write_diagnosis_report(document, with_rivals(), tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    parts = re.findall(r"<dt>Part of the explanation</dt><dd>(.*?)</dd>", page)
    assert len(parts) == 2
    assert all("of what re-calibration could not explain" in part for part in parts)
    assert parts[0].startswith("75 %") and "average over the orders" in parts[0]
    assert parts[1].startswith("25 %") and "without each finding, scaled" in parts[1]


def test_columns_that_would_be_blank_are_left_out(tmp_path: Path) -> None:
    document = drive_document()
    for row in document["findings"][0]["parameters"].values():
        row.pop("unit", None)
    document["data_checks"] = [{"file": "", "channel": "", "check": "search", "message": "x"}]
    write_diagnosis_report(document, with_rivals(), tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    card = page[page.index('class="card"') : page.index("</article>")]
    assert "<th>Unit</th>" not in card and "95 % interval" in card
    checks = page[page.index("Checks of the data") :]
    assert "<th>Channel</th>" not in checks[: checks.index("</table>")]


def test_a_discovery_prints_no_blank_columns_either(tmp_path: Path) -> None:
    document = chain_document()
    row = {"file": "", "channel": "q", "check": "gap", "message": "x"}
    heads = []
    for name, ends, checks in (("a", [19.9, 20.1], [row | {"file": "a.csv"}]), ("b", None, [row])):
        for term in document["equations"][0]["terms"]:
            term["ci95"] = ends
        document["data_checks"] = checks
        write_discovery_report(document, [], tmp_path / name)
        page = (tmp_path / name / "report.html").read_text(encoding="utf-8")
        heads.append([word in page for word in ("<th>File<", "<th>Channel<", "95 % interval<")])
    assert heads == [[True, True, True], [False, True, False]]


def test_horizons_that_no_time_was_left_for_have_no_column() -> None:
    fit = drive_document()["fit"]
    for role in ("train", "held_out"):
        for model in ("given", "recalibrated", "explained"):
            fit[role][model][0] = None
    table = fit_groups(fit)
    assert [column["text"] for column in table["columns"]] == ["2.5 s", "whole recording"]
    assert [column["headline"] for column in table["columns"]] == [True, False]
    rows = [row["cells"] for group in table["groups"] for row in group["rows"]]
    assert len(rows) == 6 and all(len(cells) == 2 for cells in rows)
    assert not any("–" in cells for cells in rows)


def test_white_residuals_are_called_white_and_slow_ones_not() -> None:
    rng = np.random.default_rng(0)
    run = drive_evidence().trajectories[0]
    time = np.arange(4000.0)
    white = rng.normal(size=4000)
    slow = np.convolve(white, np.ones(10), "same")
    notes = []
    for error in (white, slow):
        runs = [replace(run, time=time, measured=0.0 * time, explained=error, role="held_out")]
        runs = [replace(r, recalibrated=error, given=None) for r in runs]
        notes.append(left_over(Evidence("m", trajectories=runs))[0].note)
    assert "is white" in notes[0]
    assert f"is not white: {9} of" in notes[1] or "is not white: 8 of" in notes[1]
    assert correlations(slow)[:3] == pytest.approx([0.9, 0.8, 0.7], abs=0.05)
    assert np.abs(correlations(white)).max() < 5.0 / np.sqrt(4000) and LAGS == 25


def test_means_over_a_variable_show_what_is_left() -> None:
    rng = np.random.default_rng(0)
    over = rng.uniform(-1.0, 1.0, 4000)
    middle, mean, error = means(over, 0.3 * np.sign(over) + 0.1 * rng.normal(size=4000))
    beyond = np.abs(middle) > 0.1
    assert mean[beyond] == pytest.approx(0.3 * np.sign(middle[beyond]), abs=0.03)
    assert (error < 0.05).all()


def test_what_is_left_is_told_on_held_out_recordings_where_there_are_any(tmp_path: Path) -> None:
    """A mean that is left in one role's recordings is drawn, or not, by the role that is shown."""
    evidence = drive_evidence()
    train, held = (
        next(r for r in evidence.residuals if r.role == x) for x in ("train", "held_out")
    )
    drawn = []
    for held_out in ([], [held]):
        pair = [train, *held_out]
        shown = left_over(Evidence("m", residuals=pair))[0]
        worse = left_over(
            Evidence("m", residuals=[replace(train, explained=train.explained + 9.0), *held_out])
        )
        drawn.append((shown, shown.png == worse[0].png))
    assert [role in d.caption + d.note for d, _ in drawn for role in ("training", "held-out")] == [
        *(True, False),
        *(False, True),
    ]
    assert [same for _, same in drawn] == [False, True]
    sites = by_site(evidence.residuals)
    assert [part.role for parts in sites.values() for part in parts] == ["train"]


needs_browser = pytest.mark.skipif(browser.found() is None, reason="no Chromium on this machine")


@pytest.fixture(scope="module")
def page() -> Iterator[browser.Page]:
    with browser.page() as opened:
        yield opened


@pytest.fixture(scope="module")
def others(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return a discovery's page with free runs and one over a batch of long names."""
    directory = tmp_path_factory.mktemp("others")
    time = np.linspace(0.0, 10.0, 1500)
    runs = [
        ModelRun(
            **{"recording": "run2.csv", "output": state, "unit": "m/s", "time": time},
            **{"measured": np.sin(time), "simulated": np.sin(time) + 0.01 * np.cos(3.0 * time)},
            **{"starts": time[[0, 750]], "horizon_s": 5.0, "nrmse": 0.01},
            inputs={"u": np.cos(time)},
        )
        for state in ("z3", "z4")
    ]
    write_discovery_report(chain_document(), chain_fits(), directory, runs=runs)
    bare = directory / "bare"
    write_discovery_report(chain_document(), chain_fits(), bare)
    cases = {f"machine_{k}_{'long' * 8}": drive_document() for k in range(3)}
    batch = directory / "batch.html"
    failures = {"broken": "no column of that name " * 4}
    batch.write_text(batch_page(Shown(cases, [], failures, ["waiting"], 0.05)))
    return {"runs": directory / "report.html", "bare": bare / "report.html", "batch": batch}


@pytest.mark.long
@needs_browser
@pytest.mark.parametrize("which", ["runs", "bare", "batch"])
@pytest.mark.parametrize("width", [400, 800, 1600])
def test_pages_of_discoveries_and_batches_hold_in_three_widths(
    page: browser.Page, others: dict[str, Path], which: str, width: int
) -> None:
    page.show(others[which], width)
    assert page.value("document.documentElement.scrollWidth <= innerWidth")
    charts = page.value("document.querySelectorAll('#explore canvas').length")
    assert charts == (3 if which == "runs" else 0)  # two outputs, and one over any variable
    assert page.errors == []


@needs_browser
def test_runs_of_a_discovery_are_zoomed_together(
    page: browser.Page, others: dict[str, Path]
) -> None:
    page.show(others["runs"], 1000)
    states = "[...document.querySelectorAll('#explore .chart canvas')].map(c => c.toDataURL())"
    before = page.value(states)
    press(page, "Zoom in")
    assert [a != b for a, b in zip(before, page.value(states), strict=True)] == [True, True, False]
    words = (
        "[...document.querySelectorAll('#explore label input')].map(b => b.parentNode.innerText)"
    )
    assert [word.strip() for word in page.value(words)] == ["measured", "model"]
    assert page.errors == []


@needs_browser
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [400, 800, 1600])
def test_no_overflow_and_no_errors(
    page: browser.Page, report: Path, width: int, dark: bool
) -> None:
    page.show(report, width, dark)
    assert page.value("document.documentElement.scrollWidth <= innerWidth")
    assert page.value("!document.getElementById('explore').hidden")
    assert page.value("document.querySelectorAll('#explore canvas').length") >= 2
    back = page.value("getComputedStyle(document.body).backgroundColor")
    assert back == ("rgb(13, 17, 23)" if dark else "rgb(255, 255, 255)")
    assert page.errors == []


@needs_browser
def test_charts_are_zoomed_together_and_tell_their_values(page: browser.Page, report: Path) -> None:
    page.show(report, 1000)
    # the left edges of axis labels change with the span: compare pictures of the canvases
    states = "[...document.querySelectorAll('#explore .chart canvas')].map(c => c.toDataURL())"
    before = page.value(states)
    press(page, "Zoom in")
    after = page.value(states)
    charts = len(before) - 1  # the last one is over another variable
    assert all(a != b for a, b in zip(before[:charts], after[:charts], strict=True))
    assert before[charts] == after[charts]
    press(page, "All of it")
    assert page.value(states) == before
    page.value("document.querySelector('#explore canvas').scrollIntoView()")
    place = page.value(
        "(r => [r.left + r.width / 2, r.top + 50])"
        "(document.querySelector('#explore canvas').getBoundingClientRect())"
    )
    page.ask("Input.dispatchMouseEvent", type="mouseMoved", x=place[0], y=place[1])
    told = page.value("document.querySelector('.readout').textContent")
    assert " s" in told and "measured" in told and "explained" in told
    assert page.errors == []


@needs_browser
def test_a_hypothesis_opens_and_models_are_switched(page: browser.Page, report: Path) -> None:
    page.show(report, 1000)
    checked = "[...document.querySelectorAll('#explore input')].filter(b => b.checked).length"
    assert page.value(checked) == 3
    page.value("document.querySelector('[data-models=rival0] button').click()")
    shown = page.value(
        "[...document.querySelectorAll('#explore input')].filter(b => b.checked)"
        ".map(b => b.parentNode.className)"
    )
    assert shown == ["measured", "rival0"]
    page.value("document.querySelector('button.theme').click()")
    assert page.value("getComputedStyle(document.body).backgroundColor") == "rgb(13, 17, 23)"
    assert page.value("document.querySelectorAll('.copy:not([hidden]) button').length") >= 3
    assert page.errors == []


@needs_browser
def test_a_printed_page_and_one_without_scripts_show_the_figures(
    page: browser.Page, report: Path
) -> None:
    page.show(report, 800, dark=True)
    page.ask("Emulation.setEmulatedMedia", media="print")
    assert page.value("getComputedStyle(document.getElementById('explore')).display") == "none"
    assert page.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    page.ask("Emulation.setEmulatedMedia", media="")
    page.ask("Emulation.setScriptExecutionDisabled", value=True)
    page.show(report, 400)
    page.ask("Emulation.setScriptExecutionDisabled", value=False)
    source = report.read_text(encoding="utf-8")
    assert 'id="explore" hidden' in source and source.count("<img ") >= 3
    assert page.value("document.querySelectorAll('button').length") == 0
    assert page.value("document.documentElement.scrollWidth <= innerWidth")


def press(page: browser.Page, title: str) -> None:
    page.value(f"document.querySelector('button[title=\"{title}\"]').click()")
