"""What a report draws and lists beside the document: plain data, no models, no recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

ModelValue = str | float | Mapping[str, object]  # an entry of a model file


@dataclass(frozen=True)
class DiffRow:
    """One entry of the model file that the edit adds, changes or removes.

    Parameters
    ----------
    key : str
        Table and name, e.g. ``equations.v`` or ``parameters.Fc``.
    before, after : str, float, mapping or None
        The entry in the given and in the explained model; None where there is none.
    """

    key: str
    before: ModelValue | None
    after: ModelValue | None


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One output of one recording with its free runs, cut into segments of `horizon_s`.

    Parameters
    ----------
    recording, output : str
        File and reading.
    role : {"train", "held_out"}
        Whether the recording was used to estimate.
    unit : str or None
        Unit of the output.
    horizon_s : float
        Length of a segment in seconds.
    time, measured, recalibrated, explained : ndarray, shape (samples,)
        Time in seconds and the output; NaN where missing.
    given : ndarray, shape (samples,), or None
        Free run with the parameters of the file.
    whole : bool
        Whether it is one run over the whole recording, whatever `horizon_s`.
    inputs : mapping of str to ndarray, shape (samples,)
        Recorded inputs.
    rivals : mapping of tuple of str to ndarray, shape (samples,)
        Free runs of other sets of mechanisms, by their labels as `Considered` has them.
    """

    recording: str
    role: Literal["train", "held_out"]
    output: str
    unit: str | None
    horizon_s: float
    time: np.ndarray
    measured: np.ndarray
    given: np.ndarray | None
    recalibrated: np.ndarray
    explained: np.ndarray
    whole: bool = False
    inputs: Mapping[str, np.ndarray] = field(default_factory=dict)
    rivals: Mapping[tuple[str, ...], np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ForceResidual:
    """What the equation at `site` leaves unexplained, at the centres of the test functions.

    Parameters
    ----------
    site : str
        E.g. ``equation:v``.
    recording : str
        File.
    unit : str or None
        Unit of the residual.
    time, recalibrated, explained, state : ndarray, shape (test functions,)
        Centre in seconds, residual before and after, and the state it is drawn over.
    state_name : str
        Name of that state.
    state_unit : str or None
        Its unit.
    variables : mapping of str to ndarray, shape (test functions,)
        Other states, and inputs.
    role : {"train", "held_out"}
        Whether the recording was used to estimate.
    """

    site: str
    recording: str
    unit: str | None
    time: np.ndarray
    recalibrated: np.ndarray
    explained: np.ndarray
    state_name: str
    state: np.ndarray
    state_unit: str | None
    variables: Mapping[str, np.ndarray] = field(default_factory=dict)
    role: Literal["train", "held_out"] = "train"


@dataclass(frozen=True)
class Considered:
    """A set of mechanisms that was tried, and why it was taken or lost.

    Parameters
    ----------
    mechanisms : tuple of str
        E.g. ``("coulomb_friction@equation:v",)``; empty for the re-calibrated model as it is.
    error : float
        Root mean square of its residuals in free run over the segments, in the scale of the
        outputs.
    relative : float
        `error` / error of the re-calibrated model.
    chosen : bool
        Whether it stands in the explained model.
    reason : str
        One plain sentence.
    probability : float or None
        Posterior probability that it is the truth, where the evidence was told.
    """

    mechanisms: tuple[str, ...]
    error: float
    relative: float
    chosen: bool
    reason: str
    probability: float | None = None


@dataclass(frozen=True)
class Evidence:
    """What `write_diagnosis_report` needs beside ``diagnosis.json``.

    Parameters
    ----------
    model_name : str
        Name of the given model.
    diff : list of DiffRow
        The explained model against the given one.
    trajectories : list of Trajectory
        Free runs, any number; the report chooses what to draw.
    residuals : list of ForceResidual
        Force residuals by site and recording.
    considered : list of Considered
        Sorted best first.
    ladder : list of (str, str)
        The steps to the verdict: name, what was found.
    lengths : dict of str to tuple of float
        Role ("train", "held_out") to the lengths of its recordings in seconds.
    noise : dict of str to float
        Role to the free-run NRMSE that the noise of the sensors alone makes, where it is known.
    units : dict of str to str
        Of states, inputs and outputs, as the model file writes them.
    """

    model_name: str
    diff: list[DiffRow] = field(default_factory=list)
    trajectories: list[Trajectory] = field(default_factory=list)
    residuals: list[ForceResidual] = field(default_factory=list)
    considered: list[Considered] = field(default_factory=list)
    ladder: list[tuple[str, str]] = field(default_factory=list)
    lengths: dict[str, tuple[float, ...]] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class EquationFit:
    """The derivative of one state in one recording and what its found equation predicts.

    Parameters
    ----------
    state, recording : str
        State and file.
    time, target, predicted : ndarray, shape (samples,)
        Time in seconds; NaN where missing.
    """

    state: str
    time: np.ndarray
    target: np.ndarray
    predicted: np.ndarray
    recording: str


@dataclass(frozen=True, eq=False)
class ModelRun:
    """Free runs of a discovered model over one output of one held-out recording.

    Parameters
    ----------
    recording, output : str
        File and reading.
    unit : str or None
        Unit of the output.
    time, measured, simulated : ndarray, shape (samples,)
        Time in seconds; NaN where missing or between runs.
    starts : ndarray
        Instants at which runs start.
    horizon_s : float
        Length of a run, of which the first third tells the start.
    nrmse : float
        Error of what is predicted, relative to the output's deviation.
    inputs : mapping of str to ndarray, shape (samples,)
        Recorded inputs.
    """

    recording: str
    output: str
    unit: str | None
    time: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    starts: np.ndarray
    horizon_s: float
    nrmse: float
    inputs: Mapping[str, np.ndarray] = field(default_factory=dict)
