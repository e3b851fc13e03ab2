"""Registry, local folder, checksums, download and writing of the real recordings."""

from __future__ import annotations

import importlib
import re
import shutil
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from jaxsr._result import InputError
from jaxsr.datasets import Dataset, fetch, list_datasets

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "recordings"
NAMES = [
    *("emps", "ur10e", "dfki_pendulum", "silverbox", "cascaded_tanks", "falling_balls"),
    *("bam_xl330", "ced", "go2", "kvlcc2", "multiarm_pendulum", "tx40"),
]

# The package re-exports a function of the module's name.
fetch_module = importlib.import_module("jaxsr.datasets.fetch")

needs_recordings = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason="the real recordings (../shared/recordings) are absent"
)


class _QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


def _dataset(name: str) -> Dataset:
    return next(dataset for dataset in list_datasets() if dataset.name == name)


@pytest.fixture
def tanks_origin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Serve the tanks' file over HTTP in the origin's layout; return the served file."""
    dataset = _dataset("cascaded_tanks")
    source = dataset.sources[0]
    served = tmp_path / "origin" / dataset.repository / dataset.commit / source.upstream
    served.parent.mkdir(parents=True)
    shutil.copyfile(RECORDINGS / "cascaded_tanks" / source.path, served)
    served.chmod(0o644)
    handler = partial(_QuietHandler, directory=str(tmp_path / "origin"))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    monkeypatch.setattr(fetch_module, "ORIGIN", f"http://127.0.0.1:{server.server_port}")
    monkeypatch.setattr(fetch_module.pooch, "os_cache", lambda _: tmp_path / "cache")
    monkeypatch.delenv("JAXSR_DATA_DIR", raising=False)
    yield served
    server.shutdown()
    server.server_close()


def test_registry_is_complete() -> None:
    assert [dataset.name for dataset in list_datasets()] == NAMES
    for dataset in list_datasets():
        # GitHub takes the first seven digits of a commit, which is all that is known of one.
        assert re.fullmatch(r"[0-9a-f]{40}|06739ea", dataset.commit)
        assert all(re.fullmatch(r"[0-9a-f]{64}", value) for value in dataset.files.values())
        assert dataset.licence and dataset.citation and dataset.left_out


def test_url_names_repository_commit_and_path() -> None:
    dataset = _dataset("silverbox")
    assert dataset.url(dataset.sources[0]) == (
        "https://raw.githubusercontent.com/biaslab/nsi-silverbox/"
        "728f07e4539d4f7da76a4778b52a756260b488ac/data/Silverbox/SNLS80mV.mat"
    )


@needs_recordings
def test_registry_agrees_with_the_checksum_list() -> None:
    lines = (RECORDINGS.parent / "SHA256SUMS").read_text().split("\n")
    listed = {path: checksum for checksum, path in (line.split() for line in lines if line)}
    for dataset in list_datasets():
        for path, checksum in dataset.files.items():
            assert listed[f"./{dataset.name}/{path}"] == checksum


def test_unknown_name_suggests_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'silver_box'.*Did you mean silverbox\?.*emps"):
        fetch("silver_box", tmp_path)


@needs_recordings
def test_wrong_local_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = _dataset("cascaded_tanks").sources[0]
    local = tmp_path / "data" / "cascaded_tanks" / source.path
    local.parent.mkdir(parents=True)
    raw = (RECORDINGS / "cascaded_tanks" / source.path).read_bytes()
    local.write_bytes(raw[:-1] + b"7")
    monkeypatch.setenv("JAXSR_DATA_DIR", str(tmp_path / "data"))
    with pytest.raises(InputError) as caught:
        fetch("cascaded_tanks", tmp_path / "out")
    message = str(caught.value)
    assert str(local) in message and source.sha256 in message
    assert len(re.findall(r"[0-9a-f]{64}", message)) == 2
    assert "\n" not in message
    assert not (tmp_path / "out").exists()


@needs_recordings
def test_download_is_checked_cached_and_converted(tanks_origin: Path, tmp_path: Path) -> None:
    first = fetch("cascaded_tanks", tmp_path / "out")
    assert [path.name for path in first] == [
        "tanks_train.csv",
        "tanks_validation.csv",
        "cascaded_tanks.toml",
    ]
    tanks_origin.unlink()  # the second time it comes from the cache
    second = fetch("cascaded_tanks", tmp_path / "again")
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()


@needs_recordings
def test_altered_download_is_refused(tanks_origin: Path, tmp_path: Path) -> None:
    tanks_origin.write_bytes(tanks_origin.read_bytes() + b"\n")
    with pytest.raises(InputError, match="wrong SHA-256"):
        fetch("cascaded_tanks", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@needs_recordings
def test_no_network_names_the_remedy(
    tanks_origin: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fetch_module, "ORIGIN", "http://127.0.0.1:9")  # nothing listens there
    with pytest.raises(InputError, match="Check the network, or set JAXSR_DATA_DIR") as caught:
        fetch("cascaded_tanks", tmp_path / "out")
    assert "\n" not in str(caught.value)


@needs_recordings
def test_file_missing_from_the_local_folder_is_downloaded(
    tanks_origin: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JAXSR_DATA_DIR", str(tmp_path / "empty"))
    assert len(fetch("cascaded_tanks", tmp_path / "out")) == 3


@needs_recordings
def test_nothing_is_left_beside_the_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JAXSR_DATA_DIR", str(RECORDINGS))
    paths = fetch("cascaded_tanks", tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {path.name for path in paths}


@needs_recordings
def test_failed_write_keeps_the_old_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JAXSR_DATA_DIR", str(RECORDINGS))
    out = tmp_path / "out"
    out.mkdir()
    (out / "tanks_train.csv").write_text("old")

    def full_disk(*args: object, **kwargs: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr(fetch_module.pd.DataFrame, "to_csv", full_disk)
    with pytest.raises(InputError, match="No space left"):
        fetch("cascaded_tanks", out)
    assert (out / "tanks_train.csv").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@needs_recordings
def test_target_that_is_a_file_is_one_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JAXSR_DATA_DIR", str(RECORDINGS))
    (tmp_path / "out").write_text("a file")
    with pytest.raises(InputError, match="Choose a writable directory"):
        fetch("cascaded_tanks", tmp_path / "out")
