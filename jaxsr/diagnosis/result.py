"""The diagnosis as a value, and its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxsr._files import atomic_directory, atomic_write_text, dump_json
from jaxsr._progress import Budget, Repeated
from jaxsr._result import InputError
from jaxsr.diagnosis.answer import Answer
from jaxsr.models import Model, model_text
from jaxsr.report import Evidence

SCHEMA = "jaxsr.diagnosis/1"


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Answer):
    """What a diagnosis found.

    Attributes
    ----------
    model : Model
        The explained model.
    given : Model
    document : dict
        All of ``diagnosis.json``.
    evidence : Evidence or None
        Data of the figures, for the report.
    unread : tuple of InputError
        Why held-out recordings could not be used; what was found stands without them.
    """

    model: Model
    given: Model
    document: dict[str, Any]
    evidence: Evidence | None = None
    unread: tuple[InputError, ...] = ()

    def save(
        self,
        directory: str | Path,
        *,
        more: Mapping[str, str] | None = None,
        budget: Budget | None = None,
    ) -> Path:
        """Write diagnosis.json, explained.toml, report.html and figures, all or nothing.

        Parameters
        ----------
        directory : path
        more : mapping of str to str, optional
            Texts of further files of the set, by name.
        budget : Budget, optional
            Figures for which no time of it is left are left out.
        """
        directory = Path(directory)
        with atomic_directory(directory) as out:
            self.write(out, more=more, budget=budget)
        return directory

    def write(
        self,
        folder: Path,
        *,
        more: Mapping[str, str] | None = None,
        budget: Budget | None = None,
    ) -> None:
        """Write the files of `save` into a folder that is there, each whole, the report last."""
        from jaxsr.report import write_diagnosis_report

        atomic_write_text(folder / "diagnosis.json", dump_json(self.document))
        atomic_write_text(folder / "explained.toml", model_text(self.model))
        for name, text in (more or {}).items():
            atomic_write_text(folder / name, text)
        figures = Repeated(budget or Budget())
        evidence = self.evidence or Evidence(self.given.name)
        write_diagnosis_report(self.document, evidence, folder, figures.too_long)
