"""A finding of a diagnosis: a row of ``diagnosis.json`` whose entries have names and types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxsr._interval import Interval
from jaxsr.report.words import figures_of, mechanism_words, site_words


class Estimate(dict[str, Any]):
    """A value that was estimated, with its interval and unit.

    It is also the row of the document, as SciPy's results are dictionaries with attributes:
    ``estimate["ci95"]`` is ``list(estimate.interval)``.
    """

    @property
    def value(self) -> float:
        """Return the estimate, in `unit`."""
        return float(self["value"])

    @property
    def interval(self) -> Interval | None:
        """Return the 95 % interval; None where the recordings do not tell one."""
        ends = self.get("ci95")
        return Interval(*(float(end) for end in ends)) if ends and None not in ends else None

    @property
    def unit(self) -> str | None:
        """Return the unit as a model file writes it, where one is known."""
        return self.get("unit")

    def __repr__(self) -> str:
        """Return value, interval and unit in a line."""
        interval = self.interval
        parts = [f"{self.value:.6g}", "" if interval is None else str(interval), self.unit or ""]
        return f"<Estimate {' '.join(part for part in parts if part)}>"


class Rival(dict[str, Any]):
    """A mechanism that may stand in the place of a finding, and how probable it is."""

    @property
    def mechanism(self) -> str:
        """Return its name (docs/mechanisms.md)."""
        return str(self["mechanism"])

    @property
    def site(self) -> str:
        """Return where it would act, such as ``equation:v``."""
        return str(self["site"])

    @property
    def probability(self) -> float | None:
        """Return its posterior probability."""
        return self.get("probability")

    def __repr__(self) -> str:
        """Return mechanism, site and probability in a line."""
        return f"<Rival {self.mechanism} at {self.site}{_probable(self)}>"


class Finding(dict[str, Any]):
    """What a simulator leaves out, at one place.

    It is also the row of ``diagnosis.json`` (docs/files.md), as SciPy's results are dictionaries
    with attributes: ``finding["parameters"]["Fc"]["value"]`` and
    ``finding.parameters["Fc"].value`` are one number.
    """

    @property
    def mechanism(self) -> str:
        """Return the name of what is left out, such as ``coulomb_friction``."""
        return str(self["mechanism"])

    @property
    def site(self) -> str:
        """Return where: ``equation:v``, ``input:u``, ``output:y``, ``parameter:M``, ..."""
        return str(self["site"])

    @property
    def family(self) -> str:
        """Return the family of the mechanism, such as ``dissipative``."""
        return str(self["family"])

    @property
    def probability(self) -> float | None:
        """Return the posterior probability that it, or one counted as equal, is there."""
        return self.get("probability")

    @property
    def share(self) -> float | None:
        """Return the share of the explained squared error that comes back without it."""
        return self.get("share")

    @property
    def part(self) -> float | None:
        """Return its part in what re-calibration could not explain; all parts add up to 1."""
        told: dict[str, Any] | None = self.get("part")
        return told["value"] if told else None

    @property
    def term(self) -> str | None:
        """Return the term that is added, in the grammar of model files."""
        return self.get("term")

    @property
    def edit(self) -> dict[str, Any]:
        """Return every key of the given model that changes; empty for a push."""
        return dict(self.get("edit") or {})

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Return its constants by name."""
        rows: Mapping[str, Mapping[str, Any]] = self.get("parameters") or {}
        return {name: Estimate(row) for name, row in rows.items()}

    @property
    def alternatives(self) -> list[Rival]:
        """Return what may stand in its place, the most probable first."""
        rows: list[Mapping[str, Any]] = self.get("alternatives") or []
        return [Rival(row) for row in rows]

    @property
    def where(self) -> dict[str, Any]:
        """Return the region, recordings and times in which it acts."""
        return dict(self.get("where") or {})

    @property
    def explanation(self) -> str:
        """Return one or two plain sentences."""
        return str(self.get("explanation") or "")

    def to_dict(self) -> dict[str, Any]:
        """Return the row of ``diagnosis.json`` as a plain dictionary."""
        return dict(self)

    def __repr__(self) -> str:
        """Return mechanism, site and probability in a line."""
        return f"<Finding {self.mechanism} at {self.site}{_probable(self)}>"

    def __str__(self) -> str:
        """Return what was found in words, with its constants."""
        place = f"{mechanism_words(self.mechanism)}, {site_words(self.site)}"
        figures = figures_of(self)
        return f"{place}: {figures}" if figures else place


def _probable(row: Mapping[str, Any]) -> str:
    probability = row.get("probability")
    return "" if probability is None else f", probability {probability:.3g}"
