"""The cases of a batch as CASES.toml lists them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from jaxsr._quoting import quoted
from jaxsr._result import InputError
from jaxsr.batch.cases import Case, check_name
from jaxsr.batch.islands import Islands
from jaxsr.models.document import read_document

AnyCase = Case | Islands

_PATHS = ("data", "validation", "held_out")
_FILES = ("units", "known")
_NAMES = ("states", "derivatives", "inputs")
_LIMITS = ("budget", "memory")
_KEYS = {
    "diagnose": ("model", "data", "held_out", "seed", *_LIMITS, "machine", "date"),
    "discover": (
        *(*_PATHS, *_NAMES, "order", "time", "columns", *_FILES),
        *("modes", "seed", "seeds", *_LIMITS),
    ),
}


def read_cases(path: str | Path) -> dict[str, AnyCase]:
    """Read CASES.toml.

    Parameters
    ----------
    path : path
        TOML with a table ``[cases.NAME]`` for every case: the fields of `Case`, or with
        ``command = "discover"`` those of `Islands`; paths relative to the file's folder.
        ``[defaults]`` holds what a case does not say.

    Raises
    ------
    InputError
        The file is no such TOML; it names Python, which runs only where a call names it.
    """
    path = Path(path)
    document = read_document(path)
    unknown = [key for key in document if key not in ("defaults", "cases")]
    if unknown:
        what = f"unknown table {quoted(unknown[0])}"
        raise InputError(what, path.name, "Write [defaults] and [cases.NAME]")
    tables = _table(document.get("cases", {}), path.name, "[cases.NAME]")
    defaults = _table(document.get("defaults", {}), path.name, "[defaults]")
    if not tables:
        raise InputError("no case", path.name, "Write [cases.NAME] with model and data")
    every = ["command", *_KEYS["diagnose"], *_KEYS["discover"]]
    _known(defaults, every, f"{path.name} [defaults]")
    return {
        check_name(name, path.name): _case(
            _table(row, path.name, f"[cases.{name}]"), defaults, path, f"[cases.{name}]"
        )
        for name, row in tables.items()
    }


def _table(value: Any, file: str, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(
            f"must be a table, got {quoted(value)}", f"{file} {where}", "Write a table"
        )
    return cast("Mapping[str, Any]", value)


def _known(row: Mapping[str, Any], keys: list[str], place: str) -> None:
    unknown = [key for key in row if key not in keys]
    if unknown:
        remedy = f"Use {', '.join(dict.fromkeys(keys))}"
        raise InputError(f"unknown key {quoted(unknown[0])}", place, remedy)


def _case(row: Mapping[str, Any], defaults: Mapping[str, Any], path: Path, where: str) -> AnyCase:
    place, folder = f"{path.name} {where}", path.parent
    command = row.get("command", defaults.get("command", "diagnose"))
    if command not in _KEYS:
        remedy = 'Write "diagnose" or "discover"'
        raise InputError(f"command {quoted(command)}", f"{place} command", remedy)
    keys = _KEYS[command]
    _known(row, ["command", *keys], place)
    # What another command alone knows says nothing of this one.
    given: dict[str, Any] = {k: v for k, v in {**defaults, **row}.items() if k in keys}
    for key in _PATHS:
        if key in keys:
            given[key] = _paths(given.get(key, []), folder, f"{place} {key}")
    try:
        if command == "diagnose":
            given["model"] = _model(given.get("model"), folder, place)
            return Case(**given)
        return _islands(given, folder, place)
    except InputError as error:
        inside = error.where.startswith(path.name)
        raise InputError(error.what, error.where if inside else place, error.remedy) from None


def _model(given: Any, folder: Path, place: str) -> str:
    if not isinstance(given, str):
        raise InputError("no model", place, 'Write model = "model.toml"')
    if ".py:" in given:
        what = f"{quoted(given)} is Python, which runs only where a call names it"
        raise InputError(what, place, "Call jaxsr.diagnose_many with it")
    return str(folder / given)


def _islands(given: dict[str, Any], folder: Path, place: str) -> Islands:
    for key in _NAMES:
        given[key] = _strings(given.get(key, []), f"{place} {key}")
    for key in (*_FILES, "time"):
        if key in given and not isinstance(given[key], str):
            raise InputError(f"must be text, got {quoted(given[key])}", f"{place} {key}")
    for key in _FILES:
        if key in given:
            given[key] = str(folder / given[key])
    columns = _table(given.get("columns", {}), place, "columns")
    given["columns"] = dict(zip(columns, _strings(list(columns.values()), place), strict=True))
    if given.get("order", 1) not in (1, 2):
        raise InputError(f"order {quoted(given['order'])}", place, "Write 1 or 2")
    seeds = given.get("seeds", [given.pop("seed", 0)])
    if not isinstance(seeds, list):
        raise InputError(f"seeds {quoted(seeds)}", place, "Write [0, 1, 2]")
    given["seeds"] = tuple(cast("list[Any]", seeds))
    given.pop("seed", None)
    return Islands(**given)


def _paths(value: Any, folder: Path, where: str) -> tuple[str, ...]:
    names = _strings(value, where, "must name files", '["a.csv"]')
    return tuple(str(folder / name) for name in names)


def _strings(
    value: Any, where: str, what: str = "must be names", example: str = '["z1", "z2"]'
) -> tuple[str, ...]:
    given = cast("list[Any]", value) if isinstance(value, list) else [value]
    if not all(isinstance(item, str) for item in given):
        raise InputError(f"{what}, got {quoted(value)}", where, f"Write {example}")
    return tuple(given)
