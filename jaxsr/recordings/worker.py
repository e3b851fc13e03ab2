"""Read binary recordings in a process of its own; run as a script, never imported.

What reads MATLAB, Parquet and Excel files is C, C++ or XML code that a damaged file can bring to a
segmentation fault, an endless loop or gigabytes. Here that costs a process with limits, not the
user's session. It imports nothing of the package, so that it starts quickly.

A request is a JSON line (kind, size, seconds of processor time, bytes of memory, numbers, and the
path of the file or null) and, without a path, `size` bytes: the file. The answer is a JSON line and
the columns it lists: float64, int64 or UTF-8 text.
"""

from __future__ import annotations

import csv
import datetime
import io
import json
import os
import signal
import sys
import time
import zipfile
from collections.abc import Callable
from typing import Any, BinaryIO

import numpy as np

LARGEST_MATRIX = 64
"""Columns of a matrix that are still channels, and not a picture or a state-space model."""


UNPACKED = 60_000_000
UNPACKED_PER_BYTE = 30
"""Bytes that a workbook may unpack to; its text shrinks five- to tenfold."""
LARGEST_IDLE = 250_000_000
"""Bytes that the process may keep between files; above, another one takes its place."""


class Refused(Exception):
    """What is wrong with the file, and the remedy."""

    def __init__(self, what: str, remedy: str = "") -> None:
        super().__init__(what)
        self.what, self.remedy = what, remedy


Answer = tuple[dict[str, np.ndarray], dict[str, str]]
"""Vectors and matrices by name; what is neither, with the reason."""


def read_npz(file: BinaryIO, numbers: int) -> Answer:
    """Return the arrays of a NumPy archive; pickled objects are never loaded."""
    remedy = "Write it with numpy.savez"
    if _head(file, 6) == b"\x93NUMPY":
        raise Refused("one array, not an .npz archive", "Use numpy.savez")
    try:
        with zipfile.ZipFile(file) as archive:
            members = {i.filename: i.file_size for i in archive.infolist()}
            encrypted = any(i.flag_bits & 0x1 for i in archive.infolist())
    except Exception as error:
        raise Refused("not an .npz archive", remedy) from error
    if encrypted:
        raise Refused("the archive is encrypted", "Save it without a password")
    if sum(members.values()) > 8 * numbers + 1_000_000:
        raise too_many(numbers)
    arrays: dict[str, np.ndarray] = {}
    odd: dict[str, str] = {}
    try:
        file.seek(0)
        archive = np.load(file, allow_pickle=False)
        for name in archive.files:
            value = archive[name]
            if isinstance(value, np.ndarray):
                arrays[name] = value
            else:
                odd[name] = "is not an array"
    except MemoryError:
        raise too_many(numbers) from None
    except Exception as error:
        if isinstance(error, ValueError) and "allow_pickle" in str(error):
            what = "holds pickled objects, which are never loaded"
            raise Refused(what, "Save numeric arrays only") from error
        raise Refused("a damaged .npz archive", remedy) from error
    return arrays, odd


def _head(file: BinaryIO, size: int) -> bytes:
    """Return the first bytes of a file, which stands at its begin again after that."""
    head = file.read(size)
    file.seek(0)
    return head


def read_mat(file: BinaryIO, numbers: int) -> Answer:
    """Return the arrays of a MATLAB file up to version 7."""
    import scipy.io

    try:
        found = scipy.io.loadmat(file)
    except NotImplementedError as error:
        remedy = "Save it in MATLAB with save(..., '-v7')"
        raise Refused("a version 7.3 .mat file", remedy) from error
    except MemoryError:
        raise too_many(numbers) from None
    except Exception as error:
        raise Refused("not a readable .mat file", "Save with -v7 in MATLAB") from error
    arrays = {k: v for k, v in found.items() if not k.startswith("__") and _plain(v)}
    odd = {
        k: "is no matrix of numbers" for k in found if not k.startswith("__") and k not in arrays
    }
    return arrays, odd


def _plain(value: object) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in "fiub"


