"""Hostile and damaged recordings, seeded by their number."""

from __future__ import annotations

import gzip
import io
import struct
import zipfile
import zlib
from collections.abc import Callable

import numpy as np

Case = tuple[str, bytes]
"""Ending of the name, and content."""


def _csv(rng: np.random.Generator) -> bytes:
    t = np.arange(rng.integers(3, 60)) * 0.01
    rows = "".join(f"{a:.4g},{np.sin(a):.6g},{np.cos(a):.6g}\n" for a in t)
    text = "t,q,u\n" + rows
    style = rng.integers(6)
    if style == 1:
        text = text.replace(",", ";").replace(".", ",")
    elif style == 2:
        text = text.replace(",", "\t")
    elif style == 3:
        text = "# rig 7\n" + text.replace("u\n", "u\ns,rad,V\n", 1)
    elif style == 4:
        text = "time;q;u\n" + "".join(f"2024-03-01 12:00:{a:06.3f};{a};1\n" for a in t)
    return text.encode("utf-16" if style == 5 else "utf-8")


def _arrays(rng: np.random.Generator) -> dict[str, np.ndarray]:
    t = np.arange(rng.integers(3, 60)) * 0.01
    return {"t": t, "q": np.sin(t), "n": np.arange(t.size), "u": np.ones((t.size, 2))}


def _npz(rng: np.random.Generator) -> bytes:
    stream = io.BytesIO()
    (np.savez_compressed if rng.integers(2) else np.savez)(stream, **_arrays(rng))
    return stream.getvalue()


def _mat(rng: np.random.Generator) -> bytes:
    import scipy.io

    stream = io.BytesIO()
    form, compressed = ("5", "4")[rng.integers(2)], bool(rng.integers(2))
    arrays: dict = _arrays(rng)
    if form == "5":
        arrays |= {"s": {"a": 1.0, "b": "text"}, "c": np.array(["x", 2.0], dtype=object)}
    scipy.io.savemat(stream, arrays, format=form, do_compression=compressed and form == "5")
    return stream.getvalue()


def _parquet(rng: np.random.Generator) -> bytes:
    import pandas as pd

    arrays = {k: v for k, v in _arrays(rng).items() if v.ndim == 1}
    stream = io.BytesIO()
    kind = ("snappy", "gzip", None, "zstd")[rng.integers(4)]
    pd.DataFrame(arrays | {"note": "x"}).to_parquet(stream, compression=kind)
    return stream.getvalue()


def _xlsx(rng: np.random.Generator) -> bytes:
    import openpyxl

    book = openpyxl.Workbook()
    for row in [["t", "q"], *([float(i), float(rng.normal())] for i in range(6))]:
        book.active.append(row)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


SOUND: dict[str, Callable[[np.random.Generator], bytes]] = {
    ".csv": _csv,
    ".npz": _npz,
    ".mat": _mat,
    ".parquet": _parquet,
    ".xlsx": _xlsx,
}


def mutated(rng: np.random.Generator) -> Case:
    """Return a sound file with bytes changed, lost, doubled or added."""
    kind = list(SOUND)[rng.integers(len(SOUND))]
    raw = SOUND[kind](rng)
    if rng.random() < 0.15:
        kind, raw = kind + ".gz", gzip.compress(raw)
    data = bytearray(raw)
    for _ in range(rng.integers(1, 12)):
        at = int(rng.integers(len(data) + 1))
        size = int(rng.integers(1, 1 + min(200, len(data) or 1)))
        match rng.integers(7):
            case 0:
                del data[at:]
            case 1:
                del data[at : at + size]
            case 2:
                data[at:at] = data[at : at + size]
            case 3:
                data[at:at] = rng.bytes(size)
            case 4:
                data[at : at + 4] = struct.pack("<I", int(rng.integers(2**32)))
            case 5:
                data[at : at + 8] = b"\xff" * 8
            case _:
                for k in rng.integers(0, len(data) or 1, 3):
                    if k < len(data):
                        data[k] ^= 1 << int(rng.integers(8))
    return kind, bytes(data)


def noise(rng: np.random.Generator) -> Case:
    """Return random bytes under any name."""
    kinds = [*SOUND, ".txt", ".tsv", ".xlsm", ".csv.gz", ".mat.gz"]
    head = (b"", b"PK\x03\x04", b"PAR1", b"\x93NUMPY", b"MATLAB 5.0", b"\x1f\x8b\x08\x00")
    raw = head[rng.integers(len(head))] + rng.bytes(int(rng.integers(0, 4000)))
    return kinds[rng.integers(len(kinds))], raw


