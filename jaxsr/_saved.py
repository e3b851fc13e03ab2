"""Results that were saved, read back from their folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from jaxsr._result import InputError
from jaxsr.diagnosis.answer import Answer
from jaxsr.diagnosis.result import SCHEMA
from jaxsr.models import Model, read_model

if TYPE_CHECKING:
    from jaxsr.discovery.saved import SavedDiscovery

_KINDS = {"diagnosis.json": "explained.toml", "discovery.json": "model.toml"}
_DISCOVERY = "jaxsr.discovery/1"


@dataclass(frozen=True, eq=False, repr=False)
class SavedDiagnosis(Answer):
    """A diagnosis as its folder holds it.

    Attributes
    ----------
    directory : Path
    document : dict
        All of ``diagnosis.json``.
    model : Model
        The explained model, ``explained.toml``.
    """

    directory: Path
    document: dict[str, Any]
    model: Model


def load(directory: str | Path) -> SavedDiagnosis | SavedDiscovery:
    """Read back what `save`, or the option ``--out`` of a command, wrote.

    Parameters
    ----------
    directory : path
        A folder with ``diagnosis.json`` and ``explained.toml``, or with ``discovery.json`` and
        ``model.toml``.

    Returns
    -------
    SavedDiagnosis or SavedDiscovery
        ``Simulator(found.model)`` runs the model that was found.

    Raises
    ------
    InputError
        The folder holds no results, those of two kinds, or damaged ones.
    """
    folder = Path(directory)
    held = [name for name in _KINDS if (folder / name).is_file()]
    if len(held) != 1:
        what = "holds a diagnosis and a discovery" if held else "holds no results of jaxsr"
        remedy = "Name the folder that --out or save() wrote, one for each result"
        raise InputError(what, str(folder), remedy)
    path = folder / held[0]
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {str(error)[:80]}", str(path)) from None
    document = cast("dict[str, Any]", read) if isinstance(read, dict) else {}
    schema = document.get("schema")
    if schema not in (SCHEMA, _DISCOVERY):
        raise InputError(f"is of the form {str(schema)[:80]!r}", str(path), "Run the job again")
    model = read_model(folder / _KINDS[held[0]])
    if held[0] == "diagnosis.json":
        return SavedDiagnosis(folder, document, model)
    from jaxsr.discovery.saved import SavedDiscovery

    return SavedDiscovery(folder, document, model)
