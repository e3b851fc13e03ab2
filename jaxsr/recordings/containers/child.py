"""The process that reads one file of a container format; run as a script, never imported.

    python -P child.py KIND PATH

It writes an uncompressed ``.npz`` on standard output: ``header`` (JSON in UTF-8: name, unit, number
of the time, number of the values) and the vectors. What is wrong with a file goes to standard error
as a line of JSON.
"""

from __future__ import annotations

import importlib
import io
import json
import sys
from pathlib import Path

import numpy as np

KINDS = {
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".tdms": "tdms",
    ".mf4": "mdf4",
    ".mcap": "mcap_file",
    ".bag": "bag",
    ".db3": "bag",
}


def main(kind: str, path: str) -> int:
    """Read a file; return the exit status."""
    sys.path.insert(0, str(Path(__file__).parent))
    try:
        channels = importlib.import_module(KINDS[kind]).read(path)
    except ImportError as error:
        return _refused({"missing": error.name or str(error)})
    except Exception as error:
        return _refused({"wrong": f"{type(error).__name__}: {error}"[:200]})
    arrays: dict[str, np.ndarray] = {}
    header, known = [], dict[int, str]()
    for number, (name, time, values, unit) in enumerate(channels):
        values = np.asarray(values)
        if values.ndim != 1 or values.dtype.kind not in "fiubM" or not values.size:
            continue
        clock = None
        if time is not None:
            clock = known.setdefault(id(time), f"t{number}")
            arrays[clock] = np.asarray(time)
        arrays[f"v{number}"] = values.astype("M8[ns]") if values.dtype.kind == "M" else values
        header.append([name, unit, clock, f"v{number}"])
    out = io.BytesIO()
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(out, allow_pickle=False, **arrays)
    sys.stdout.buffer.write(out.getvalue())
    return 0


def _refused(why: dict[str, str]) -> int:
    print(json.dumps(why), file=sys.stderr)
    return 3


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
