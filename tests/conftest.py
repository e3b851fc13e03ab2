"""Shared by all tests: where real recordings are, figures without a display, seeded draws."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import hypothesis
import pytest

os.environ.setdefault("MPLBACKEND", "Agg")
if "PYTEST_XDIST_WORKER" in os.environ:  # the workers share the cores: one thread of BLAS each
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# Compilation makes first examples slow; the same draws everywhere make failures repeatable.
hypothesis.settings.register_profile("jaxsr", deadline=None, derandomize=True)
hypothesis.settings.load_profile("jaxsr")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile before workers start: once an installation, and no test's time is for that."""
    if not getattr(session.config.option, "numprocesses", None):
        return
    from jaxsr.diagnosis.likelihood.evidence import compile_modes
    from jaxsr.models.programs import compile_steps

    compile_steps()
    compile_modes()


gc.disable()  # until all tests are there


def pytest_collection_finish() -> None:
    """Spare the collector what stays to the end: libraries and tests, a million objects."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of real recordings beside the repository; the test is skipped without it."""
    folder = ROOT.parent / "shared" / "recordings"
    if not folder.is_dir():
        pytest.skip("real recordings are absent: ../shared/recordings")
    return folder


@pytest.fixture(scope="session")
def datasets_folder(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every data set, fetched from the local files into a folder of its name."""
    from jaxsr.datasets import fetch, list_datasets

    out = tmp_path_factory.mktemp("datasets")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAXSR_DATA_DIR", str(recordings))
        for dataset in list_datasets():
            fetch(dataset.name, out / dataset.name)
    return out
