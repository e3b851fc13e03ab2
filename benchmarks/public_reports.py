"""Small inputs after public reports, each judged against its right answer.

    python -m benchmarks.public_reports [--quick] [--only NAME...] [--jobs N]

The inputs lie in the folder in JAXSR_CASES_DIR (by default ../shared/cases/reports beside the
repository); where there is none, nothing is run. Every case goes through the command line as a
user's would, in a process of its own; what it wrote is judged. Results, as they come:
``results/public_reports.json``; --quick (`QUICK`) writes nothing. Ends with status 1 if a case is
wrong that is right there.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sympy

from benchmarks.provenance import RESULTS, write

ROOT = Path(__file__).resolve().parents[1]
CASES = Path(os.environ.get("JAXSR_CASES_DIR", ROOT.parent / "shared" / "cases" / "reports"))
BUDGET, SLACK = 180.0, 1.15
"""Seconds of a diagnosis, and by how much of it the whole command may be late."""
QUICK = ("oversampled", "mixed-time-units")
QUICK_BUDGET = 60.0


@dataclass(frozen=True)
class Answer:
    """What a command came to.

    Attributes
    ----------
    status : int
    said : str
        Both streams.
    document : dict
        ``diagnosis.json`` or ``discovery.json``; empty where there is none.
    seconds : float
    """

    status: int
    said: str
    document: dict[str, Any]
    seconds: float

    @property
    def findings(self) -> dict[tuple[str, str], dict[str, Any]]:
        """Findings by mechanism and site."""
        return {(f["mechanism"], f["site"]): f for f in self.document.get("findings", ())}


@dataclass(frozen=True)
class Place:
    """Where one case is run: its folder, a folder to write to, and its time."""

    folder: Path
    work: Path
    budget: float
    quick: bool = False

    def jaxsr(self, command: str, name: str, *words: str | Path) -> Answer:
        """Run a command of jaxsr that writes to `name`."""
        out = self.work / name
        given = [str(w) for w in words]
        line = [sys.executable, "-m", "jaxsr", command, *given, "--out", str(out)]
        line += ["--budget", str(self.budget), "--seed", "1"]
        begun = time.monotonic()
        done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
        seconds = time.monotonic() - begun
        kind = "discovery" if command == "discover" else "diagnosis"
        path = out / f"{kind}.json"
        document = json.loads(path.read_text()) if path.exists() else {}
        return Answer(done.returncode, done.stdout + done.stderr, document, seconds)

    def script(self, name: str) -> str:
        """Run a script of the case in the folder to write to; return what it printed."""
        path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH")) if p)
        done = subprocess.run(
            [sys.executable, str(self.folder / name)],
            cwd=self.work,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        return done.stdout + (done.stderr[-500:] if done.returncode else "")


Checks = dict[str, bool]


def near(row: dict[str, Any] | None, value: float, share: float = 0.0) -> bool:
    """Whether a parameter's interval, or its value to within a share, has the true value."""
    if row is None:
        return False
    low, high = row["ci95"]
    return low <= value <= high or abs(row["value"] - value) <= share * abs(value)


def row_after_a_pause(place: Place) -> Checks:
    """Coulomb friction of 0.27 in both files, and nothing else."""
    checks = {}
    for name in ("uniform", "uniform_rest"):
        found = place.jaxsr(
            "diagnose", name, place.folder / "model.toml", place.folder / f"{name}.csv"
        )
        row = found.findings.get(("coulomb_friction", "equation:v"), {})
        checks[f"{name}: coulomb friction alone"] = len(found.findings) == 1 and bool(row)
        size = row.get("parameters", {}).get("Fc")
        checks[f"{name}: 0.27"] = near(size, 0.27, 0.02)
    return checks


def wrong_valley(place: Place) -> Checks:
    """Nothing, or values that are wrong: the truth lies inside model and bounds."""
    found = place.jaxsr("diagnose", "d", place.folder / "model.toml", place.folder / "motor.csv")
    document = found.document
    return {
        "verdict": document.get("verdict") in ("nothing", "parameter"),
        "no physics": all(m == "wrong_value" for m, _ in found.findings),
        "error": document.get("fit", {}).get("train", {}).get("explained", [1.0])[-1] < 0.0092,
    }


