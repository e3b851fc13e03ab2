"""Tables as people have them: each form is read to the same numbers, and said."""

import gzip
import hashlib
import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

from jaxsr._result import InputError
from jaxsr.recordings import check_recording, read_recording

TIME = np.array([0.0, 0.5, 1.0, 1.5])
Q = np.array([1.5, -2.25, np.nan, 1234.5])


def _file(tmp_path: Path, content: str | bytes, name: str = "a.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
    return path


def _said(recording) -> str:
    return " | ".join(r.message for r in recording.remarks)


PLAIN = "t,q\n0,1.5\n0.5,-2.25\n1.0,\n1.5,1234.5\n"
GERMAN = PLAIN.replace(",", ";").replace(".", ",")
TABS = GERMAN.replace(";", "\t")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (PLAIN, []),
        (PLAIN.replace("\n", "\r\n"), []),
        (PLAIN.replace("\n", "\r"), []),
        ("\n\n" + PLAIN, []),
        (PLAIN + "\x1a", []),
        (PLAIN + ",\n,\n", []),
        (PLAIN + "\x00" * 600, []),
        (PLAIN.replace("\n", ",,\n"), []),
        (PLAIN.replace("q\n", "q,\n").replace("5\n", "5,\n").replace("1.0,\n", "1.0,,\n"), []),
        (PLAIN.encode("utf-8-sig"), []),
        (GERMAN, ["semicolons", "decimal commas"]),
        ("sep=;\n" + GERMAN, ["decimal commas"]),
        (TABS, ["tabs", "decimal commas"]),
        (TABS.encode("utf-16"), ["UTF-16", "tabs", "decimal commas"]),
        (TABS.encode("utf-16-le"), ["UTF-16"]),
        (b"\xfe\xff" + TABS.encode("utf-16-be"), ["UTF-16"]),
        ('t,q\n"0","1,5"\n"0,5","-2,25"\n"1,0",""\n"1,5","1234,5"\n', ["decimal commas"]),
        ("t;q\n0;1,5\n0,5;-2,25\n1;\n1,5;1.234,5\n", ["decimal commas"]),
        ('t,q\n0,"1.5"\n0.5,-2.25\n1,\n1.5,"1,234.5"\n', []),
        ("t q\n0 1.5\n0.5 -2.25\n1.0 nan\n1.5 1234.5\n", ["blanks"]),
        ("# t   q\n 0.0   1.5\n 0.5  -2.25\n 1.0    NaN\n 1.5  1234.5 \n", ["blanks"]),
        ("Time [s]  q\n0  1.5\n0.5  -2.25\n1.0  n.a.\n1.5  1234.5\n", ["blanks"]),
        ("# rig 7, by hand\n# second line\n" + PLAIN, ["2 lines above the header"]),
        ("Device: rig 7\nRate: 2 Hz\n\n" + PLAIN, ["2 lines above the header"]),
        ("Device;rig 7\nRate;2\nGain;3\n" + GERMAN, ["3 lines above the header"]),
        ("Device,rig\nDate,2024-03-01\n" + PLAIN, ["2 lines above the header"]),
        (PLAIN.replace("q\n", "q\ns,rad\n"), ["a row of units (t in s, q in rad)"]),
        (PLAIN.replace("q\n", "q\n[s],[m/s^2]\n"), ["a row of units"]),
        (PLAIN.replace("q\n", "q\ns,1\n"), ["a row of units"]),
        (PLAIN.replace("q\n", "q\n(s),\n\n"), ["a row of units"]),
        ("Rig 7\n" + PLAIN.replace("q\n", "q\ns,deg\n"), ["1 line above", "row of units"]),
    ],
)
def test_forms_of_text_give_the_same_numbers(tmp_path, content, words):
    recording = read_recording(_file(tmp_path, content))
    np.testing.assert_array_equal(recording.time, TIME)
    np.testing.assert_array_equal(recording.channel("q"), Q)
    assert list(recording.channels) == ["q"]
    for word in words:
        assert word in _said(recording)
    assert bool(words) == bool(recording.remarks)
    said = [c.message for c in check_recording(recording)]
    assert all(r.message in said for r in recording.remarks)


def test_latin_1_names_are_kept(tmp_path):
    path = _file(tmp_path, "t;Öffnung/°\n0;1\n1;2\n2;3\n".encode("latin-1"))
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.channel("Öffnung/°"), [1.0, 2.0, 3.0])
    assert "Latin-1" in _said(recording)


def test_names_with_blanks_units_and_slashes_are_kept(tmp_path):
    names = ["Angle/rad", "RPM (1/min)", "Torque [N m]", "a b"]
    content = f"Time (s),{','.join(names)}\n" + "".join(f"{i},1,2,3,{i}\n" for i in range(4))
    assert list(read_recording(_file(tmp_path, content)).channels) == names


