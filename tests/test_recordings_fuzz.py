"""Hostile and damaged recordings end in one line each: no other exception, no hang, no death."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxsr
from jaxsr._result import InputError
from jaxsr.recordings import read_recording
from jaxsr.recordings.isolated import READER

SCRIPT = Path(__file__).with_name("fuzz_recordings.py")
LONG = int(os.environ.get("JAXSR_FUZZ_RECORDINGS", "4000"))
"""Cases of the long run, up to 20,000."""
SHORT, BATCH = 100, 500


def _run(first: int, last: int, folder: Path) -> list[dict]:
    """Read cases in a process of their own; return what was not right."""
    root = str(Path(jaxsr.__file__).parents[1])
    done = subprocess.run(
        [sys.executable, str(SCRIPT), str(first), str(last), str(folder)],
        capture_output=True,
        text=True,
        timeout=3600,
        env=os.environ | {"PYTHONPATH": root},
    )
    now = (folder / "now").read_text()
    assert done.returncode == 0, f"ended by {done.returncode} at case {now}: {done.stderr[-2000:]}"
    return [json.loads(line) for line in done.stdout.splitlines()[:-1]]


def test_hostile_recordings_are_refused_in_one_line(tmp_path):
    assert _run(0, SHORT, tmp_path) == []


@pytest.mark.slow
def test_many_hostile_recordings_are_refused_in_one_line(tmp_path):
    for first in range(SHORT, LONG, BATCH):
        assert _run(first, min(first + BATCH, LONG), tmp_path) == []


def test_a_file_that_ends_the_reading_process_spoils_no_other(tmp_path):
    t = np.arange(5.0)
    np.savez(tmp_path / "sound.npz", t=t, q=t)
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 no archive")
    for _ in range(3):
        assert len(read_recording(tmp_path / "sound.npz")) == 5
        with pytest.raises(InputError, match=r"bad\.npz"):
            read_recording(tmp_path / "bad.npz")
        process = READER._process
        assert process is not None
        process.kill()
        process.wait()


def test_a_hundred_thousand_columns_are_refused_at_once(tmp_path):
    path = tmp_path / "a.csv"
    names = ",".join(f"c{i}" for i in range(100_000))
    path.write_text(f"{names}\n" + (",".join(["1"] * 100_000) + "\n") * 3)
    with pytest.raises(InputError, match="more than 10000 columns"):
        read_recording(path)


def test_a_few_thousand_columns_are_read(tmp_path):
    path = tmp_path / "a.csv"
    names = ",".join(["t", *(f"c{i}" for i in range(5000))])
    path.write_text(names + "\n" + "".join(f"{i}" + ",1" * 5000 + "\n" for i in range(4)))
    recording = read_recording(path)
    assert len(recording.channels) == 5000
    with pytest.raises(InputError) as error:
        recording.channel("none")
    assert len(str(error.value)) < 600
