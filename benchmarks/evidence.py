"""Planted cases judged by the evidence alone, without the free runs of a diagnosis.

    python -m benchmarks.evidence DIR [--only CASE ...] [--jobs N]
    python -m benchmarks.evidence --quick

DIR holds sealed cases (`benchmarks.concealed.seal`). Every case is searched by the likelihood with
latent forces (`jaxsr.diagnosis.likelihood`): the leading set, its probabilities and intervals are
judged by the sealed sets' own rules. --quick: three of the bundled demo sets, no file.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.concealed.judging import judge
from benchmarks.provenance import write
from jaxsr.diagnosis.likelihood.posterior import Posterior, posterior
from jaxsr.diagnosis.thinning import prepare_search
from jaxsr.models import Simulator

DEMO = Path(__file__).resolve().parents[1] / "jaxsr" / "datasets" / "demo"
DEMO_TRUTHS = {"set2": "coupling_stiffness", "set3": "quadratic_drag", "set4": None}
NORMAL = 1.959964


def weighed(model: Path, data: list[Path]) -> Posterior | None:
    """Return the posterior of a case; None where nothing can be followed."""
    simulator = Simulator.from_file(model)
    prepared, _ = prepare_search(simulator.model, data, seconds=np.inf)
    return posterior(simulator.model, prepared)


def document(found: Posterior) -> dict[str, Any]:
    """Return verdict and findings in the form of a diagnosis."""
    leader, mass = found.leader, found.of_labels()
    own = [found.candidates[i] for i in leader.members]
    rivals = [label for label in mass if label not in {c.label for c in own}]
    others = [
        {"mechanism": m, "site": s, "probability": mass[label]}
        for label in rivals[:4]
        for m, _, s in [label.partition("@")]
    ]
    findings = []
    for number, candidate in zip(leader.members, own, strict=True):
        constants = {
            own_name: leader.constants[full]
            for own_name, full in leader.names[number].items()
            if full in leader.constants
        }
        findings.append(
            {
                "site": candidate.site,
                "mechanism": candidate.mechanism,
                "probability": min(mass[candidate.label], 1.0),
                "alternatives": others,
                "parameters": {
                    name: {"value": v, "ci95": [v - NORMAL * d, v + NORMAL * d]}
                    for name, (v, d) in constants.items()
                },
            }
        )
    for wrong in found.wrong:
        reach = NORMAL * wrong.deviation
        row = {"value": wrong.value, "ci95": [wrong.value - reach, wrong.value + reach]}
        findings.append(
            {
                "site": f"parameter:{wrong.name}",
                "mechanism": "wrong_value",
                "probability": wrong.probability,
                "alternatives": [],
                "parameters": {wrong.name: row},
            }
        )
    verdict = own[0].verdict.value if own else "parameter" if found.wrong else "nothing"
    return {"verdict": verdict, "findings": findings}


def answered(folder: Path, name: str) -> dict[str, Any]:
    """Weigh one sealed case; what breaks is its answer."""
    case = json.loads((folder / "cases" / name / "case.json").read_text())
    here = folder / "cases" / name
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = weighed(here / case["model"], [here / d for d in case["data"]])
        answer = {} if found is None else document(found)
        left = None if found is None else found.leader.share
        broke = "" if found is not None else "nothing can be followed"
    except Exception as error:  # a case that breaks is a case that is wrong
        answer, left, broke = {}, None, f"{type(error).__name__}: {error}"
    return {
        "case": name,
        "answer": answer,
        "latent": left,
        "broke": broke,
        "cpu_seconds": round(time.process_time() - start, 1),
    }


def judged(folder: Path, names: list[str], jobs: int) -> list[dict[str, Any]]:
    """Weigh and judge cases, and print each."""
    truth = json.loads((folder / "truth" / "truth.json").read_text())["cases"]
    names = names or sorted(truth)
    rows = []
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for row in pool.map(answered, [folder] * len(names), names):
            mark = judge(row["case"], truth[row["case"]], row["answer"] or None)
            kept = ("kind", "detectable", "verdict", "verdict_right", "false_discovery", "site_1")
            kept += ("mechanism_1", "mechanism_3", "covered", "probability", "leading_right")
            row |= {k: getattr(mark, k) for k in kept} | {"truth": mark.truth, "says": mark.answer}
            rows.append(row)
            print(
                f"{row['case']} {'right' if mark.verdict_right else 'WRONG'} verdict, mechanism "
                f"{mark.mechanism_1} p {mark.probability} latent {row['latent']} "
                f"{row['cpu_seconds']} s | {mark.truth} | {mark.answer} {row['broke']}",
                flush=True,
            )
    return rows


def rates(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Count what is right."""

    def count(key: str) -> list[int]:
        known = [bool(r[key]) for r in rows if r[key] is not None]
        return [sum(known), len(known)]

    keys = ("verdict_right", "false_discovery", "site_1", "mechanism_1", "mechanism_3")
    sure = [r for r in rows if r["probability"] is not None and r["probability"] > 0.95]
    inside = [c for r in rows for c in r["covered"]]
    return {key: count(key) for key in keys} | {
        "right_above_0.95": [sum(bool(r["leading_right"]) for r in sure), len(sure)],
        "covered": [sum(inside), len(inside)],
        "cpu_seconds_median": float(np.median([r["cpu_seconds"] for r in rows])),
    }


def quick() -> int:
    """Weigh demo sets with smooth laws; return the exit status."""
    wrong = 0
    for name, mechanism in DEMO_TRUTHS.items():
        start = time.perf_counter()
        found = weighed(DEMO / "arm.toml", [DEMO / f"{name}_train.csv"])
        labels = [] if found is None else list(found.of_labels().items())[:1]
        leader = None if found is None else [found.candidates[i] for i in found.leader.members]
        said = leader[0].mechanism if leader else None
        wrong += found is None or said != mechanism or len(leader or []) > 1
        print(f"{name}: {said} {labels} (truth: {mechanism}), {time.perf_counter() - start:.1f} s")
    return int(wrong > 0)


def main() -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR")
    parser.add_argument("--only", nargs="*", default=[], metavar="CASE")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    if options.quick or options.folder is None:
        return quick()
    rows = judged(options.folder, options.only, options.jobs)
    print(json.dumps(rates(rows), indent=1))
    if not options.only:
        seed = json.loads((options.folder / "sealed.json").read_text()).get("seed", 0)
        write(
            "evidence",
            "sealed cases by evidence alone",
            [seed],
            {"rates": rates(rows), "cases": rows},
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
