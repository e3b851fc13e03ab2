"""The command on a robot.xml and logs: the missing friction is named, written back and runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jaxsr.cli import main
from jaxsr.models.formats.loading import read_plant_file
from jaxsr.models.formats.running import held, run_steps
from tests.mjcf_plants import PENDULUM, record, with_friction


@pytest.mark.slow
def test_friction_of_a_robot_is_found_written_and_run(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(PENDULUM)
    edit = with_friction("hinge", 0.12)
    logs = [
        record(PENDULUM, tmp_path / f"run{k}.csv", k, edit, noise=1e-4, amplitude=1.5)
        for k in range(3)
    ]
    out = tmp_path / "out"
    command = ["diagnose", str(tmp_path / "robot.xml"), *map(str, logs[:2])]
    assert main([*command, "--held-out", str(logs[2]), "--out", str(out)]) == 0
    document = json.loads((out / "diagnosis.json").read_text())
    assert document["verdict"] == "structure"
    (finding,) = document["findings"]
    assert (finding["mechanism"], finding["site"]) == ("coulomb_friction", "equation:v_hinge")
    friction = finding["parameters"]["Fc"]
    assert friction["unit"] == "N*m" and friction["value"] == pytest.approx(0.12, rel=0.03)
    held_out = document["fit"]["held_out"]
    assert held_out["explained"][-1] < 0.1 * held_out["recalibrated"][-1]
    checks = {row["check"] for row in document["data_checks"]}
    assert {"drafted", "written_back"} <= checks
    assert (tmp_path / "robot.toml").exists()
    # The written file, run by MuJoCo, is nearer the third log than the given one.
    log = pd.read_csv(logs[2])
    time, u = log["time"].to_numpy(), log[["drive_ctrl"]].to_numpy()
    errors = []
    for path in (out / "explained.xml", tmp_path / "robot.xml"):
        states = run_steps(read_plant_file(path)[0], np.zeros(2), time, held(time, u, "zero"), 4)
        errors.append(float(np.std(states[:, 0] - log["hinge_pos"])))
    assert errors[0] < 0.05 * errors[1]
    assert "<!-- of the data sheet -->" in (out / "explained.xml").read_text()
