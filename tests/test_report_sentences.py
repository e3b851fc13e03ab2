"""What a report says of its own numbers: where noise is all, why errors fall, how probable."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_systems import CART
from test_report_documents import drive_document, drive_evidence

from jaxsr.diagnosis.shooting.scoring import free_run
from jaxsr.models import Simulator, parse_model
from jaxsr.models.lifting import closed
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.recordings import Recording
from jaxsr.report import Considered, write_diagnosis_report
from jaxsr.report.considered import considered_rows
from jaxsr.report.fit_sentences import horizon_sentence, noise_sentence
from jaxsr.report.fit_tables import Role


def fit_of(train: list, held_out: list | None = None) -> dict:
    """Return errors of the explained model at three horizons, of which the middle one decides."""
    roles = {
        role: None if errors is None else {"recalibrated": [0.5, 0.6, 0.7], "explained": errors}
        for role, errors in (("train", train), ("held_out", held_out))
    }
    return {"horizons_s": [0.2, 1.0, 9.0], "headline_s": 1.0, **roles}


def test_an_error_within_the_noise_is_said_to_be_noise():
    about = {"train": Role(noise=0.023), "held_out": Role(noise=0.021)}
    said = noise_sentence(fit_of([0.5, 0.0234, 0.5]), about)
    assert "2.3 % left on training recordings is the sensors' noise" in said
    assert "nothing more is to be explained" in said
    assert noise_sentence(fit_of([0.01, 0.046, 0.01]), about) == ""
    assert noise_sentence(fit_of([0.01, 0.01, 0.01])) == ""
    both = noise_sentence(fit_of([0.5, 0.0231, 0.5], [0.5, 0.0208, 0.5]), about)
    assert both.index("held-out recordings") < both.index("training recordings")
    # What fits the training recordings alone is not explained.
    assert noise_sentence(fit_of([0.01, 0.02, 0.01], [0.01, 0.2, 0.01]), about) == ""


@pytest.mark.parametrize("errors", [[0.1, 0.2, 0.4], [0.1, 0.099, 0.1], [0.1, None, None], []])
def test_nothing_is_said_of_errors_that_do_not_fall(errors):
    assert horizon_sentence(fit_of(errors)) == ""


def test_the_largest_fall_is_told_with_its_horizons():
    said = horizon_sentence(fit_of([0.2, 0.18, 0.3], [0.1, 0.4, 0.05]))
    assert "explained, held out: 40 % over runs of 1 s, 5.0 % over whole recordings" in said


def test_errors_that_fall_are_the_noise_of_the_starts():
    """With the right model nothing but the start can err: more where few readings tell it."""
    model = parse_model(CART)
    simulator, stepping = Simulator(model), Stepping("rk4", 2)
    time, rng = np.arange(300) * 0.02, np.random.default_rng(1)
    u = 4.0 * np.sin(1.7 * time) + 3.0 * np.sin(2.9 * time + 1.0)
    theta = np.array(simulator.values(), float)

    def recorded(y: np.ndarray) -> list[Prepared]:
        return [Prepared.build(model, Recording("a.csv", time, {"u": u, "y": y}))]

    segments = build_segments(model, recorded(0.0 * u), [(0, 0, 300)], 2)
    path = closed(simulator, stepping, segments, theta, segments.course)
    assert path is not None
    y = path[0, :, 0]
    noise = 0.02 * y.std() * rng.normal(size=300)
    short, whole = (
        free_run(simulator, stepping, recorded(y + noise), theta, horizon).nrmse
        for horizon in (0.6, None)
    )
    assert short > 2.0 * whole
    assert free_run(simulator, stepping, recorded(y), theta, 0.6).nrmse < 0.01 * short


@pytest.mark.long
def test_sets_are_shown_with_their_probabilities(tmp_path: Path):
    """First what was taken, then the most probable; by the evidence where that was told."""
    evidence, findings = drive_evidence(), drive_document()["findings"]
    evidence = replace(evidence, considered=evidence.considered[::-1])
    shown = [(r["names"], r["probability"]) for r in considered_rows(evidence, findings)]
    assert [probability for _, probability in shown] == ["93 %", "6 %", "", "", ""]
    assert [names[0].split()[0] for names, _ in shown[:2]] == ["Coulomb", "Stribeck"]
    sure = [replace(c, probability=0.1 * k) for k, c in enumerate(evidence.considered)]
    rows = considered_rows(replace(evidence, considered=sure), findings)
    assert rows[0]["chosen"] and rows[0]["probability"] == "40 %"
    assert [row["probability"] for row in rows[1:]] == ["30 %", "20 %", "10 %", "< 1 %"]
    write_diagnosis_report(drive_document(), evidence, tmp_path / "told")
    bare = replace(evidence, considered=[Considered((), 0.1, 1.0, False, "Left.")])
    write_diagnosis_report(drive_document(), bare, tmp_path / "bare")
    heads = [(tmp_path / n / "report.html").read_text("utf-8") for n in ("told", "bare")]
    assert [">Probable</th>" in head for head in heads] == [True, False]