_CELLS = (
    *("1e999", "-1e999", "9" * 400, "1" + "0" * 5000, "inf", "-inf", "nan", "0x10", "1e", "1_000"),
    *("9223372036854775808", "-9223372036854775809", "18446744073709551615", "1e18", "1700000000"),
    *("1,5", "1.234,5", "1,234", "1.2.3", "--1", "+-1", "1e-400", "\u0661\u0662", "\uff11", "½"),
    *("9999-99-99", "2024-02-30", "0001-01-01", "99999-01-01", "03/04/2024", "2024-03-01 25:61:61"),
    *("12:34", "99:99:99", "12:34:56 PM", "1-Mar-2024", "Mar 1 2024", "2024-03-01T12:00:00+99:99"),
    *('"', '""', '"1', '1"', "'", "\x00", "\x1a", "\\", "=1+1", "#", "%", ";", "\t", "|", " " * 50),
    *(
        "n.a.",
        "-",
        "NULL",
        "True",
        "x" * 3000,
        "(" * 3000,
        "\u202e",
        "\ufeff",
        "\ud7ff",
        "0" * 3000,
    ),
)
_HEADERS = (
    *("t,q", "time_ms,q", "t [us],q", "Time (h),q", "time,q", "Date,q", ",q", "t;q", "t\tq", "t q"),
    *(
        "timestamp,q",
        "q",
        "sep=;\nt;q",
        "t,q\ns,m",
        "# t q",
        "t,t",
        "1,2",
        "",
        '"t","q"',
        "epoch_ns,q",
    ),
    *(
        "Date,Time,q",
        "t,q,,,",
        "t,q\n\n\n",
        "time_s,q",
        "t/min,q",
        "sep=",
        "t,q\n#",
        "a:b\nc:d\nt,q",
    ),
)


def odd_text(rng: np.random.Generator) -> Case:
    """Return a table with odd cells, headers and separators."""
    header = _HEADERS[rng.integers(len(_HEADERS))]
    separator = ";" if ";" in header else "\t" if "\t" in header else ","
    if rng.random() < 0.1:
        separator = (",", ";", "\t", " ", "|")[rng.integers(5)]
    columns = int(rng.integers(1, 5))
    share = rng.random() ** 2
    usual = _CELLS[rng.integers(len(_CELLS))]
    rows = []
    for i in range(int(rng.integers(1, 30))):
        cells = [str(i * 0.5)] + [f"{rng.normal():.4f}" for _ in range(columns - 1)]
        for k in range(columns):
            if rng.random() < share:
                cells[k] = usual if rng.random() < 0.5 else _CELLS[rng.integers(len(_CELLS))]
        rows.append(separator.join(cells))
    ends = ("\n", "\r\n", "\r", "\n\n", "\x0b", "\u2028")
    end = ends[0] if rng.random() < 0.7 else ends[rng.integers(len(ends))]
    text = header + "\n" + end.join(rows)
    codec = ("utf-8", "utf-8-sig", "utf-16", "utf-32", "utf-16-le")[min(rng.integers(20), 4)]
    return ".csv", text.encode(codec, "replace")