def oversampled(place: Place) -> Checks:
    """A bias of -2 of the sensor and an offset of 2.4 of the pump, at either rate."""
    checks = {}
    model = place.folder / "model.toml"
    for rate in ("1hz",) if place.quick else ("1hz", "100hz"):
        if rate == "100hz":
            place.script("gen.py")
        where = place.folder if rate == "1hz" else place.work
        files = [where / f"{name}_{rate}.csv" for name in "abc"]
        found = place.jaxsr("diagnose", rate, model, *files)
        bias = found.findings.get(("sensor_bias", "output:level"), {})
        force = found.findings.get(("constant_force", "equation:h"), {})
        row = force.get("parameters", {}).get("F0")
        # as a rate, or beside the flows that stand in the bracket
        offset = near(row, -24.0 / 154.0) or near(row, -24.0)
        checks[f"{rate}: both"] = len(found.findings) == 2 and bool(bias) and bool(force)
        checks[f"{rate}: bias"] = near(bias.get("parameters", {}).get("y0"), -2.0)
        checks[f"{rate}: pump"] = offset
        checks[f"{rate}: in time"] = found.seconds <= SLACK * place.budget
    return checks


def encoder_wrap(place: Place) -> Checks:
    """The wrap is said, and the time constant is 0.03 s and nothing else wrong."""
    checks = {}
    for name in ("wrap", "gaps"):
        found = place.jaxsr(
            "diagnose", name, place.folder / "model.toml", place.folder / f"{name}.csv"
        )
        said = json.dumps(found.document.get("data_checks", ())) + found.said
        forces = [f for (_, site), f in found.findings.items() if site.startswith("equation:")]
        value = found.document.get("calibration", {}).get("T")
        checks[f"{name}: ends"] = found.status == 0
        checks[f"{name}: said"] = "wrap" in said.lower()
        checks[f"{name}: no force"] = not any(f["probability"] > 0.5 for f in forces)
        checks[f"{name}: 0.03 s"] = near(value, 0.03, 0.02)
    return checks


def emps_divided(place: Place) -> Checks:
    """Coulomb friction of about 20.4 N and dependence on direction, as in the bundled EMPS."""
    place.script("make.py")
    found = place.jaxsr(
        "diagnose",
        "d",
        place.folder / "model.toml",
        place.work / "DATA_EMPS.csv",
        "--held-out",
        place.work / "DATA_EMPS_PULSES.csv",
    )
    row = found.findings.get(("coulomb_friction", "equation:v"), {})
    directed = {"asymmetric_friction", "constant_force"} & {m for m, _ in found.findings}
    return {
        "ends": found.status == 0,
        "coulomb 20.4 N": near(row.get("parameters", {}).get("Fc"), 20.4, 0.05),
        "direction": bool(directed),
    }


def law_doubled(place: Place) -> Checks:
    """v' = -4 x - 0.3 v, with intervals of no width as well."""
    said = place.script("doubled.py")
    checks = {}
    for kind in ("as is", "degenerate"):
        law = re.search(rf"{kind}: *v' = ([^|\n]*)", said)
        checks[kind] = law is not None and is_law(law[1], {"x": -4.0, "v": -0.3}, 0.1)
    return checks


def is_law(text: str, slopes: dict[str, float], share: float) -> bool:
    """Whether an expression has these slopes at random places, to within a share."""
    symbols = {name: sympy.Symbol(name) for name in slopes}
    expression = sympy.sympify(text.strip(), locals=symbols)
    rng = np.random.default_rng(0)
    for values in rng.uniform(-1.0, 1.0, (5, len(slopes))):
        point = dict(zip(symbols.values(), values, strict=True))
        for name, wanted in slopes.items():
            slope = float(sympy.diff(expression, symbols[name]).subs(point))
            if abs(slope - wanted) > share * abs(wanted):
                return False
    return True


def mixed_time_units(place: Place) -> Checks:
    """It is said that steps differ a thousandfold, and no law is given without a word."""
    files = (place.folder / "a_s.csv", place.folder / "b_ms.csv")
    found = place.jaxsr("discover", "d", *files, "--states", "v", "--inputs", "u")
    said = found.said.lower()
    return {"said": any(word in said for word in ("1000", "thousand", "1e+03", "time unit"))}


