"""Reading files into recordings, and the errors that reading can meet."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

from jaxsr._result import InputError
from jaxsr.recordings import Recording, read_recording, rename, write_csv

TIME = np.array([0.0, 0.1, 0.25, 0.3])
Q = np.array([1.0, np.nan, 1e-17 + 1.0 / 3.0, -4.0])
V = np.array([0.0, 1.0, 2.0, 3.0])


def _text(tmp_path: Path, text: str, name: str = "a.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def _refused(path: Path, *words: str, **options) -> None:
    with pytest.raises(InputError) as error:
        read_recording(path, **options)
    message = str(error.value)
    assert "\n" not in message
    assert path.name in message
    for word in words:
        assert word in message


def _write(path: Path) -> None:
    table = {"t": TIME, "q": Q, "v": V}
    if path.suffix == ".csv":
        write_csv(Recording("x", TIME, {"q": Q, "v": V}), path)
    elif path.suffix == ".parquet":
        pd.DataFrame(table).to_parquet(path)
    elif path.suffix == ".npz":
        np.savez(path, **table, gain=3.0, table=np.ones((4, 2)), other=np.ones(7))
    else:
        scipy.io.savemat(path, table | {"gain": 3.0, "name": "rig", "table": np.ones((4, 2))})


@pytest.mark.parametrize("kind", ["csv", "parquet", "npz", "mat"])
def test_every_kind_of_file_gives_the_same_recording(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    _write(path)
    recording = read_recording(path)
    assert recording.name == path.name
    matrix = ["table_1", "table_2"] if kind in ("npz", "mat") else []
    assert list(recording.channels) == ["q", "v", *matrix]
    np.testing.assert_array_equal(recording.time, TIME)
    np.testing.assert_array_equal(recording.channel("q"), Q)
    np.testing.assert_array_equal(recording.channel("v"), V)
    assert recording.channel("v").dtype == np.float64
    assert recording.sha256 is not None
    assert len(recording.sha256) == 64


def test_csv_round_trip_is_exact(tmp_path):
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(1e-3, 1.0, 300))
    values = rng.normal(size=300) * 10.0 ** rng.integers(-300, 300, 300)
    path = tmp_path / "x.csv"
    write_csv(Recording("x", time, {"a b": values}), path, time="time_s")
    back = read_recording(path)
    np.testing.assert_array_equal(back.time, time)
    np.testing.assert_array_equal(back.channel("a b"), values)
    assert os.listdir(tmp_path) == ["x.csv"]


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("old")
    recording = Recording("x", TIME, {"t": V})
    with pytest.raises(InputError):
        write_csv(recording, path)
    assert path.read_text() == "old"
    with pytest.raises(InputError):
        write_csv(recording, tmp_path / "missing" / "x.csv", time="time")
    assert os.listdir(tmp_path) == ["x.csv"]


KILLED = """
import os, signal, sys
import numpy as np
from jaxsr.recordings import Recording, write_csv
os.replace = lambda *paths: os.kill(os.getpid(), signal.SIGKILL)
write_csv(Recording("x", np.arange(3.0), {"q": np.ones(3)}), sys.argv[1])
"""


def test_a_killed_write_leaves_no_litter_after_the_next(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("old")
    subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert path.read_text() == "old" and len(os.listdir(tmp_path)) == 2
    write_csv(Recording("x", TIME, {"q": Q}), path)
    assert os.listdir(tmp_path) == ["x.csv"]


@pytest.mark.parametrize(
    ("header", "time"),
    [("t,time,q", "t"), ("Time,TIME_S,q", "Time"), ("T [s],a,q", "T [s]"), ("a,Time (s),q", None)],
)
def test_the_time_column_is_found(tmp_path, header, time):
    path = _text(tmp_path, f"{header}\n1,1,0\n2,2,0\n3,3,0\n")
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.time, [1.0, 2.0, 3.0])
    assert time not in recording.channels
    assert len(recording.channels) == 2


def test_sample_time_makes_time_where_there_is_none(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"V1": np.arange(5.0), "V2": np.arange(5.0), "flag": np.uint8(1)})
    _refused(path, "no time column", "V1", "sample_time")
    recording = read_recording(path, sample_time=0.5)
    np.testing.assert_allclose(recording.time, [0.0, 0.5, 1.0, 1.5, 2.0])
    assert set(recording.channels) == {"V1", "V2"}


def test_semicolons_decimal_commas_tabs_and_byte_order_marks(tmp_path):
    semicolon = _text(tmp_path, "\ufefft;q\n0,5;1\n1,5;\n2,5;3\n", "a.csv")
    tab = _text(tmp_path, "t\tq\n0.5\t1\n1.5\t\n2.5\t3\n", "b.tsv")
    for path in (semicolon, tab):
        recording = read_recording(path)
        np.testing.assert_array_equal(recording.time, [0.5, 1.5, 2.5])
        np.testing.assert_array_equal(recording.channel("q"), [1.0, np.nan, 3.0])


def test_a_column_of_text_matters_only_when_it_is_used(tmp_path):
    path = _text(tmp_path, "t,note,q\n0,slow,1\n1,fast,2\n2,fast,3\n")
    recording = read_recording(path)
    assert list(recording.channels) == ["q"]
    with pytest.raises(InputError, match="'note' is not numeric: row 1 holds 'slow'"):
        recording.channel("note")
    renamed = rename(recording, {"x": "note"})
    with pytest.raises(InputError, match="note"):
        renamed.channel("x")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["empty"]),
        (" \n", ["empty"]),
        ("t,q\n", ["no samples"]),
        ("0.0,1.0\n0.1,2.0\n0.2,3.0\n", ["header"]),
        ("t,q\n0,1\n1,2\n", ["at least 3"]),
        ("t,q\n0,1\n1,x2\n2,3\n", ["'q'", "row 2", "x2"]),
        ("t,q\n0,1\n1,2\n1,3\n", ["row 3", "repeats row 2"]),
        ("t,q\n0,1\n2,2\n1,3\n", ["not increasing", "row 3", "2 s", "1 s"]),
        ("t,q\n0,1\n,2\n1,3\n", ["time is missing", "row 2"]),
        ("t,q,q\n0,1,1\n1,2,2\n2,3,3\n", ["'q' appears twice"]),
        ("t,q\n0,1,5\n1,2,5\n2,3,5\n", ["3 values", "2"]),
        ("t,q\n0,1\n1,2,5\n2,3\n", ["line 3"]),
        ("x,q\n0,1\n1,2\n2,3\n", ["no time column", "x, q"]),
        ("t,q\nslow,1\nfast,2\nfast,3\n", ["'t'", "row 1 holds 'slow'", "seconds"]),
    ],
)
def test_bad_csv_is_refused_in_one_line(tmp_path, text, words):
    _refused(_text(tmp_path, text), *words)


def test_bad_files_are_refused_in_one_line(tmp_path):
    _refused(tmp_path / "none.csv", "no such file")
    _refused(_text(tmp_path, "x", "a.dat"), "'.dat'", ".csv")
    _refused(_text(tmp_path, "no archive", "a.npz"), "npz")
    _refused(_text(tmp_path, "no archive" * 100, "a.mat"), ".mat")
    _refused(_text(tmp_path, "no table", "a.parquet"), "Parquet")
    _refused(_text(tmp_path, "t,q\n0,1\n1,2\n2,3\n"), "no time column 'clock'", time="clock")
    _refused(_text(tmp_path, "x,q\n0,1\n1,2\n2,3\n"), "sample_time", sample_time=-1.0)


class _Trap:
    """An object whose unpickling leaves a mark."""

    def __init__(self, mark: str) -> None:
        self.mark = mark

    def __reduce__(self):
        return (os.mkdir, (self.mark,))


def test_pickled_objects_are_never_loaded(tmp_path):
    mark = tmp_path / "mark"
    path = tmp_path / "a.npz"
    trap = np.array([_Trap(str(mark))], dtype=object)
    np.savez(path, t=TIME, q=trap)
    _refused(path, "pickled")
    path.write_bytes(pickle.dumps(_Trap(str(mark))))
    _refused(path)
    assert not mark.exists()


def test_channels_are_checked_when_used():
    nothing = np.full(4, np.nan)
    recording = Recording("r.csv", TIME, {"q": Q, "empty": nothing, "inf": [0, np.inf, 0, 0]})
    with pytest.raises(InputError, match=r"r\.csv: no column 'w'\. Available: q, empty, inf"):
        recording.channel("w")
    with pytest.raises(InputError, match="every sample of column 'empty' is missing"):
        recording.channel("empty")
    with pytest.raises(InputError, match="infinite at row 2"):
        recording.channel("inf")


def test_recordings_are_cut_and_renamed():
    recording = Recording("r", np.arange(10.0), {"a": np.arange(10.0), "b": -np.arange(10.0)})
    cut = recording.window(2.0, 5.5)
    np.testing.assert_array_equal(cut.time, [2.0, 3.0, 4.0, 5.0])
    np.testing.assert_array_equal(cut.channel("b"), [-2.0, -3.0, -4.0, -5.0])
    np.testing.assert_array_equal(recording.select([0, 4, 9]).channel("a"), [0.0, 4.0, 9.0])
    assert recording.sample_time == 1.0
    roles = rename(recording, {"b": "a", "c": "a"})
    np.testing.assert_array_equal(roles.channel("b"), recording.channel("a"))
    np.testing.assert_array_equal(roles.channel("c"), recording.channel("a"))
    assert set(roles.channels) == {"b", "c"}
    with pytest.raises(InputError, match="no column 'z' for 'q'"):
        rename(recording, {"q": "z"})
    with pytest.raises(InputError, match="shape"):
        Recording("r", np.arange(3.0), {"a": np.arange(4.0)})
    with pytest.raises(ValueError, match="read-only"):
        recording.channel("a")[0] = 1.0
