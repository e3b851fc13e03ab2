"""A monitor: normal running learnt once, then samples as they come."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxsr._result import InputError
from jaxsr.diagnosis.answer import Answer
from jaxsr.diagnosis.setup import open_recording, prepare
from jaxsr.models import Model, Simulator
from jaxsr.models.given import simulator_of
from jaxsr.models.segments import Prepared
from jaxsr.monitoring.alarm import HINTS, Alarm
from jaxsr.monitoring.alternatives import Alternative, alternatives
from jaxsr.monitoring.detector import CERTAIN, Watch, exponent
from jaxsr.monitoring.following import LANES, Follower, Window
from jaxsr.monitoring.normal import Normal, calibrated, densities
from jaxsr.monitoring.stream import Samples, Stream
from jaxsr.monitoring.windows import Rhythm, batches
from jaxsr.recordings import Recording

if TYPE_CHECKING:
    from jaxtyping import Float

WORST = 0.1
"""Exponent below which normal running itself is far from what its model says."""


def monitor(
    model: Answer | Simulator | Model | str | Path,
    normal: Sequence[str | Path | Recording],
    *,
    false_alarms_per_hour: float = 0.1,
    block: int = 64,
) -> Monitor:
    """Return a monitor of a machine that follows a model.

    Parameters
    ----------
    model : Diagnosis, Simulator, Model or path
        The explained model: a diagnosis, ``explained.toml``, or the folder that holds it. Its
        constants stay as they are.
    normal : sequence of path or Recording
        Normal running, from which the sensors' noise and the model's own errors are learnt.
    false_alarms_per_hour : float
        At most so many, on average, as long as running stays normal.
    block : int
        Samples that are judged at a time.

    Returns
    -------
    Monitor

    Raises
    ------
    InputError
        A recording cannot be read, or is too short to say what is normal.
    """
    if not 0.0 < false_alarms_per_hour < np.inf:
        what = f"must be above 0, got {false_alarms_per_hour}"
        raise InputError(what, "false_alarms_per_hour")
    if block < 8:
        raise InputError(f"must be 8 or more, got {block}", "block")
    given = _model_of(model)
    prepared = prepare(given, list(normal))
    if not prepared:
        raise InputError("no recording of normal running", "normal", "Give one or more")
    rhythm = Rhythm(block, 2 * block)
    follower = Follower.of(given, prepared)
    windows = [w for r, item in enumerate(prepared) for w in rhythm.windows(r, item)]
    follower, learnt, parts = calibrated(follower, prepared, windows)
    ways = alternatives(follower, learnt, lambda filters: densities(follower, parts, filters))
    gains = _gains(follower, learnt, ways, prepared, windows)
    known = gains[:, np.isfinite(gains).all(axis=0)]
    interval = float(np.median([p.recording.sample_time for p in prepared]))
    hours = block * interval / 3600.0
    return Monitor(
        follower,
        learnt,
        tuple(ways),
        rhythm,
        exponent(known),
        hours,
        false_alarms_per_hour,
    )


def _model_of(given: Answer | Simulator | Model | str | Path) -> Model:
    """Return the model of whatever stands for one."""
    if isinstance(given, Answer):
        return given.model
    if isinstance(given, str | Path) and Path(given).is_dir():
        given = Path(given) / "explained.toml"
    return simulator_of(given).model


def _gains(
    follower: Follower,
    normal: Normal,
    ways: Sequence[Alternative],
    prepared: Sequence[Prepared],
    windows: Sequence[Window],
) -> Float[np.ndarray, "alternatives windows"]:
    """Return logarithms of the ratios of densities.

    Each is the ratio to normal running as it was estimated, or as it is most like the alternative
    within what the estimate leaves open, whichever makes the block likelier.
    """
    filters = [*(w.filter for w in ways), *(w.normal for w in ways), normal.filter]
    parts = [np.empty((len(ways), 0))]
    for some in batches(windows, LANES):
        followed = follower.follow(prepared, some, normal.filter)
        logs = follower.log_likelihoods(followed, filters)
        # Beside the better of two: a step as far as the estimate leaves open may go past the truth.
        parts.append(logs[: len(ways)] - np.maximum(logs[len(ways) : -1], logs[-1]))
    return np.concatenate(parts, axis=1)


class Monitor:
    """Says when a machine stops following its model.

    Made by `monitor`. Samples of one stream go in by `feed`, in order; whole recordings by `read`.

    Attributes
    ----------
    normal : Normal
        What normal running looks like.
    rhythm : Rhythm
    exponent : float
        1 where normal running is as its own likelihood says; less where it shows larger ratios,
        and then changes are found later.
    false_alarms_per_hour : float
    hours : float
        That were judged.
    """

    def __init__(
        self,
        follower: Follower,
        normal: Normal,
        ways: tuple[Alternative, ...],
        rhythm: Rhythm,
        theta: float,
        hours_per_block: float,
        false_alarms_per_hour: float,
    ) -> None:
        self.normal, self.rhythm, self.exponent = normal, rhythm, theta
        self.false_alarms_per_hour = false_alarms_per_hour
        self.hours = 0.0
        self._follower, self._ways, self._each = follower, ways, hours_per_block
        self._threshold = max(-float(np.log(false_alarms_per_hour * hours_per_block)), 0.0)
        self._watch = Watch.begun(len(ways))
        self._stream: Stream | None = None
        self._judged = -np.inf

    @property
    def model(self) -> Model:
        """The model that is followed."""
        return self._follower.model

    @property
    def log_evidence(self) -> float:
        """Evidence that the machine left its model, relative to the threshold: 0 is an alarm."""
        return self._watch.log_evidence - self._threshold

    def at_rate(self, false_alarms_per_hour: float) -> Monitor:
        """Return a monitor that learnt the same, at another rate of false alarms."""
        learnt = self._follower, self.normal, self._ways, self.rhythm, self.exponent, self._each
        return Monitor(*learnt, false_alarms_per_hour)

    def feed(self, samples: Samples, name: str = "stream") -> list[Alarm]:
        """Take the next samples and return the alarms that they raise.

        Parameters
        ----------
        samples : Recording or mapping of str to array
            The model's columns, the time in s among them; any number of rows.
        name : str
            Of the stream.

        Raises
        ------
        InputError
            A column is missing, or time does not go on.
        """
        stream = self._stream
        if stream is None:
            stream = self._stream = Stream(self.model, name)
        stream.take(samples)
        fresh = int(np.count_nonzero(stream.time > self._judged))
        if fresh < self.rhythm.block or len(stream) < self.rhythm.block + self.rhythm.least:
            return []
        recent = stream.last(min(fresh + self.rhythm.lead, len(stream)))
        return self._judge(recent, stream)

    def finish(self) -> None:
        """End a stream; the next samples are those of another start. Evidence is kept."""
        self._stream, self._judged = None, -np.inf

    def reset(self) -> None:
        """Forget the evidence so far, as after an alarm that was seen to."""
        self._watch = Watch.begun(len(self._ways))

    def read(self, recording: str | Path | Recording) -> list[Alarm]:
        """Judge a whole recording, one start of the machine, and return its alarms.

        Raises
        ------
        InputError
            It cannot be read, or lacks a column of the model.
        """
        item = open_recording(self.model, recording)
        self.finish()
        stream = self._stream = Stream(self.model, item.name)
        stream.take(item)
        alarms = self._judge(item, stream)
        self.finish()
        return alarms

    def watch(self, chunks: Iterable[Samples], name: str = "stream") -> Iterator[Alarm]:
        """Yield alarms while samples come."""
        for samples in chunks:
            yield from self.feed(samples, name)

    def _judge(self, recent: Recording, stream: Stream) -> list[Alarm]:
        opened = open_recording(self.model, recent)
        begins = opened.time[0] == stream.time[0]
        prepared = (Prepared.build(self.model, opened, begins),)
        judged = int(np.count_nonzero(opened.time <= self._judged))
        windows = self.rhythm.windows(0, prepared[0], judged)
        if not windows:
            return []
        gains = _gains(self._follower, self.normal, self._ways, prepared, windows)
        alarms: list[Alarm] = []
        for window, gain in zip(windows, gains.T, strict=True):
            start, stop = opened.time[window.first], opened.time[window.stop - 1]
            self.hours += float(stop - opened.time[window.first - 1]) / 3600.0
            self._judged = float(stop)
            # Where no motion of the model leads, it is followed no more.
            known = np.where(np.isfinite(gain), gain, CERTAIN)
            self._watch = self._watch.after(self.exponent * known, float(start))
            if self.log_evidence >= 0.0:
                alarms.append(self._alarm(stream, float(stop)))
                self._watch = Watch.begun(len(self._ways))
        return alarms

    def _alarm(self, stream: Stream, time: float) -> Alarm:
        watch = self._watch
        since = min(float(watch.since[int(np.argmax(watch.log_r))]), time)
        places: dict[tuple[str, str], float] = {}
        for way, share in zip(self._ways, watch.shares, strict=True):
            key = way.site, way.kind
            places[key] = places.get(key, 0.0) + float(share)
        ranked = sorted(places.items(), key=lambda item: -item[1])[:HINTS]
        suspects = tuple((*key, share) for key, share in ranked if share >= 0.01)
        stretch = stream.since(since, 2 * self.rhythm.block)
        place = stream.name, time, since, watch.log_evidence
        return Alarm(*place, suspects, stretch, self.model)

    def __repr__(self) -> str:
        """Return the model and the rate in a line."""
        rate = f"{self.false_alarms_per_hour:g} false alarms per hour"
        return f"<Monitor of {self.model.name}: at most {rate}, exponent {self.exponent:.2g}>"