@pytest.mark.parametrize("word", ["n.a.", "NaN", "-", "N/A", "#N/A", "null", "--", "1.#QNAN", "NV"])
@pytest.mark.parametrize("separator", [",", ";"])
def test_a_word_for_a_missing_sample_is_one(tmp_path, word, separator):
    text = f"t,q,v\n0,1.5,1\n0.5,{word},2\n1.0,2.5,3\n"
    if separator == ";":
        text = text.replace(word, "@").replace(",", ";").replace(".", ",").replace("@", word)
    recording = read_recording(_file(tmp_path, text))
    np.testing.assert_array_equal(recording.channel("q"), [1.5, np.nan, 2.5])
    np.testing.assert_array_equal(recording.channel("v"), [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    "text", ["t,q\n0,1.5\n0.5,2\n1.0,x7\n1.5,n.a.\n", "t;q\n0;1,5\n0,5;2\n1;x7\n2;-\n"]
)
def test_an_odd_cell_is_named_with_its_row(tmp_path, text):
    with pytest.raises(InputError, match="row 3 holds 'x7'"):
        read_recording(_file(tmp_path, text))


@pytest.mark.parametrize(
    ("header", "factor", "said"),
    [
        ("time_ms,q", 1e-3, "milliseconds"),
        ("t [us],q", 1e-6, "microseconds"),
        ("Time (µs),q", 1e-6, "microseconds"),
        ("Time/ms,q", 1e-3, "milliseconds"),
        ("elapsed time [min],q", 60.0, "minutes"),
        ("t,q\nms,rad", 1e-3, "milliseconds"),
        ("Time,q\n[ns],[V]", 1e-9, "nanoseconds"),
        ("t,q\ns,rad", 1.0, ""),
        ("Source,q\nSecond,Volt", 1.0, ""),
        ("time_s,q", 1.0, ""),
    ],
)
def test_time_is_read_in_the_unit_that_the_header_states(tmp_path, header, factor, said):
    rows = "".join(f"{10 * i},{i}.5\n" for i in range(5))
    recording = read_recording(_file(tmp_path, f"{header}\n{rows}"))
    np.testing.assert_allclose(recording.time, 10.0 * factor * np.arange(5), rtol=1e-15)
    assert said in _said(recording)
    assert recording.time_stated


def test_a_named_time_column_is_read_in_the_unit_of_its_name(tmp_path):
    path = _file(tmp_path, "ticks_ms,q\n0,1\n10,2\n20,3\n")
    recording = read_recording(path, time="ticks_ms")
    np.testing.assert_array_equal(recording.time, [0.0, 0.01, 0.02])


@pytest.mark.parametrize(
    ("column", "said"),
    [
        (
            ["2024-03-01 12:00:00.0", "2024-03-01 12:00:00.5", "2024-03-01 12:00:01.25"],
            "2024-03-01",
        ),
        (["2024-03-01T12:00:00Z", "2024-03-01T12:00:00.5Z", "2024-03-01T12:00:01.25Z"], "2024"),
        (["2024/3/1 9:59:59.5", "2024/3/1 10:00:00", "2024/3/1 10:00:00.75"], "year-month-day"),
        (["01.03.2024 12:00:00", "01.03.2024 12:00:00.5", "01.03.2024 12:00:01.25"], "day.month"),
        (["13/03/2024 12:00:00", "13/03/2024 12:00:00.5", "13/03/2024 12:00:01.25"], "day/month"),
        (["03/13/2024 12:00:00", "03/13/2024 12:00:00.5", "03/13/2024 12:00:01.25"], "month/day"),
        (["03/04/2024 12:00:00", "03/04/2024 12:00:00.5", "03/04/2024 12:00:01.25"], "one day"),
        (["03/13/2024 1:00:00 PM", "03/13/2024 1:00:00.5 PM", "03/13/2024 1:00:01.25 PM"], "13:00"),
        (["1-Mar-2024 12:00:00", "1-Mar-2024 12:00:00.5", "1-Mar-2024 12:00:01.25"], "2024-03-01"),
        (["12:00:00", "12:00:00.500", "12:00:01.250"], "clock"),
        (["23:59:59.500", "00:00:00", "00:00:00.75"], "midnight"),
        (["00:01.0", "00:01.5", "00:02.25"], "minutes and seconds"),
    ],
)
@pytest.mark.parametrize("name", ["Time", "Date", "", "stamp"])
def test_dates_and_clock_times_are_seconds_from_the_first_sample(tmp_path, column, said, name):
    rows = "".join(f"{cell};{i},5\n" for i, cell in enumerate(column))
    recording = read_recording(_file(tmp_path, f"{name};q\n{rows}"))
    np.testing.assert_allclose(recording.time, [0.0, 0.5, 1.25], atol=1e-9)
    np.testing.assert_array_equal(recording.channel("q"), [0.5, 1.5, 2.5])
    assert said in _said(recording)
    assert "first sample" in _said(recording)


def test_a_date_and_a_clock_column_are_one_time(tmp_path):
    text = "Date,Time,q\n2024-03-01,23:59:59,1\n2024-03-02,00:00:00,2\n2024-03-02,00:00:01,3\n"
    recording = read_recording(_file(tmp_path, text))
    np.testing.assert_array_equal(recording.time, [0.0, 1.0, 2.0])
    assert not recording.set_aside


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_times_since_1970_keep_their_digits(tmp_path, unit):
    scale = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    ns = 1_700_000_000_123_000_000 + 1_250_000 * np.arange(50)
    if unit == "s":
        cells = [f"{n // 10**9}.{n % 10**9:09d}" for n in ns]
    elif unit == "ms":
        cells = [f"{n // 10**6}.{n % 10**6:06d}" for n in ns]
    else:
        cells = [str(int(n) * scale // 10**9) for n in ns]
    text = "timestamp,q\n" + "".join(f"{c},{i}\n" for i, c in enumerate(cells))
    recording = read_recording(_file(tmp_path, text))
    np.testing.assert_allclose(recording.time, 1.25e-3 * np.arange(50), atol=1e-12)
    assert "since 1970" in _said(recording)


def test_a_large_offset_that_is_no_date_is_kept(tmp_path):
    text = "t,q\n" + "".join(f"{1e8 + i / 4},{i}\n" for i in range(8))
    recording = read_recording(_file(tmp_path, text))
    np.testing.assert_array_equal(recording.time, 1e8 + np.arange(8) / 4)


@pytest.mark.parametrize(
    ("text", "readings"),
    [
        ("t;q\n0;1,234\n1;2,345\n2;3,456\n", ["1.234", "1234"]),
        ('t,q\n0,"1,234"\n1,"2,345"\n2,"3,456"\n', ["1.234", "1234"]),
        ("t;q\n0,5;1.234\n1,5;2.345\n2,5;3.456\n", ["1.234", "1234"]),
        ("t,q\n03/04/2024,1\n04/04/2024,2\n05/04/2024,3\n", ["2024-04-03", "2024-03-04"]),
        ("t,q\n12:30,1\n12:31,2\n12:32,3\n", ["hours and minutes", "minutes and seconds"]),
        ("time_s,q\n1700000000000,1\n1700000000010,2\n1700000000020,3\n", ["milliseconds", "name"]),
    ],
)
def test_what_can_be_read_in_two_ways_is_refused_with_both(tmp_path, text, readings):
    with pytest.raises(InputError) as error:
        read_recording(_file(tmp_path, text))
    for reading in readings:
        assert reading in str(error.value)


def test_one_sure_cell_settles_the_decimal_sign_of_the_file(tmp_path):
    recording = read_recording(_file(tmp_path, "t;q\n0,5;1,234\n1,5;2,345\n2,5;3,456\n"))
    np.testing.assert_array_equal(recording.channel("q"), [1.234, 2.345, 3.456])


def test_a_restarted_clock_has_its_own_remedy(tmp_path):
    rows = "".join(f"{t},{t}\n" for t in [*range(20), *range(20)])
    with pytest.raises(InputError, match=r"time goes back once.*row 21.*its own file") as error:
        read_recording(_file(tmp_path, "t,q\n" + rows))
    assert "Sort" not in str(error.value)
    with pytest.raises(InputError, match="Sort the rows"):
        read_recording(_file(tmp_path, "t,q\n" + "".join(f"{t},0\n" for t in (0, 2, 1, 3, 4))))


@pytest.mark.parametrize("name", ["a.csv.gz", "a.npz.gz", "a.mat.gz", "a.parquet.gz"])
def test_compressed_files_are_read(tmp_path, name):
    if ".csv" in name:
        content = PLAIN.encode()
    else:
        stream = io.BytesIO()
        if ".npz" in name:
            np.savez(stream, t=TIME, q=Q)
        elif ".mat" in name:
            scipy.io.savemat(stream, {"t": TIME, "q": Q})
        else:
            pd.DataFrame({"t": TIME, "q": Q}).to_parquet(stream)
        content = stream.getvalue()
    recording = read_recording(_file(tmp_path, gzip.compress(content), name))
    np.testing.assert_array_equal(recording.time, TIME)
    np.testing.assert_array_equal(recording.channel("q"), Q)


def test_workbooks_are_read_like_text(tmp_path):
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    for row in (["Rig 7"], [], ["Time", "q", "note"], ["ms", "rad", None]):
        sheet.append(row)
    for t, q in zip(TIME, Q, strict=True):
        sheet.append([1000.0 * t, None if np.isnan(q) else q, "x"])
    path = tmp_path / "a.xlsx"
    book.save(path)
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.time, TIME)
    np.testing.assert_array_equal(recording.channel("q"), Q)
    assert "row of units" in _said(recording) and "milliseconds" in _said(recording)
    other = book.create_sheet("second")
    other.append(["t", "q"])
    book.save(path)
    with pytest.raises(InputError, match="2 sheets hold rows: Sheet, second"):
        read_recording(path)


def test_dates_in_workbooks_and_parquet_are_time(tmp_path):
    import openpyxl

    instants = pd.Timestamp("2024-03-01 12:00") + pd.to_timedelta([0.0, 0.5, 1.25], unit="s")
    book = openpyxl.Workbook()
    for row in (["when", "q"], *([i.to_pydatetime(), 1.5] for i in instants)):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    pd.DataFrame({"time": instants, "q": 1.5}).to_parquet(tmp_path / "b.parquet")
    pd.DataFrame({"q": [1.5] * 3}, index=pd.Index(instants, name="t")).to_parquet(
        tmp_path / "c.parquet"
    )
    for name in ("a.xlsx", "b.parquet", "c.parquet"):
        recording = read_recording(tmp_path / name)
        np.testing.assert_allclose(recording.time, [0.0, 0.5, 1.25], atol=1e-3)
        assert list(recording.channels) == ["q"]
        assert "2024-03-01 12:00" in _said(recording)


def test_matrices_of_mat_files_are_channels(tmp_path):
    path = tmp_path / "a.mat"
    table = {"t": TIME[:, None], "q": Q[None, :], "y": np.arange(8.0).reshape(4, 2), "A": np.eye(2)}
    scipy.io.savemat(path, table | {"s": {"a": 1.0}, "u": np.arange(12).reshape(3, 4)})
    recording = read_recording(path)
    assert list(recording.channels) == ["q", "y_1", "y_2", "u_1", "u_2", "u_3"]
    np.testing.assert_array_equal(recording.channel("y_2"), [1.0, 3.0, 5.0, 7.0])
    np.testing.assert_array_equal(recording.channel("u_2"), [4.0, 5.0, 6.0, 7.0])
    with pytest.raises(InputError, match="shape"):
        recording.channel("A")


def test_a_sample_time_stands_in_for_dates_that_repeat(tmp_path):
    text = "date,epoch,q\n2024-03-01,1,1\n2024-03-01,1,2\n2024-03-02,2,3\n"
    recording = read_recording(_file(tmp_path, text), sample_time=0.5)
    np.testing.assert_array_equal(recording.time, [0.0, 0.5, 1.0])
    assert list(recording.channels) == ["epoch", "q"]


@pytest.mark.parametrize(("separator", "comma"), [(",", False), (";", False), (";", True)])
@pytest.mark.parametrize("every", [2, 3, 10])
def test_a_column_that_most_rows_leave_empty_is_a_column(tmp_path, separator, comma, every):
    """Times like 1 make rows such as '1,' that are numbers without a separator, too."""
    values = np.where(np.arange(200) % every == 0, np.cos(np.arange(200.0)), np.nan)
    rows = [
        f"{i / 100:g}{separator}{'' if np.isnan(y) else f'{y:.9g}'}" for i, y in enumerate(values)
    ]
    text = f"t{separator}y\n" + "\n".join(rows) + "\n"
    path = _file(tmp_path, text.replace(".", ",") if comma else text)
    read = read_recording(path)
    np.testing.assert_allclose(read.time, np.arange(200) / 100)
    np.testing.assert_allclose(read.channel("y"), values, rtol=1e-8)


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int64, ">f8"])
@pytest.mark.parametrize("packed", [False, True])
def test_binary_channels_are_numbers_that_nobody_can_write_to(
    tmp_path: Path, kind: type, packed: bool
) -> None:
    """Whether they were copied on their way, as other kinds of number are, or not."""
    held = io.BytesIO()
    values = np.arange(20).astype(kind)
    np.savez(held, t=0.1 * np.arange(20), y=values)
    path = tmp_path / ("run.npz.gz" if packed else "run.npz")
    path.write_bytes(gzip.compress(held.getvalue()) if packed else held.getvalue())
    found = read_recording(path)
    for column in (found.time, found.channels["y"]):
        assert column.dtype == np.float64 and not column.flags.writeable
    np.testing.assert_array_equal(found.channels["y"], values)
    assert found.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
