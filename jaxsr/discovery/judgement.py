"""The verdict on a discovery: the written model, run over data held back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._progress import Budget
from jaxsr._result import InputError
from jaxsr.discovery.equation import Equation
from jaxsr.discovery.evidence import Bench, Charge, Evidence
from jaxsr.discovery.experiments import Experiments
from jaxsr.discovery.forecast import Readings, Row
from jaxsr.discovery.held_out import HeldOut, held_out_runs
from jaxsr.discovery.rivals import Rival, description_length, experiment, rivals
from jaxsr.discovery.samples import Samples, hold_back, integrated
from jaxsr.discovery.verdict import (
    CANNOT_RUN,
    LAW,
    OUT_OF_TIME,
    SEVERAL,
    UNDECIDED,
    Alternative,
    Verdict,
    decided,
    nrmse,
)
from jaxsr.models.model import Model
from jaxsr.models.reading import parse_model
from jaxsr.models.writing import model_text
from jaxsr.recordings import Recording
from jaxsr.report.evidence import ModelRun

_SHARE, _BASE, _STATE = 0.1, 2.0, 1.0  # of the budget, and seconds, at most

LATER = 0.04
"""Share of the budget by which a verdict may end later, where what came before it overran."""
Written = Callable[[Sequence[Equation]], Model]
"""Equations to the model that is written for them."""


def time_to_judge(limit: Budget, states: int) -> Budget:
    """Return a budget that leaves time for a verdict on so many states."""
    return limit.keeping(min(_SHARE * limit.seconds, _BASE + _STATE * states))


@dataclass(frozen=True, eq=False)
class Court:
    """What a verdict rests on.

    Attributes
    ----------
    written : Written
    bench : Bench
    charge : Charge
    rows : int
        Samples of DATA.
    samples : Samples
    limit : Budget
    """

    written: Written
    bench: Bench
    charge: Charge
    rows: int
    samples: Samples
    limit: Budget

    def evidence(self, equations: Sequence[Equation]) -> list[Evidence] | None:
        """Run the model as it is written, read back from its text."""
        model = parse_model(model_text(self.written(equations)), "model.toml")
        return self.bench.evidence(model, equations, self.charge, self._over)

    def _tried(self, equations: Sequence[Equation]) -> list[Evidence] | None:
        """Return the evidence of a rival; None where it cannot be run."""
        try:
            return self.evidence(equations)
        except InputError:
            return None

    def _over(self) -> bool:
        return self.limit.exhausted

    def verdict(self, equations: Sequence[Equation], *, compare: bool = True) -> Verdict:
        """Judge the equations, and whether others are as likely."""
        try:
            taken = self.evidence(equations)
        except InputError as error:
            return Verdict(UNDECIDED, f"the law cannot be run: {error.what}")
        if taken is None:
            why = OUT_OF_TIME if self.limit.exhausted else CANNOT_RUN
            return Verdict(UNDECIDED, why)
        every, by_state = nrmse(taken)
        length = description_length(taken)
        told, reason = decided(taken, self.rows)
        found: list[Rival] = []
        if told == LAW and compare and not self.limit.exhausted:
            found = rivals(equations, taken, self.samples, self._tried)
        if not found:
            return Verdict(told, reason, every, by_state, description_length=length)
        others = tuple(Alternative(r.equations, *nrmse(r.evidence)) for r in found)
        return Verdict(SEVERAL, experiment(found, self.samples), every, by_state, others, length)

    def held_out(
        self, equations: Sequence[Equation], recordings: Sequence[Recording], origin: float
    ) -> tuple[list[Equation], tuple[ModelRun, ...]]:
        """Return the equations with the errors of free runs over recordings held out, and these.

        The time of the recordings is counted from an `origin`.
        """
        model = parse_model(model_text(self.written(equations)), "model.toml")
        try:
            found = held_out_runs(self.bench, model, recordings, origin, self._over)
        except InputError:
            found = HeldOut({}, ())
        told = [replace(e, held_out_nrmse=found.errors.get(e.state)) for e in equations]
        return told, found.runs


def court(
    written: Written,
    model: Model,
    experiments: Experiments,
    judged: Sequence[Recording],
    symbols: int,
    limit: Budget,
) -> Court | None:
    """Return what a verdict rests on; None where no recording can be run.

    Parameters
    ----------
    written : Written
    model : Model
        As it is written.
    experiments : Experiments
    judged : sequence of Recording
        To choose by; blocks of DATA are held back where there are none.
    symbols : int
        Functions and names that terms are made of.
    limit : Budget
    """
    part = experiments.roles
    model = replace(model, columns={y: model.readings[y] for y in model.outputs})

    def read(recordings: Sequence[Recording], traces: Sequence[dict]) -> Readings:
        whole = [integrated(r, part) for r in recordings]
        return Readings.of(model, whole, [t["noise"] for t in traces])

    try:
        readings = read(experiments.recordings, experiments.rows.traces)
        held, blocks = readings, held_blocks(experiments.recordings)
        if judged and experiments.unseen:
            held, blocks = read(judged, experiments.unseen), None
    except InputError:
        return None
    rows = sum(len(r) for r in experiments.recordings)
    bench = Bench(readings, held, blocks, dict(part.rate_of))
    return Court(written, bench, Charge(symbols, rows), rows, experiments.rows, limit)


def held_blocks(recordings: Sequence[Recording]) -> tuple[Row, ...]:
    """Return the blocks of recordings that a search does not see (recording, start, end)."""
    held = hold_back(np.concatenate([np.full(len(r), k) for k, r in enumerate(recordings)]))
    out, first = [], 0
    for number, recording in enumerate(recordings):
        own = held[first : first + len(recording)].astype(int)
        first += len(recording)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], own, [0]])))
        out += [(number, a, b) for a, b in edges.reshape(-1, 2).tolist()]
    return tuple(out)
