"""The report of a discovery: what :mod:`jaxsr.report` draws, taken from a discovery."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd

from jaxsr._progress import Budget
from jaxsr.discovery.equation import Equation, relative_error
from jaxsr.discovery.hybrid import Hybrid, Mode
from jaxsr.discovery.hybrid.picture import mode_plane
from jaxsr.discovery.samples import Samples
from jaxsr.discovery.verdict import Verdict
from jaxsr.report import EquationFit, write_discovery_report
from jaxsr.report.equation_figures import MOST_FITS
from jaxsr.report.evidence import ModelRun
from jaxsr.report.model_runs import MOST_RUNS
from jaxsr.report.style import Pace

_SHARE = 0.2  # of the budget, at most, for the report
_WRITING, _FIGURE = 0.6, 0.4  # seconds for the page and for a figure

_CHECKSUMS = {
    "validation_sha256": "Validation",
    "held_out_sha256": "Held out",
    "known_sha256": "Known part",
}
_DIGITS = 12  # of a checksum in the report, which is enough to tell files apart


class Found(Protocol):
    """What the report shows of a discovery, which writes its report itself."""

    @property
    def equations(self) -> tuple[Equation, ...]: ...
    @property
    def samples(self) -> Samples: ...
    @property
    def hybrid(self) -> Hybrid | None: ...
    @property
    def columns(self) -> Mapping[str, str]: ...
    @property
    def provenance(self) -> Mapping[str, Any]: ...
    @property
    def pareto(self) -> pd.DataFrame: ...
    @property
    def modes(self) -> tuple[Mode, ...]: ...
    @property
    def judgement(self) -> Verdict: ...
    @property
    def held_out_runs(self) -> tuple[ModelRun, ...]: ...
    def to_dict(self) -> dict[str, Any]: ...


def reserve(limit: Budget, states: int, held_out: int = 0) -> Budget:
    """Return a budget that leaves time for the report of so many states and held-out files."""
    figures = 1 + min(states, MOST_FITS) + min(states * held_out, MOST_RUNS)
    return limit.keeping(min(_SHARE * limit.seconds, _WRITING + _FIGURE * figures))


def write_page(discovery: Found, folder: Path, budget: Budget | None = None) -> None:
    """Write ``report.html``, one self-contained file, and its figures as PNG into ``folder``.

    Figures that the budget has no time for are left out.
    """
    hybrid = discovery.hybrid
    plane = None if hybrid is None else mode_plane(hybrid, discovery.samples)
    fits = fits_of(discovery)
    pace = Pace(budget or Budget())
    write_discovery_report(shown(discovery), fits, folder, plane, pace, discovery.held_out_runs)


def shown(discovery: Found) -> dict[str, Any]:
    """Return ``discovery.json`` as the report shows it.

    Of each front the pick, and the best of every other number of terms that beats all fewer;
    relative errors; no interval where a coefficient is exact by definition; equations with the
    digits that intervals justify.
    """
    document = discovery.to_dict()
    for equation, entry in _written(discovery, document):
        entry["shown"] = equation.shown
    for equation, entry in zip(discovery.equations, document["equations"], strict=True):
        entry["relative_error"] = relative_error(equation, discovery.samples)
        for term in entry["terms"]:
            if term["ci95"][0] == term["ci95"][1]:
                term["ci95"] = None
    laws = () if discovery.hybrid is None else discovery.hybrid.one_law
    for equation, entry in zip(laws, document.get("one_law", ()), strict=True):
        entry["relative_error"] = relative_error(equation, discovery.samples)
    rows = discovery.pareto.sort_values("mse").sort_values("picked", ascending=False, kind="stable")
    kept = rows.drop_duplicates(["state", "complexity"]).sort_values("complexity")
    points = kept.to_dict("records")
    for state, front in document["pareto"].items():
        front[:] = _undominated([point for point in points if point["state"] == state])
    computed = document["provenance"].pop("estimated_derivatives", ())
    for key, words in _CHECKSUMS.items():
        files = document["provenance"].pop(key, {})
        if files:
            told = (f"{name} (SHA-256 {digest[:_DIGITS]}…)" for name, digest in files.items())
            document["provenance"][words] = ", ".join(told)
    if discovery.columns:
        told = (f"{symbol} is {column}" for symbol, column in discovery.columns.items())
        document["provenance"]["Columns"] = ", ".join(told)
    if computed:
        document["provenance"]["Rates computed for"] = ", ".join(computed)
    return document


def _written(
    discovery: Found, document: dict[str, Any]
) -> Iterator[tuple[Equation, dict[str, Any]]]:
    """Yield every equation that the report shows, and its entry."""
    modes = zip(discovery.modes, document["modes"], strict=True)
    laws = [(mode.equations, entry["equations"]) for mode, entry in modes]
    others = zip(discovery.judgement.alternatives, document["alternatives"], strict=True)
    laws += [(other.equations, entries) for other, entries in others]
    laws.append((discovery.equations, document["equations"]))
    for equations, entries in laws:
        yield from zip(equations, entries, strict=True)


def _undominated(points: list[dict[Any, Any]]) -> list[dict[Any, Any]]:
    """Return the pick, and the points that no point of fewer terms beats; fewest terms first."""
    kept, least = [], np.inf
    for point in points:
        if point["picked"] or point["mse"] < least:
            kept.append(point)
        least = min(least, point["mse"])
    return kept


def fits_of(discovery: Found) -> list[EquationFit]:
    """Return derivative and prediction of every state in every recording."""
    samples = discovery.samples
    numbers = np.unique(samples.group).tolist()
    names = list(discovery.provenance.get("data_sha256", ()))
    if len(names) != len(numbers):  # not every recording came from a file
        names = [f"recording {number + 1}" for number in numbers]
    time = samples.variables[next(iter(samples.variables))]
    fits = []
    for equation in discovery.equations:
        target, predicted = samples.targets[equation.state], equation.predict(samples)
        for number, name in zip(numbers, names, strict=True):
            rows = samples.group == number
            fits.append(
                EquationFit(equation.state, time[rows], target[rows], predicted[rows], name)
            )
    return fits
