"""Losses of stores of the first order: in proportion, and as they grow otherwise.

A store holds a level, a temperature or a pressure: a state without a position that is no speed and
nothing electrical. What it loses goes to its surroundings, by a difference to them or, where the
model knows none, by the level alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.dissipative import is_speed
from jaxsr.diagnosis.mechanisms.site import Site
from jaxsr.diagnosis.mechanisms.springs import compared_to
from jaxsr.expressions import evaluate, to_text
from jaxsr.models.units import dimension

_CONVECTION = "Incropera & DeWitt, Fundamentals of Heat and Mass Transfer (2007), section 9.6"
_RADIATION = "Incropera & DeWitt, Fundamentals of Heat and Mass Transfer (2007), section 12.2"
FREEZING, COLDEST = 273.15, 150.0
"""Zero of the Celsius scale in K, and what no temperature in K of a plant falls below."""
POWERS = (0.5, 1.25, 3.0)
"""First guesses of an exponent: an orifice, free convection, and what grows fast."""
MOST_SHARED = 3
"""Quantities that a state may exchange with by differences alone."""
SHIFT, SAME = 0.37, 1e-9
"""Shift of all of them at once, in their size, and change of the rate that is none: rounding."""


def losses(site: Site) -> Iterator[Candidate]:
    """Yield losses in proportion, by the square, by a power, and by fourth powers (radiation)."""
    if not is_store(site):
        return
    x = site.state
    around = surroundings(site) or _of_others(site)
    if site.others:  # a store alone has the laws of a speed as well
        yield from _of_gap(site, x, "level")
    for y in around:
        yield from _of_gap(site, f"{x} - {y}", f"difference to {y}")
        if radiates(site):
            yield _radiation(site, y)


def _of_others(site: Site) -> tuple[str, ...]:
    """Return the surroundings that other stores of the model have: one that hangs on them alone
    has none of its own, and what leaks from it goes there.
    """
    unit = site.model.units.get(site.state)
    stores = [o for o in site.others if is_store(o) and o.model.units.get(o.state) == unit]
    return tuple(dict.fromkeys(y for o in stores for y in surroundings(o)))


def is_store(site: Site) -> bool:
    """Whether a state holds something: it has no position, is no speed, and nothing electrical."""
    unit = site.model.units.get(site.state)
    electrical = unit is not None and "[current]" in dimension(unit)
    return site.position is None and not electrical and not is_speed(site)


def surroundings(site: Site) -> tuple[str, ...]:
    """Return the inputs and parameters to which a state is compared, else a number.

    A rate that stays as it is where the state and some others are all shifted by the same amount
    depends on their differences, in whatever way it is written.
    """
    model, x = site.model, site.state
    term, unit = model.equation_terms[x], model.units.get(x)
    values = {n: p.value for n, p in model.parameters.items()}
    units = {**model.units, **{n: p.unit for n, p in model.parameters.items()}}
    for symbol in (*model.states, *model.inputs):
        known, signal = site.scale.get(symbol), site.signal(symbol)
        middle = known[len(known) // 2] if known is not None else 1.0
        values[symbol] = float(middle if signal is None else np.nanmean(signal))
    values[model.time] = 0.0
    if not term.variables <= values.keys() or x not in term.variables:
        return ()
    others = sorted(
        s
        for s in term.variables - {x, model.time}
        if unit is None or units.get(s) is None or dimension(str(units[s])) == dimension(unit)
    )
    step = SHIFT * max(abs(values[x]), 1.0)

    def rate(shifted: tuple[str, ...]) -> float:
        with np.errstate(all="ignore"):
            return float(evaluate(term, {**values, **{s: values[s] + step for s in shifted}}))

    here = rate(())
    alone = abs(rate((x,)) - here)
    if not np.isfinite(alone) or alone == 0.0:
        return ()
    for count in range(1, MOST_SHARED + 1):
        for shared in combinations(others, count):
            if abs(rate((x, *shared)) - here) <= SAME * alone:
                return tuple(s for s in shared if s not in model.states)
    return _written(site)


def _written(site: Site) -> tuple[str, ...]:
    """Return the number that an equation takes from its state: ``T - 20``."""
    ends = compared_to(site.model, site.state)
    numbers = [end for end in ends if end.is_constant and end.value > 0.0]
    return (to_text(numbers[0]),) if len(numbers) == 1 else ()


def radiates(site: Site) -> bool:
    """Whether a state may be a temperature."""
    unit = site.model.units.get(site.state)
    return unit is None or dimension(unit) == dimension("K")


def _of_gap(site: Site, gap: str, told: str) -> Iterator[Candidate]:
    """Yield a loss in proportion, by the square and by a power of what drives it."""
    x = site.state
    factor = gap if gap == x else f"({gap})"

    def make(
        name: str, term: str, *specs: ParameterSpec, sentence: str, family: str = "dissipative"
    ) -> Candidate:
        terms = ((x, term),)
        return Candidate(name, family, site.name, specs, sentence, terms=terms, source=_CONVECTION)

    yield make(
        "linear_stiffness",
        f"- {{k1}}*{factor}",
        ParameterSpec("k1", site.per(x), low=0.0),
        sentence=f"What {{site}} loses grows in proportion to its {told}.",
        family="elastic",
    )
    yield make(
        "quadratic_drag",
        f"- {{kd}}*{factor}*Abs({gap})",
        ParameterSpec("kd", site.per(x, x), low=0.0),
        sentence=f"What {{site}} loses grows with the square of its {told}.",
    )
    for power in POWERS:
        yield make(
            "power_law_drag",
            f"- {{kd}}*sign({gap})*Abs({gap})**{{p}}",
            ParameterSpec("kd", site.force_unit, low=0.0),
            ParameterSpec("p", "1", 0.2, 5.0, power, False),
            sentence=f"What {{site}} loses grows with a power of its {told}.",
        )


def _radiation(site: Site, around: str) -> Candidate:
    """Return the loss by radiation, whose temperatures count from absolute zero."""
    x, values = site.state, site.scale.get(site.state)
    kelvin = values is not None and float(values[0]) > COLDEST
    hot, cold = (s if kelvin else f"({s} + {FREEZING})" for s in (x, around))
    return Candidate(
        "power_law_drag",
        "dissipative",
        site.name,
        (
            ParameterSpec("kd", site.per(x, x, x, x), low=0.0),
            ParameterSpec("p", "1", neutral=4.0, coefficient=False, fixed=True),
        ),
        f"{{site}} radiates to {around}.",
        terms=((x, f"- {{kd}}*({hot}**{{p}} - {cold}**{{p}})"),),
        source=_RADIATION,
    )


__all__ = ["is_store", "losses", "surroundings"]
