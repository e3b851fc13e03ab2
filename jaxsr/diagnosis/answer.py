"""What a diagnosis answers, as people read it: in a line, in a table, on a card, in a figure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from jaxsr._files import dump_json
from jaxsr._result import InputError
from jaxsr.diagnosis.finding import Estimate, Finding
from jaxsr.models import Simulator
from jaxsr.models.exports import Exported
from jaxsr.models.model import Model
from jaxsr.report.evidence import Evidence
from jaxsr.report.words import whole_sentence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Kind = Literal["free_runs", "residuals", "posterior"]


class Answer(Exported):
    """The document of a diagnosis and the model that it explains.

    Attributes
    ----------
    document : mapping
        All of ``diagnosis.json``.
    model : Model
        The explained model.
    evidence : Evidence or None
        Data of the figures, where the diagnosis was not read back from its files.
    """

    document: Mapping[str, Any]
    model: Model
    evidence: Evidence | None = None

    @property
    def verdict(self) -> str:
        """The verdict: nothing, parameter, structure, measurement, external_input, undecided."""
        return str(self.document["verdict"])

    @property
    def findings(self) -> list[Finding]:
        """What was left out, the largest share first; rows of ``diagnosis.json`` with names."""
        return [Finding(row) for row in self.document["findings"]]

    @property
    def calibration(self) -> dict[str, Estimate]:
        """The free parameters of the given model, as they are in the explained one."""
        rows: Mapping[str, Mapping[str, Any]] = self.document.get("calibration") or {}
        return {name: Estimate(row) for name, row in rows.items()}

    @property
    def fit(self) -> dict[str, Any]:
        """Free-run and force errors of the given, re-calibrated and explained model."""
        return dict(self.document["fit"])

    @property
    def sentence(self) -> str:
        """The verdict in a sentence, and in another what was left open."""
        return whole_sentence(self.document)

    @property
    def explained(self) -> Simulator:
        """The explained model, to be run: ``found.explained.simulate(recording)``."""
        return Simulator(self.model)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``diagnosis.json`` holds: plain dictionaries, lists, numbers and text."""
        return json.loads(dump_json(self.document))

    def plot(self, kind: Kind = "free_runs", figure: Figure | None = None) -> Figure:
        """Draw free runs, residuals, or the posterior of every finding.

        Parameters
        ----------
        kind : {"free_runs", "residuals", "posterior"}
            Measured, re-calibrated and explained outputs; the force that the re-calibrated model
            lacks; the probabilities of the findings and of what may stand in their place.
        figure : matplotlib Figure, optional
            A new one of pyplot by default.

        Raises
        ------
        InputError
            The kind is none of these, or what it draws is not there: results that were read back
            hold the posterior alone.
        """
        from jaxsr.report.figures import plot_free_runs, plot_posterior, plot_residuals

        if kind == "posterior":
            return plot_posterior(self.document, figure)
        if kind not in ("free_runs", "residuals"):
            remedy = "Use free_runs, residuals or posterior"
            raise InputError(f"cannot plot {kind!r:.80}", "plot", remedy)
        if self.evidence is None:
            what = f"{kind} are not among the results that were read back"
            raise InputError(what, "plot", "Open report.html, or run found.explained.simulate")
        if kind == "residuals":
            return plot_residuals(self.evidence.residuals, self.document["findings"], figure)
        return plot_free_runs(self.evidence.trajectories, self.fit.get("headline_s"), figure)

    def __repr__(self) -> str:
        """Return verdict and findings in a line."""
        found = ", ".join(f"{f.mechanism} at {f.site}" for f in self.findings)
        return f"<{type(self).__name__} {self.verdict}{f': {found}' if found else ''}>"

    def __str__(self) -> str:
        """Return a short table of the findings and errors."""
        from jaxsr.report.summary import diagnosis_table

        return diagnosis_table(self.document)

    def _repr_html_(self) -> str:
        """Return the card of the report, for notebooks."""
        from jaxsr.report.card import diagnosis_card

        return diagnosis_card(self.document)
