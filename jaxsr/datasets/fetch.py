"""Fetch recordings: local folder or download, checksum, conversion to the contract's form."""

from __future__ import annotations

import difflib
import hashlib
import importlib.resources
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pandas as pd
import pooch

from jaxsr._result import InputError
from jaxsr.datasets import (
    cascaded_tanks,
    dfki_pendulum,
    emps,
    falling_balls,
    silverbox,
    ur10e,
)
from jaxsr.datasets.registry import DATASETS, ORIGIN, Dataset, SourceFile

LOCAL_FOLDER_VARIABLE = "JAXSR_DATA_DIR"

Converter = Callable[[Mapping[str, Path]], Mapping[str, pd.DataFrame]]

_CONVERTERS: Mapping[str, Converter] = {
    "emps": emps.convert,
    "ur10e": ur10e.convert,
    "dfki_pendulum": dfki_pendulum.convert,
    "silverbox": silverbox.convert,
    "cascaded_tanks": cascaded_tanks.convert,
    "falling_balls": falling_balls.convert,
}
# Models that are written from a data set's own sources, beside the textbook simulator.
_MODELS: Mapping[str, Callable[[Mapping[str, Path]], Mapping[str, str]]] = {
    "ur10e": ur10e.models,
}


def list_datasets() -> list[Dataset]:
    """Return every data set that `fetch` knows."""
    return list(DATASETS.values())


def fetch(name: str, directory: Path | str | None = None) -> list[Path]:
    """Write one CSV per experiment of a data set, with its model file beside.

    Upstream files come from the folder in the environment variable ``JAXSR_DATA_DIR``
    (``<folder>/<name>/...``) where it holds them, else from their origin through a cache.
    Their SHA-256 is always checked. Each file is written whole or not at all.

    Parameters
    ----------
    name : str
        Name of a data set, see `list_datasets`.
    directory : Path or str, optional
        Where to write; a folder ``name`` in the current directory by default.

    Returns
    -------
    list of Path
        The CSV files, then the model file ``<name>.toml``, further models, then licence and
        readme files.

    Raises
    ------
    InputError
        Unknown name, wrong checksum, no network, or a directory that cannot be written.
    """
    dataset = _find(name)
    sources = {source.path: _locate(dataset, source) for source in dataset.sources}
    tables = _CONVERTERS[name](sources)
    further = _MODELS[name](sources) if name in _MODELS else {}
    target = Path(directory) if directory is not None else Path(name)
    try:
        return _write(dataset, tables, further, sources, target)
    except OSError as error:
        raise InputError(
            f"cannot write the recordings: {error}", str(target), "Choose a writable directory"
        ) from error


def _find(name: str) -> Dataset:
    if name in DATASETS:
        return DATASETS[name]
    close = difflib.get_close_matches(name, DATASETS, n=1)
    hint = f"Did you mean {close[0]}? " if close else ""
    raise InputError(f"unknown data set {name!r}", "", f"{hint}Known: {', '.join(DATASETS)}")


def _locate(dataset: Dataset, source: SourceFile) -> Path:
    """Return a local path of an upstream file whose checksum is right."""
    folder = os.environ.get(LOCAL_FOLDER_VARIABLE)
    if folder:
        local = Path(folder) / dataset.name / source.path
        if local.is_file():
            _check(local, source.sha256)
            return local
    return _download(dataset, source)


def _check(path: Path, expected: str) -> None:
    try:
        found = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read: {error}", str(path)) from error
    if found != expected:
        raise InputError(
            f"wrong SHA-256: expected {expected}, found {found}",
            str(path),
            f"Replace the file, or unset {LOCAL_FOLDER_VARIABLE} to download it",
        )


def _download(dataset: Dataset, source: SourceFile) -> Path:
    url = dataset.url(source, ORIGIN)
    cache = Path(pooch.os_cache("jaxsr")) / dataset.name
    try:
        found = pooch.retrieve(
            url,
            known_hash=f"sha256:{source.sha256}",
            fname=source.path.replace("/", "_"),
            path=cache,
        )
    except ValueError as error:
        raise InputError(
            f"the download has the wrong SHA-256, expected {source.sha256}",
            url,
            f"Try again, or put the right file into "
            f"{LOCAL_FOLDER_VARIABLE}/{dataset.name}/{source.path}",
        ) from error
    except OSError as error:
        # requests' errors are OSErrors too: no network, no such address, cache not writable.
        raise InputError(
            f"cannot be downloaded ({type(error).__name__})",
            url,
            f"Check the network, or set {LOCAL_FOLDER_VARIABLE} to a folder that holds "
            f"{dataset.name}/{source.path}",
        ) from error
    return Path(found)


def _write(
    dataset: Dataset,
    tables: Mapping[str, pd.DataFrame],
    further: Mapping[str, str],
    sources: Mapping[str, Path],
    target: Path,
) -> list[Path]:
    """Build all files in a folder beside the target, then move each into place."""
    target.mkdir(parents=True, exist_ok=True)
    parent = target.resolve().parent
    with tempfile.TemporaryDirectory(dir=parent, prefix=f".{target.name}-") as scratch:
        built = Path(scratch)
        for file_name, table in tables.items():
            table.to_csv(built / file_name, index=False, lineterminator="\n")
        models = importlib.resources.files("jaxsr.datasets") / "models"
        model_text = (models / dataset.model).read_text(encoding="utf-8")
        texts = {f"{dataset.name}.toml": model_text, **further}
        for file_name, text in texts.items():
            (built / file_name).write_text(text, encoding="utf-8")
        notices = [source for source in dataset.sources if source.notice]
        for source in notices:
            shutil.copyfile(sources[source.path], built / source.notice)
        names = [*tables, *texts, *(source.notice for source in notices)]
        for file_name in names:
            os.replace(built / file_name, target / file_name)
    return [target / file_name for file_name in names]
