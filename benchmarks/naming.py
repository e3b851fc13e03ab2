"""Laws as a search may write them, against the named mechanisms that they are.

    python -m benchmarks.naming [--quick] [--seed 1000]

Sixty laws are named mechanisms or sums of them: half are written by hand in other forms, half by a
generator of rewritings; their constants are off by up to 1e-3. Twenty have no name. Each is read
over the recorded signals of a turning joint or of a slide. Right is a named law whose mechanisms
and constants (to 1 %) are found, and an unnamed one for which no name is. Writes
``results/naming.json``; --quick (every fifth, no file). Ends with status 1 if one is wrong.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import numpy as np

from benchmarks.law_writings import rewritten
from benchmarks.naming_cases import NAMED, UNNAMED, Machine, machine
from benchmarks.provenance import write
from jaxsr.diagnosis.laws.naming import named
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.expressions import Term, evaluate, parse, to_text

SEED, OFF, CLOSE = 1000, 1e-3, 0.01
HALF = 30
EQUAL = {"end_stop": "piecewise_stiffness"}
"""Mechanisms that count as one, where the second has no constant that the first lacks."""

DRY = ("coulomb_friction", "stribeck_friction", "position_dependent_friction", "constant_force")
"""Mechanisms whose first constant has the unit of a force."""


def law_over(machine: Machine, text: str, rng: np.random.Generator, random: bool) -> Term:
    """Return a law over a machine's signals: sizes put in, perhaps rewritten, constants off."""
    law = _sized(machine, parse(text))
    if random:
        law = rewritten(rng, law)
    factors: dict[float, float] = {}
    return _off(law, rng, factors)


def _sized(machine: Machine, law: Term) -> Term:
    signals = machine.signals
    sizes = {
        "Q": float(f"{np.std(signals[machine.way]):.2g}"),
        "W": float(f"{np.std(signals[machine.speed]):.2g}"),
        "U": float(f"{np.std(signals['u']):.2g}"),
    }
    own = {"q": Term.variable(machine.way), "v": Term.variable(machine.speed)}
    return _folded(law.substitute({**{n: Term.constant(x) for n, x in sizes.items()}, **own}))


def _folded(law: Term) -> Term:
    """Reckon products and quotients of numbers, as a law has them once it is estimated."""
    if not law.args:
        return law
    args = tuple(map(_folded, law.args))
    folded = Term(law.op, args)
    if law.op in ("mul", "div", "pow") and all(a.is_constant for a in args):
        return Term.constant(float(evaluate(folded, {})))
    return folded


def _off(law: Term, rng: np.random.Generator, factors: dict[float, float]) -> Term:
    """Return the law with every number that is not whole changed; equal ones stay equal."""
    if law.is_constant and not law.value.is_integer():
        angle = abs(law.value / (0.5 * np.pi) % 1.0) < 1e-9  # a quarter turn is no estimate
        size = factors.setdefault(abs(law.value), 0.0 if angle else rng.uniform(-OFF, OFF))
        return Term.constant(law.value * (1.0 + size))
    return Term(law.op, tuple(_off(a, rng, factors) for a in law.args)) if law.args else law


def wanted(machine: Machine, truth: dict[str, dict[str, str]]) -> dict[str, dict[str, float]]:
    """Return the constants of a truth in numbers."""
    return {
        mechanism: {n: float(evaluate(_sized(machine, parse(x)), {})) for n, x in own.items()}
        for mechanism, own in truth.items()
    }


def found_in(machine: Machine, law: Term) -> tuple[dict[str, dict[str, float]], list[str | None]]:
    """Return the mechanisms that a law is called by, their constants, and the constants' units."""
    site = next(s for s in sites_of(machine.model, {}) if s.state == machine.speed)
    values = {n: p.value for n, p in machine.model.parameters.items()}
    forces = named(site, law, {**machine.signals, **values})
    constants = {
        c.mechanism: {s.name: float(x) for s, x in zip(c.parameters, own, strict=True)}
        for c, own in forces
    }
    return constants, [c.parameters[0].unit for c, _ in forces]


def is_right(found: dict[str, dict[str, float]], truth: dict[str, dict[str, float]]) -> bool:
    """Whether the mechanisms are those of the truth, with their constants."""
    plain = {EQUAL.get(m, m) if len(v) == 2 else m: v for m, v in found.items()}
    if plain.keys() != truth.keys():
        return False
    return all(
        own.keys() == plain[m].keys() and all(_close(n, plain[m][n], x) for n, x in own.items())
        for m, own in truth.items()
    )


def _close(name: str, value: float, true: float) -> bool:
    if name == "phi":
        return abs(np.angle(np.exp(1j * (value - true)))) < 2.0 * CLOSE
    return abs(value - true) < CLOSE * abs(true)


def cases(seed: int) -> list[dict[str, Any]]:
    """Return the laws: machine, text, whether it is rewritten at random, and the truth."""
    by_hand = [(law, text, False) for law in NAMED for text in law.writings][:HALF]
    at_random = [(NAMED[k % len(NAMED)], NAMED[k % len(NAMED)].plain, True) for k in range(HALF)]
    rows = [
        {"text": text, "random": random, "truth": law.truth}
        for law, text, random in (*by_hand, *at_random)
    ]
    rows += [{"text": text, "random": False, "truth": {}} for text in UNNAMED]
    return [{**row, "seed": seed + k} for k, row in enumerate(rows)]


def run(row: dict[str, Any]) -> dict[str, Any]:
    """Name one law."""
    kind = ("joint", "slide")[row["seed"] % 2]
    place = machine(kind, row["seed"])
    law = law_over(place, row["text"], np.random.default_rng(row["seed"]), row["random"])
    begin = time.perf_counter()
    found, units = found_in(place, law)
    seconds = time.perf_counter() - begin
    truth = wanted(place, row["truth"])
    dry = [u for u, m in zip(units, found, strict=True) if m in DRY]
    right = is_right(found, truth) and all(unit == place.unit for unit in dry)
    print(f"{'right' if right else 'WRONG'} {seconds:5.2f} s  {to_text(law, 4)[:70]}"
          + ("" if right else f"\n      {found}, not {truth}"), flush=True)  # fmt: skip
    return {
        **row, "machine": kind, "law": to_text(law), "truth": truth, "found": found,
        "units": units, "right": right, "seconds": round(seconds, 3),
    }  # fmt: skip


def main() -> int:
    """Name all laws; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="every fifth law, writes nothing")
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args()
    rows = [run(row) for row in cases(options.seed)[:: 5 if options.quick else 1]]
    right = {
        kind: [r["right"] for r in rows if bool(r["truth"]) == (kind == "named")]
        for kind in ("named", "without a name")
    }
    summary = {kind: [sum(found), len(found)] for kind, found in right.items()}
    print(", ".join(f"{kind}: {good} of {many}" for kind, (good, many) in summary.items()))
    if not options.quick:
        write("naming", "Names of laws", [options.seed], {"summary": summary, "rows": rows})
    return 0 if all(good == many for good, many in summary.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
