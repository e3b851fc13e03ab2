"""``jaxsr diagnose --resume``: what is complete and the same is left alone, and nothing else is."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

import jaxsr
from jaxsr import cli

COMMAND = "diagnose m.toml a.csv --held-out v.csv --seed 3 --out d"


class Diagnosed(Exception):
    """The search began."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a complete diagnosis in ``d``, in which no search can run."""
    monkeypatch.chdir(tmp_path)
    for name in ("m.toml", "a.csv", "v.csv", "w.csv"):
        Path(name).write_text(name)

    def diagnose(*_: Any, **__: Any) -> None:
        raise Diagnosed

    monkeypatch.setitem(jaxsr.__dict__, "diagnose", diagnose)
    monkeypatch.setattr("jaxsr.models.formats.opening.open_simulator", opened)
    hold("converged")
    return tmp_path


def opened(*_: Any, **__: Any) -> Any:
    raise Diagnosed


def digests(*names: str) -> dict[str, str]:
    return {name: hashlib.sha256(name.encode()).hexdigest() for name in names}


def hold(stopped_by: str, version: str = jaxsr.__version__) -> None:
    """Write a diagnosis as it would have come of the files as they were."""
    provenance = {
        "version": version,
        "command": f"jaxsr {COMMAND} --budget 5",
        "stopped_by": stopped_by,
        "data_sha256": digests("a.csv"),
        "model_sha256": digests("m.toml"),
    }
    fit = {"held_out": {"sha256": digests("v.csv")}}
    Path("d").mkdir(exist_ok=True)
    document = {"verdict": "structure", "fit": fit, "provenance": provenance}
    Path("d/diagnosis.json").write_text(json.dumps(document))


def run(command: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, bool, str, str]:
    """Return the exit status, whether a search began, and what was said."""
    status = cli.main(command.split())
    captured = capsys.readouterr()
    return status, "Diagnosed" in captured.err, captured.out, captured.err


@pytest.mark.usefixtures("folder")
def test_what_is_complete_is_not_done_again(capsys: pytest.CaptureFixture[str]) -> None:
    for more in ("--resume", "--resume --budget 9"):
        status, began, said, _ = run(f"{COMMAND} {more}", capsys)
        assert (status, began) == (0, False) and "structure. Complete in d: nothing to do" in said
    assert run(COMMAND, capsys)[1]  # only where it is asked for


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("stopped_by", ["budget", "interrupted"])
def test_what_was_stopped_begins_anew_and_says_so(
    stopped_by: str, capsys: pytest.CaptureFixture[str]
) -> None:
    hold(stopped_by)
    _, began, _, said = run(f"{COMMAND} --resume", capsys)
    assert began and f"ended before its time ({stopped_by}): it begins anew" in said


@pytest.mark.usefixtures("folder")
def test_another_version_and_an_empty_folder_begin(capsys: pytest.CaptureFixture[str]) -> None:
    hold("converged", "0.0.0")
    _, began, _, said = run(f"{COMMAND} --resume", capsys)
    assert began and "is by version 0.0.0" in said
    Path("d/diagnosis.json").unlink()
    assert run(f"{COMMAND} --resume", capsys)[1]


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("changed", "command", "told"),
    [
        ("m.toml", COMMAND, "other files"),
        ("a.csv", COMMAND, "other files"),
        ("v.csv", COMMAND, "other held-out files"),
        ("", COMMAND.replace("3", "4"), "another command"),
        ("", COMMAND.replace("v.csv", "w.csv"), "another command"),
        ("d/diagnosis.json", COMMAND, "cannot be read"),
    ],
)
def test_other_files_and_options_are_refused_in_one_line(
    changed: str, command: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if changed:
        Path(changed).write_text("changed")
    status, began, said, error = run(f"{command} --resume", capsys)
    assert (status, began, said) == (2, False, "")
    assert error.count("\n") == 1 and told in error


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("text", ["[]", "{}", '{"verdict": "nothing", "fit": {}, "provenance": 3}'])
def test_what_is_no_diagnosis_is_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("d/diagnosis.json").write_text(text)
    status, began, _, error = run(f"{COMMAND} --resume", capsys)
    assert (status, began) == (2, False) and "is no diagnosis" in error


@pytest.mark.usefixtures("folder")
def test_only_a_model_file_is_resumed(capsys: pytest.CaptureFixture[str]) -> None:
    Path("robot.xml").write_text("")
    for command in (
        "diagnose robot.xml a.csv --out d --resume",
        "diagnose a.csv --simulated v.csv --out d --resume",
    ):
        status, began, _, error = run(command, capsys)
        assert (status, began) == (2, False) and "--resume goes with a model file" in error
