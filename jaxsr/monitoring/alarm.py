"""An alarm: when a machine stopped following its model, and where it seems to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxsr.diagnosis import Diagnosis, diagnose
from jaxsr.diagnosis.setup import open_recording
from jaxsr.models import Model, Simulator
from jaxsr.recordings import Recording

HINTS = 3
"""Places that an alarm names."""


@dataclass(frozen=True, eq=False, repr=False)
class Alarm:
    """A machine that stopped following its model.

    Attributes
    ----------
    stream : str
        Name of the stream or file.
    time : float
        When it is certain enough, in s of the stream.
    since : float
        When it began, by the evidence, in s.
    log_evidence : float
        Logarithm of the statistic; an alarm is where it reaches the threshold.
    suspects : tuple of (site, kind, share)
        Where normal running explains least, the most likely place first; shares of the evidence.
    stretch : Recording
        What was read from `since` on.
    model : Model
        That it follows no more.
    """

    stream: str
    time: float
    since: float
    log_evidence: float
    suspects: tuple[tuple[str, str, float], ...]
    stretch: Recording
    model: Model

    @property
    def sentence(self) -> str:
        """Say when and where, in a sentence."""
        where = "; ".join(f"{kind} at {site} ({share:.2g})" for site, kind, share in self.suspects)
        return (
            f"{self.stream}: does not follow its model at {self.time:.6g} s, "
            f"since about {self.since:.6g} s: {where}"
        )

    def diagnose(self, **options: Any) -> Diagnosis:
        """Diagnose the stretch: what the model leaves out there.

        Parameters
        ----------
        **options
            As `jaxsr.diagnose` takes them, such as ``budget=60``.

        Raises
        ------
        InputError
            The stretch is too short, or nothing moves in it.
        """
        return diagnose(Simulator(self.model), [self.stretch], **options)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values: what ``monitor.json`` holds."""
        return {
            "stream": self.stream,
            "time_s": self.time,
            "since_s": self.since,
            "log_evidence": self.log_evidence,
            "suspects": [
                {"site": site, "kind": kind, "share": share} for site, kind, share in self.suspects
            ],
        }

    def __repr__(self) -> str:
        """Return the sentence."""
        return f"<Alarm {self.sentence}>"


def stretch_behind(alarm: Alarm, path: Path) -> Alarm:
    """Return an alarm whose stretch goes to the end of the file that raised it.

    Raises
    ------
    InputError
        The file cannot be read any more.
    """
    whole = open_recording(alarm.model, path)
    least = alarm.stretch.time[0]
    return replace(alarm, stretch=whole.window(float(least), float(whole.time[-1])))
