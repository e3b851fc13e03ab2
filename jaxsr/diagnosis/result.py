"""The diagnosis as a value, and its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxsr._files import atomic_directory, atomic_write_text, dump_json
from jaxsr._progress import Budget
from jaxsr._result import InputError
from jaxsr.models import Model, model_text

SCHEMA = "jaxsr.diagnosis/1"


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a diagnosis found.

    Attributes
    ----------
    verdict : str
        nothing, parameter, structure, measurement, external_input or undecided.
    findings : list of dict
        Sorted by share; the form is that of ``diagnosis.json`` (docs/files.md).
    model : Model
        The explained model.
    given : Model
    fit : dict
        Free-run and force errors of the given, re-calibrated and explained model.
    document : dict
        All of ``diagnosis.json``.
    evidence : object
        Data of the figures, for the report.
    unread : tuple of InputError
        Why held-out recordings could not be used; what was found stands without them.
    """

    verdict: str
    findings: list[dict[str, Any]]
    model: Model
    given: Model
    fit: dict[str, Any]
    document: dict[str, Any]
    evidence: Any = field(repr=False, default=None)
    unread: tuple[InputError, ...] = ()

    @property
    def sentence(self) -> str:
        """The verdict in a sentence."""
        left_open = (self.document.get("provenance") or {}).get("open") or {}
        return verdict_sentence(self.verdict, self.findings, left_open.get("message", ""))

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
        limit = budget or Budget()

        def late() -> bool:
            return limit.remaining == 0.0  # an interrupt leaves time

        write_diagnosis_report(self.document, self.evidence, folder, late)


def verdict_sentence(verdict: str, findings: list[dict[str, Any]], left_open: str = "") -> str:
    """Say the verdict in one plain sentence, and in another what was left open."""
    *most, last = [f"{f['mechanism'].replace('_', ' ')} at {f['site']}" for f in findings] or [""]
    named = f"{', '.join(most)} and {last}" if most else last
    if verdict == "undecided" and not findings:
        plain = "There is a mismatch that no mechanism tried explains."
        return f"{left_open} Until then nothing was found." if left_open else plain
    if verdict == "undecided" and left_open:
        return f"{left_open} Leading among those compared: {named}."
    sentence = {
        "nothing": "No mismatch above the noise.",
        "parameter": f"The structure is right, a value is wrong: {named}.",
        "structure": f"Physics is missing: {named}.",
        "measurement": f"A sensor is wrong: {named}.",
        "external_input": f"Something acted that no column records: {named}.",
        "undecided": f"A mismatch is there, the data cannot tell its cause; leading: {named}.",
    }[verdict]
    return f"{sentence} {left_open}".strip()
