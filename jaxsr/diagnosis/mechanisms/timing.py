"""Timing faults: delays of inputs and sensors, clocks that run at another rate."""

from __future__ import annotations

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.models import Model

REACH = 20.0
"""Largest shift in samples that the segments of free runs can hold."""

LATE = frozenset({"actuator_lag", "input_delay", "sensor_delay"})
"""Mechanisms that make a signal late."""


def timing_candidates(model: Model, step: float, duration: float) -> list[Candidate]:
    """Return a delay of every input and output and a skew of every sensor's clock.

    Parameters
    ----------
    model : Model
    step, duration : float
        Sample interval and latest time of the recordings in s.

    Notes
    -----
    With one input and one output the two delays are the same thing: the sensor's stands for
    both, and for a delay of all outputs at once the input's. A single signal is late for none.
    """
    if len(model.inputs) + len(model.outputs) < 2:
        return []
    inputs = model.inputs if len(model.inputs) + len(model.outputs) > 2 else ()
    signals = [("input_delay", "actuator", "input", u) for u in inputs]
    signals += [("sensor_delay", "measurement", "output", y) for y in model.outputs]
    found = [
        Candidate(
            mechanism,
            family,
            f"{role}:{signal}",
            (ParameterSpec("tau", "s", low=0.0, high=float(REACH * step)),),
            "{site} acts later than its time stamps say."
            if role == "input"
            else "{site} is read earlier than its time stamps say: it comes late.",
            delays=((signal, "{tau}"),),
            source="Ljung, System Identification (1999)",
        )
        for mechanism, family, role, signal in signals
        if signal not in model.delays or model.delays[signal] == 0.0
    ]
    reach = float(REACH * step / duration)
    for output in model.outputs:
        found.append(
            Candidate(
                "clock_skew",
                "measurement",
                f"output:{output}",
                (ParameterSpec("s", "1", low=-reach, high=reach),),
                "The clock of {site} runs at another rate than the recording's.",
                clock=((output, "1 + {s}"),),
                source="Mills, IEEE Trans. Commun. 39 (1991), Internet Time Synchronization",
            )
        )
    return found


def as_late(given: Model, one: Candidate, other: Candidate) -> bool:
    """Whether two mechanisms make one signal late: the same to first order in their time."""
    single = len(given.inputs) == len(given.outputs) == 1
    late = {one.mechanism, other.mechanism} <= LATE and one.mechanism != other.mechanism
    return late and (single or one.site == other.site)
