"""Results that were saved, read back from their folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxsr._result import InputError
from jaxsr.diagnosis.answer import Answer
from jaxsr.diagnosis.result import SCHEMA
from jaxsr.models import Model, Simulator, read_model
from jaxsr.models.exports import Exported

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
    document: Mapping[str, Any]
    model: Model


@dataclass(frozen=True, eq=False, repr=False)
class SavedDiscovery(Exported):
    """A discovery as its folder holds it.

    Attributes
    ----------
    directory : Path
    document : dict
        All of ``discovery.json``.
    model : Model
        The equations found, ``model.toml``.
    """

    directory: Path
    document: Mapping[str, Any]
    model: Model

    @property
    def simulator(self) -> Simulator:
        """The equations found, to be run: ``found.simulator.simulate(recording)``."""
        return Simulator(self.model)

    @property
    def verdict(self) -> str:
        """The verdict: law, several or undecided."""
        return str(self.document["verdict"])

    @property
    def reason(self) -> str:
        """Why no law is claimed, or the experiment that would split several; else empty."""
        return str(self.document["reason"])

    @property
    def equations(self) -> list[dict[str, Any]]:
        """The equations, one for each state."""
        return list(self.document["equations"])

    def to_dict(self) -> dict[str, Any]:
        """Return what ``discovery.json`` holds."""
        return dict(self.document)

    def __repr__(self) -> str:
        """Return verdict and states in a line."""
        states = ", ".join(str(row["state"]) for row in self.equations)
        return f"<SavedDiscovery {self.verdict}: rates of {states}>"

    def __str__(self) -> str:
        """Return the equations, one a line, as they were written."""
        return "\n".join(f"d({row['state']})/dt = {row['expression']}" for row in self.equations)

    def _repr_html_(self) -> str:
        """Return the card of the report, for notebooks."""
        from jaxsr.report.card import discovery_card

        return discovery_card(self.document)


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
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {str(error)[:80]}", str(path)) from None
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema not in (SCHEMA, _DISCOVERY):
        raise InputError(f"is of the form {str(schema)[:80]!r}", str(path), "Run the job again")
    model = read_model(folder / _KINDS[held[0]])
    kind = SavedDiagnosis if held[0] == "diagnosis.json" else SavedDiscovery
    return kind(folder, document, model)
