"""The six rows of results in the README."""

from __future__ import annotations

from docs.generate.diagnosis_tables import balls, headline, last_two, real
from docs.generate.tables import number, percent, result, table

_HEAD = ["on", "found", "more"]


def results_table() -> str:
    """Return six rows, each with a link to the page that holds the whole of it."""
    drop = balls()
    emps, silver = (real()[n]["diagnoses"][n] for n in ("emps", "silverbox"))
    planted = {k: "{} of {}".format(*last_two(k)) for k in ("verdict", "false_discoveries")}
    named = "{} of {}".format(*last_two("mechanism_top1"))
    clean = result("odebench")["summary"]["jaxsr, noise 0.0"]
    noisy = result("odebench")["summary"]["jaxsr, noise 0.05"]
    fc = emps["findings"][0]["parameters"]["Fc"]["value"]
    k3 = silver["findings"][0]["parameters"]["k3"]["value"]
    undecided = drop["dense"].get("undecided", 0)
    rows = [
        (
            "EMPS drive, real",
            f"Coulomb friction {number(fc, 3)} N; {_errors(emps)}",
            "[recordings](docs/results/diagnosis.md#real-recordings)",
        ),
        (
            "Silverbox, real",
            f"cubic stiffness {number(k3 / 1e5, 3)}e5 1/(V s)²; {_errors(silver)}",
            "[recordings](docs/results/diagnosis.md#real-recordings)",
        ),
        (
            "Eight light balls dropped",
            f"drag on {drop['right']}; of three dense ones {undecided} left undecided",
            "[targets](docs/results/diagnosis.md#targets)",
        ),
        (
            "200 planted effects, sealed",
            f"verdict {planted['verdict']}, mechanism {named}, "
            f"false discoveries {planted['false_discoveries']}",
            "[planted](docs/results/diagnosis.md#planted-effects)",
        ),
        (
            "ODEBench, `discover`",
            f"exact structure {percent(clean['exact'], 2)} clean, "
            f"{percent(noisy['exact'], 2)} at 5 % noise",
            "[equations](docs/results/discovery.md#odebench)",
        ),
        (
            "Six later real sets",
            _later(),
            "[later](docs/results/diagnosis.md#recordings-added-later)",
        ),
    ]
    return table(_HEAD, rows)


def _errors(found: dict) -> str:
    return headline(found["fit"])


def _later() -> str:
    from docs.generate.diagnosis_tables import LATER, met

    hits, every = met(LATER)
    return f"{hits} of {every} targets met, an earlier engine"
