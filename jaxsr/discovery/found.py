"""The equations found, as a model that can be simulated."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

from jaxsr._result import InputError
from jaxsr.discovery.equation import Equation
from jaxsr.discovery.naming import Naming
from jaxsr.discovery.samples import Roles
from jaxsr.expressions import to_text
from jaxsr.expressions.editing import ONE, simplify
from jaxsr.expressions.primitives import INTEGRALS
from jaxsr.expressions.term import Term
from jaxsr.models.model import Model


def found_model(
    equations: Sequence[Equation],
    part: Roles,
    naming: Naming,
    time: str | None,
    units: Mapping[str, str],
) -> Model:
    """Return the equations as a model: every state that has a column is an output.

    Each integral over a recording becomes a state of its own, which starts at zero.
    """
    hidden = set(part.rate_of.values())
    recorded = [s for s in part.states if s not in hidden]
    outputs = tuple(f"{s}_meas" for s in recorded)
    columns = {f"{s}_meas": naming.column(s) for s in recorded}
    columns |= {u: naming.column(u) for u in part.inputs if u in naming.columns}
    if time and time != part.time:
        columns = {part.time: time, **columns}
    names = {part.time, *part.states, *part.inputs}
    own = {k: v for k, v in units.items() if k in names}
    own |= {f"{s}_meas": units[s] for s in recorded if s in units}
    rates, integrals = without_integrals(
        {e.state: e.term for e in equations}, part.time, {*names, *outputs}
    )
    return Model(
        name="discovered",
        states=(*part.states, *integrals),
        outputs=outputs,
        equations={s: to_text(term) for s, term in (rates | integrals).items()},
        readings=dict(zip(outputs, recorded, strict=True)),
        inputs=part.inputs,
        time=part.time,
        initial=dict.fromkeys(integrals, 0.0),
        units=own,
        columns=columns,
    )


def without_integrals(
    rates: Mapping[str, Term], time: str, taken: set[str]
) -> tuple[dict[str, Term], dict[str, Term]]:
    r"""Return right-hand sides with a state in place of each integral, and those states' rates.

    .. math:: w = \int_0^t f\,dt: \quad \dot w = f, \qquad
              w = \int f\,dg: \quad \dot w = f\,\dot g.

    Parameters
    ----------
    rates : mapping of str to Term
    time : str
    taken : set of str
        Names that a new state must not have.

    Raises
    ------
    InputError
        An integral is taken over something whose rate is not known.
    """
    states: dict[Term, str] = {}
    names = (f"integral_{k}" for k in itertools.count(1))
    free = (name for name in names if name not in taken)

    def plain(term: Term) -> Term:
        if not term.args:
            return term
        if term.op in INTEGRALS:
            if term not in states:
                states[term] = next(free)
            return Term.variable(states[term])
        return Term.apply(term.op, *map(plain, term.args))

    def speed(g: Term) -> Term:
        if g.name == time:
            return ONE
        if g.name not in rates:
            raise InputError(
                f"an integral over {to_text(g)} cannot be simulated",
                "model",
                f"Integrate over {time} or a state: {', '.join(rates)}.",
            )
        return plain(rates[g.name])

    out = {state: plain(term) for state, term in rates.items()}
    made: dict[str, Term] = {}
    while len(made) < len(states):  # an integrand, or the rate of what it is over, may hold more
        for term, name in list(states.items())[len(made) :]:
            rate = plain(term.args[0])
            if term.op == "integral_over":
                rate = Term.apply("mul", rate, speed(term.args[1]))
            made[name] = simplify(rate)
    return out, made