def million_rows(place: Place) -> Checks:
    """The same law at a million rows as at every 50th, within the budget."""
    place.script("gen.py")
    laws, checks = [], {}
    for step in (1, 50):
        data = place.work / f"every{step}.npz"
        found = place.jaxsr("discover", f"d{step}", data, "--states", "q,w")
        rows = found.document.get("equations", ())
        laws.append({r["state"]: _terms(r["terms"]) for r in rows})
        checks[f"every {step}: in time"] = found.seconds <= SLACK * place.budget
    law = laws[0].get("w", {})
    checks["gravity"] = abs(law.get("sin(q)", 0.0) + 9.81) < 0.05
    same = all(
        a.keys() == b.keys() for a, b in [(laws[0].get(s, {}), laws[1].get(s, {})) for s in "qw"]
    )
    return {**checks, "same terms": same}


def _terms(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return coefficients by expressions, the constants inside them to four digits."""

    def rounded(found: re.Match[str]) -> str:
        return f"{float(found[0]):.4g}"

    number = r"\d+\.?\d*(?:[eE][-+]?\d+)?"
    return {re.sub(number, rounded, r["expression"]): r["coefficient"] for r in rows}


def random_walk(place: Place) -> Checks:
    """No law in 21 rows of a random walk, whatever the origin of time."""
    checks, answers = {}, []
    for name in ("walk", "walk_1900"):
        found = place.jaxsr("discover", name, place.folder / f"{name}.csv", "--states", "a,b")
        answers.append(found.document.get("verdict"))
        checks[f"{name}: no law"] = found.status == 2 or answers[-1] == "undecided"
    return {**checks, "the same": answers[0] == answers[1]}


JUDGES: dict[str, Callable[[Place], Checks]] = {
    "row-after-a-pause": row_after_a_pause,
    "wrong-valley": wrong_valley,
    "oversampled": oversampled,
    "encoder-wrap": encoder_wrap,
    "emps-divided": emps_divided,
    "law-doubled": law_doubled,
    "mixed-time-units": mixed_time_units,
    "million-rows": million_rows,
    "random-walk": random_walk,
}
BUDGETS = {"million-rows": 60.0, "random-walk": 60.0, "mixed-time-units": 60.0}


def run(name: str, quick: bool = False) -> dict[str, Any]:
    """Run and judge one case; return its row."""
    begun = time.monotonic()
    budget = QUICK_BUDGET if quick else BUDGETS.get(name, BUDGET)
    with tempfile.TemporaryDirectory() as work:
        checks = JUDGES[name](Place(CASES / name, Path(work), budget, quick))
    seconds = round(time.monotonic() - begun, 1)
    wrong = [what for what, good in checks.items() if not good]
    print(f"{name}: {'wrong: ' + '; '.join(wrong) if wrong else 'right'} ({seconds} s)", flush=True)
    return {"case": name, "right": not wrong, "checks": checks, "seconds": seconds}


def main() -> int:
    """Run the cases; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help=f"{', '.join(QUICK)} alone")
    parser.add_argument("--only", nargs="+", choices=list(JUDGES), help="these cases alone")
    parser.add_argument("--jobs", type=int, default=1, help="cases side by side")
    asked = parser.parse_args()
    names = list(QUICK if asked.quick else asked.only or JUDGES)
    there = [n for n in names if (CASES / n).is_dir()]
    if not there:
        print(f"no cases in {CASES}")
        return 0
    committed = json.loads((RESULTS / "public_reports.json").read_text(encoding="utf-8"))["rows"]
    rows, before = [], {r["case"] for r in committed if r["right"]}
    with ThreadPoolExecutor(asked.jobs) as pool:
        for done in as_completed([pool.submit(run, n, asked.quick) for n in there]):
            rows.append(done.result())
            if not asked.quick and not asked.only:
                write("public_reports", "inputs after public reports", [1], {"rows": rows})
    print(f"{sum(r['right'] for r in rows)} of {len(rows)} right")
    lost = [r["case"] for r in rows if not r["right"] and r["case"] in before]
    if lost:
        print(f"right in the committed results, wrong now: {', '.join(lost)}")
    return int(bool(lost))


if __name__ == "__main__":
    sys.exit(main())
