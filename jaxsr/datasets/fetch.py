"""Fetch recordings: local folder or download, checksum, conversion to columns of a model file."""

from __future__ import annotations

import difflib
import hashlib
import importlib.resources
import logging
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pandas as pd
import pooch

from jaxsr._files import atomic_write_text
from jaxsr._result import InputError
from jaxsr._staging import staging_folder, sweep
from jaxsr.datasets import (
    bam_xl330,
    cascaded_tanks,
    ced,
    dfki_pendulum,
    emps,
    falling_balls,
    go2,
    kvlcc2,
    multiarm_pendulum,
    silverbox,
    tx40,
    ur10e,
)
from jaxsr.datasets.dataset import ORIGIN, Dataset, SourceFile
from jaxsr.datasets.registry import DATASETS

LOCAL_FOLDER_VARIABLE = "JAXSR_DATA_DIR"

Converter = Callable[[Mapping[str, Path]], Mapping[str, pd.DataFrame]]

_CONVERTERS: Mapping[str, Converter] = {
    "emps": emps.convert,
    "ur10e": ur10e.convert,
    "dfki_pendulum": dfki_pendulum.convert,
    "silverbox": silverbox.convert,
    "cascaded_tanks": cascaded_tanks.convert,
    "falling_balls": falling_balls.convert,
    "bam_xl330": bam_xl330.convert,
    "ced": ced.convert,
    "go2": go2.convert,
    "kvlcc2": kvlcc2.convert,
    "multiarm_pendulum": multiarm_pendulum.convert,
    "tx40": tx40.convert,
}
# Models that are written from a data set's own sources, the one under the set's name first.
_MODELS: Mapping[str, Callable[[Mapping[str, Path]], Mapping[str, str]]] = {
    "ur10e": ur10e.models,
    "go2": go2.models,
    "tx40": tx40.models,
}
# Text of a file that is made from what the origin holds in a form of its own.
_MAKERS: Mapping[str, Callable[[str, Sequence[Path]], str]] = {
    "bam_xl330": bam_xl330.make,
    "kvlcc2": kvlcc2.make,
    "multiarm_pendulum": multiarm_pendulum.make,
    "tx40": tx40.make,
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
    if source.by_hand:
        url = dataset.url(source, ORIGIN)
        raise InputError(f"{source.path}: {source.by_hand}", url, _remedy(dataset, source))
    if not source.raw:
        known = f"sha256:{source.sha256}"
        return _retrieve(dataset, source, dataset.url(source, ORIGIN), source.path, known)
    made = Path(pooch.os_cache("jaxsr")) / dataset.name / source.path
    if not made.is_file():
        _make(dataset, source, made)
    _check(made, source.sha256)
    return made


def _make(dataset: Dataset, source: SourceFile, made: Path) -> None:
    """Write a file from the origin's own form; it is kept only where its checksum is right."""
    urls = [dataset.address(upstream, source.commit, ORIGIN) for upstream in source.raw]
    named = zip(urls, source.raw, strict=True)
    raw = [_retrieve(dataset, source, url, f"raw/{name}", None) for url, name in named]
    try:
        text = _MAKERS[dataset.name](source.path, raw)
        found = hashlib.sha256(text.encode()).hexdigest()
        what = f"the download gives SHA-256 {found}, expected {source.sha256}"
    except (ValueError, KeyError, IndexError, TypeError) as error:
        found = ""
        what = f"the download is not of the form that is known ({type(error).__name__})"
    if found != source.sha256:
        for path in raw:  # the next try downloads again
            path.unlink(missing_ok=True)
        raise InputError(what, urls[0], _remedy(dataset, source))
    atomic_write_text(made, text)


def _remedy(dataset: Dataset, source: SourceFile) -> str:
    return f"Set {LOCAL_FOLDER_VARIABLE} to a folder that holds {dataset.name}/{source.path}"


def _retrieve(
    dataset: Dataset, source: SourceFile, url: str, name: str, known_hash: str | None
) -> Path:
    cache = Path(pooch.os_cache("jaxsr")) / dataset.name
    log, level = pooch.get_logger(), pooch.get_logger().level
    try:
        if known_hash is None:  # pooch would advise to write the checksum into the code
            log.setLevel(logging.WARNING)
        found = pooch.retrieve(
            url,
            known_hash=known_hash,
            fname=name.replace("/", "_"),
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
    finally:
        log.setLevel(level)
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
    sweep(parent)
    with staging_folder(parent) as built:
        for file_name, table in tables.items():
            table.to_csv(built / file_name, index=False, lineterminator="\n")
        texts = {**_packaged_models(dataset), **further}
        for file_name, text in texts.items():
            (built / file_name).write_text(text, encoding="utf-8")
        notices = [source for source in dataset.sources if source.notice]
        for source in notices:
            shutil.copyfile(sources[source.path], built / source.notice)
        names = [*tables, *texts, *(source.notice for source in notices)]
        for file_name in names:
            os.replace(built / file_name, target / file_name)
    return [target / file_name for file_name in names]


def _packaged_models(dataset: Dataset) -> dict[str, str]:
    """Return the set's model files of this package by the names under which they are written."""
    models = importlib.resources.files("jaxsr.datasets") / "models"
    names = {f"{dataset.name}.toml": dataset.model} if dataset.model else {}
    names |= {name: name for name in dataset.further}
    return {name: (models / own).read_text(encoding="utf-8") for name, own in names.items()}