def read_parquet(source: BinaryIO, numbers: int) -> Answer:
    """Return the columns of a Parquet file; what pandas calls its index is a column."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(source)
        if file.metadata.num_rows * max(file.metadata.num_columns, 1) > numbers:
            raise too_many(numbers)
        table = file.read(use_threads=False)
        columns: dict[str, np.ndarray] = {}
        odd: dict[str, str] = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            if name in columns or name in odd:
                raise Refused(f"column '{name[:80]}' appears twice", "Give each its own name")
            values = _from_arrow(pa, column)
            if values is None:
                odd[name] = f"is of type {str(column.type)[:40]}"
            else:
                columns[name] = values
    except Refused:
        raise
    except MemoryError:
        raise too_many(numbers) from None
    except Exception as error:
        raise Refused(f"not a Parquet file: {str(error)[:80]}") from error
    return columns, odd


def _from_arrow(pa: Any, column: Any) -> np.ndarray | None:
    """Return float64, int64, datetime64[ns] or text; None for anything else."""
    kind = column.type
    if pa.types.is_dictionary(kind):
        column = column.cast(kind.value_type)
        kind = column.type
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return np.array(["" if v is None else v for v in column.to_pylist()], dtype=object)
    if pa.types.is_date(kind):
        column = column.cast(pa.timestamp("s"))
        kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        whole = column.cast(pa.int64()).to_numpy()
        unit = "M8" if pa.types.is_timestamp(kind) else "m8"
        if whole.dtype != np.int64:
            whole = np.where(np.isnan(whole), np.iinfo(np.int64).min, whole).astype(np.int64)
        return whole.view(f"{unit}[{kind.unit}]")
    if pa.types.is_integer(kind) and column.null_count == 0:
        return column.to_numpy()
    if pa.types.is_boolean(kind):
        column = column.cast(pa.int8())
    elif not (
        pa.types.is_integer(kind)
        or pa.types.is_floating(kind)
        or pa.types.is_decimal(kind)
        or pa.types.is_null(kind)
    ):
        return None
    return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(), dtype=np.float64)


def read_xlsx(file: BinaryIO, size: int, numbers: int) -> tuple[list[str], str]:
    """Return the names of the sheets with rows, and the first such sheet as CSV text."""
    import openpyxl

    if _head(file, 4) == b"\xd0\xcf\x11\xe0":
        raise Refused("an old .xls workbook or one with a password", "Save it as plain .xlsx")
    try:
        with zipfile.ZipFile(file) as archive:
            unpacked = sum(i.file_size for i in archive.infolist())
        if unpacked > UNPACKED + UNPACKED_PER_BYTE * size:
            raise too_many(numbers)
        file.seek(0)
        book = openpyxl.load_workbook(file, read_only=True, data_only=True)
        texts = {}
        for sheet in book.worksheets:
            sheet.reset_dimensions()
            text = _sheet_text(sheet, numbers)
            if text:
                texts[str(sheet.title)] = text
    except Refused:
        raise
    except MemoryError:
        raise too_many(numbers) from None
    except Exception as error:
        raise Refused("not a readable .xlsx workbook", "Save it anew, or as CSV") from error
    if not texts:
        raise Refused("no sheet holds rows", "Give a sheet with a header and samples")
    return list(texts), next(iter(texts.values()))


def _sheet_text(sheet: Any, numbers: int) -> str:
    text = io.StringIO()
    write = csv.writer(text, lineterminator="\n").writerow
    cells = 0
    for row in sheet.iter_rows(values_only=True):
        cells += max(len(row), 1)
        if cells > numbers:
            raise too_many(numbers)
        values = [_cell_text(value) for value in row]
        if any(values):
            write(values)
    return text.getvalue()


def _cell_text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, datetime.timedelta):
        return repr(value.total_seconds())
    if isinstance(value, datetime.datetime | datetime.time):
        return value.isoformat()
    return str(value)


READERS: dict[str, Callable[[BinaryIO, int], Answer]] = {
    ".npz": read_npz,
    ".mat": read_mat,
    ".parquet": read_parquet,
}


def too_many(numbers: int) -> Refused:
    """Return the refusal of a file that unpacks to more than its size can account for."""
    return Refused(
        f"is damaged, or unpacks to more than {numbers} numbers, far beyond its size",
        "Save it as CSV, or without compression",
    )


def channels(arrays: dict[str, np.ndarray], odd: dict[str, str]) -> dict[str, np.ndarray]:
    """Return vectors as they are, and the columns of matrices as ``NAME_1, NAME_2, ...``.

    A matrix counts as channels when one of its sides is as long as a vector (without vectors:
    when it is long and narrow).
    """
    vectors = {k: v.ravel() for k, v in arrays.items() if v.size > 1 and max(v.shape) == v.size}
    lengths = {v.size for v in vectors.values()}
    found = {}
    for name, array in arrays.items():
        if name in vectors:
            found[name] = vectors[name]
            continue
        tall = _tall(array, lengths)
        if tall is None:
            odd[name] = f"has shape {array.shape}, not that of a channel"
            continue
        for k in range(tall.shape[1]):
            column = f"{name}_{k + 1}"
            if column not in arrays:
                found[column] = tall[:, k]
    return found


def _tall(array: np.ndarray, lengths: set[int]) -> np.ndarray | None:
    if array.ndim != 2 or min(array.shape) < 2 or min(array.shape) > LARGEST_MATRIX:
        return None
    if lengths & set(array.shape):
        return array if array.shape[0] in lengths else array.T
    if not lengths and max(array.shape) > 2 * min(array.shape):
        return array if array.shape[0] > array.shape[1] else array.T
    return None


def packed(values: np.ndarray) -> tuple[str, memoryview] | None:
    """Return the kind of a column and its bytes; None if it holds no real numbers or text."""
    if values.dtype.kind in "Mm":
        whole = values.astype(f"{values.dtype.kind}8[ns]")
        return ("instant" if values.dtype.kind == "M" else "span"), _bytes_of(whole, np.int64)
    if values.dtype.kind in "OU":
        return "text", memoryview(json.dumps([str(v) for v in values]).encode())
    if values.dtype.kind in "iu" and values.dtype.itemsize <= 8 and values.dtype != np.uint64:
        return "int64", _bytes_of(values, np.int64)
    if values.dtype.kind in "fiub":
        return "float64", _bytes_of(values, np.float64)
    return None


def _bytes_of(values: np.ndarray, kind: type[np.generic]) -> memoryview:
    """Return the bytes of a vector as another type, copied only where it is not of it yet."""
    flat = np.ascontiguousarray(values.astype(kind, copy=False))
    return flat.view(np.uint8).data


def answer(
    kind: str, file: BinaryIO, size: int, numbers: int
) -> tuple[dict[str, Any], list[memoryview]]:
    """Return the head of the answer and the bytes after it."""
    if kind == ".xlsx":
        sheets, text = read_xlsx(file, size, numbers)
        body = memoryview(text.encode("utf-8", "replace"))
        return {"sheets": sheets, "columns": [["", "csv", len(body)]]}, [body]
    arrays, odd = READERS[kind](file, numbers)
    columns, bodies, total = [], [], 0
    for name, values in channels(arrays, odd).items():
        total += values.size
        if total > numbers:
            raise too_many(numbers)
        packet = packed(values)
        if packet is None:
            odd[name] = "is no vector of numbers"
            continue
        columns.append([name, packet[0], packet[1].nbytes])
        bodies.append(packet[1])
    return {"columns": columns, "odd": odd}, bodies


def limit(seconds: float, memory: int) -> None:
    """Bound what the next file may cost; too much time ends the process."""
    try:
        import resource

        signal.setitimer(signal.ITIMER_PROF, seconds)
        now = _status(0)
        if not now:
            return
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        bound = now + memory if hard == resource.RLIM_INFINITY else min(now + memory, hard)
        resource.setrlimit(resource.RLIMIT_AS, (bound, hard))
    except (ImportError, AttributeError, OSError, ValueError):
        return  # a system without such limits


def _status(field: int) -> int:
    """Return the bytes of address space (0) or of memory (1) in use; 0 where it is not known."""
    try:
        with open("/proc/self/statm") as status:
            return int(status.read().split()[field]) * os.sysconf("SC_PAGESIZE")
    except (OSError, ValueError, IndexError, AttributeError):
        return 0


def prepare(kind: str) -> None:
    """Import what a kind needs before its limits begin."""
    if kind == ".mat":
        import scipy.io  # noqa: F401
    elif kind == ".parquet":
        import pyarrow.parquet  # noqa: F401
    elif kind == ".xlsx":
        import openpyxl  # noqa: F401


def serve() -> None:
    """Answer requests until there are no more."""
    source, sink = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    # whatever a library prints must not get between the answers
    os.dup2(2, 1)
    while line := source.readline():
        request = json.loads(line)
        prepare(request["kind"])
        limit(request["seconds"], request["memory"])
        sent = io.BytesIO(source.read(request["size"])) if request["path"] is None else None
        try:
            with sent or open(request["path"], "rb") as file:
                asked = request["kind"], file, request["size"], request["numbers"]
                head, bodies = answer(*asked)
        except Refused as error:
            head, bodies = {"refused": error.what, "remedy": error.remedy}, []
        except MemoryError:
            error = too_many(request["numbers"])
            head, bodies = {"refused": error.what, "remedy": error.remedy}, []
        except Exception as error:
            head, bodies = {"refused": f"cannot be read ({type(error).__name__})"}, []
        told = {**head, "used": time.process_time()}
        sink.write(json.dumps(told).encode() + b"\n")
        for body in bodies:
            sink.write(body)
        sink.flush()
        limit(0.0, 1 << 40)
        if _status(1) > LARGEST_IDLE:
            return


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C ends
    serve()