def huge(rng: np.random.Generator) -> Case:
    """Return what is small on the disk and large in memory, or slow."""
    n = int(rng.integers(1, 4))
    match rng.integers(22):
        case 0:
            return ".csv", b"t," + b"x" * 131073 * n + b"\n0,1\n1,2\n2,3\n"
        case 1:
            return ".csv", b't,"' + b"x" * 131073 * n + b'"\n0,1\n1,2\n2,3\n'
        case 2:
            names = ",".join(f"c{i}" for i in range(100_000))
            return ".csv", f"{names}\n{','.join(['1'] * 100_000)}\n".encode()
        case 3:
            return ".csv", b"t,q\n" + b"0,1," * 50_000 * n + b"\n1,2\n2,3\n"
        case 4:
            return ".csv", b"t,q\n0,1\n1,2\n2,3\n" + b"," * 300_000 * n
        case 5:
            return ".csv", b"," * 500_000 * n
        case 6:
            return ".csv", b"t,q\n" + b'"' * 300_001 * n
        case 7:
            return ".csv", b"t,q\n0," + b"1" * 500_000 * n + b"\n1,2\n2,3\n"
        case 8:
            return ".csv", b" " * 500_000 * n + b"\n" * 200_000
        case 9:
            fill = (b"\0", b"0,1\n", b",", b"\n")[rng.integers(4)]
            return ".csv.gz", gzip.compress(b"t,q\n" + fill * (40_000_000 * n // len(fill)), 6)
        case 10:
            return ".npz", _zipped({"t.npy": _npy((8_000_000 * n,)) + bytes(64_000_000 * n)})
        case 11:
            shapes = ((10**20,), (2**62,), (-1,), (10**9, 10**9), (0,), (3,) * 40, ())
            shape = shapes[rng.integers(len(shapes))]
            return ".npz", _zipped({"t.npy": _npy(shape) + bytes(80)})
        case 12:
            headers = ("-" * 5000, "{'descr':", "(" * 3000, "{" * 200, "9" * 5000, "[]", "1+1j")
            return ".npz", _zipped({"t.npy": _npy_raw(headers[rng.integers(len(headers))])})
        case 13:
            many = {f"a{i}.npy": _npy((3,)) + bytes(24) for i in range(3000)}
            return ".npz", _zipped(many)
        case 14:
            raw = bytearray(
                _zipped({"t.npy": _npy((3,)) + bytes(24), "q.npy": _npy((3,)) + bytes(24)})
            )
            central = raw.find(b"PK\x01\x02")
            raw[6] |= int(rng.integers(256))
            raw[central + 8] |= int(rng.integers(256))
            raw[central + 10] = int(rng.integers(100))
            return ".npz", bytes(raw)
        case 15:
            return ".mat", _mat_bomb(100_000_000 * n)
        case 16:
            return ".parquet", _parquet_bomb(20_000_000 * n)
        case 17:
            cells = '<c r="A1"><v>1</v></c>' * 200_000 * n
            return ".xlsx", _sheet(rng, f'<row r="1">{cells}</row>')
        case 18:
            return ".xlsx", _sheet(rng, '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row>')
        case 19:
            doctype = "".join(f'<!ENTITY a{i + 1} "{f"&a{i};" * 10}">' for i in range(12))
            return ".xlsx", _sheet(rng, "&a12;", f'<!DOCTYPE x [<!ENTITY a0 "ha">{doctype}]>')
        case 20:
            return ".xlsx", _sheet(rng, " " * 60_000_000 * n)
        case _:
            return ".csv", ("t,q\n" + "".join(f"{i},{i}x\n" for i in range(60_000))).encode()


def _npy_raw(header: str) -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def _npy(shape: tuple[int, ...]) -> bytes:
    return _npy_raw(f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape!r}}}")


def _zipped(members: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def _mat_bomb(size: int) -> bytes:
    flags = struct.pack("<IIII", 6, 8, 6, 0)
    shape = struct.pack("<IIii", 5, 8, 1, size // 8)
    name = struct.pack("<HHc3x", 1, 1, b"t")
    inner = flags + shape + name + struct.pack("<II", 9, size)
    pack = zlib.compressobj(9)
    body = pack.compress(struct.pack("<II", 14, len(inner) + size) + inner)
    body += pack.compress(bytes(size)) + pack.flush()
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2s", 0x0100, b"IM")
    return head + struct.pack("<II", 15, len(body)) + body


def _parquet_bomb(rows: int) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    one = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int8)), pa.array([0.0]))
    stream = io.BytesIO()
    pq.write_table(pa.table({"t": one.cast(pa.float64())}), stream)
    return stream.getvalue()


def _sheet(rng: np.random.Generator, data: str, doctype: str = "") -> bytes:
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    text = f'<?xml version="1.0"?>{doctype}<worksheet xmlns="{space}"><sheetData>{data}</sheetData>'
    members = {}
    with zipfile.ZipFile(io.BytesIO(_xlsx(rng))) as archive:
        for name in archive.namelist():
            members[name] = archive.read(name)
    members["xl/worksheets/sheet1.xml"] = (text + "</worksheet>").encode()
    return _zipped(members)


KINDS: tuple[tuple[float, Callable[[np.random.Generator], Case]], ...] = (
    (0.57, mutated),
    (0.10, noise),
    (0.30, odd_text),
    (0.03, huge),
)


def hostile(number: int) -> tuple[str, str, bytes]:
    """Return (kind of case, ending of the name, content) of a number."""
    rng = np.random.default_rng([32, number])
    shares, makers = zip(*KINDS, strict=True)
    make = makers[int(rng.choice(len(makers), p=shares))]
    return make.__name__, *make(rng)
