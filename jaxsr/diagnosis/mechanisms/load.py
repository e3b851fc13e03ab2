r"""Friction that grows with the load of a joint, and with the direction of its power.

The load is read off the equation of motion. What contains an input drives the joint; what depends
on neither an input nor a position is no load; everything else is what the joint holds (weights,
springs, the joint's part of a mass matrix's forces). At rest both sides are as large. In motion
they differ by what accelerates the bodies, and a gear between them carries, with the inertia
spread on both, half of either.
"""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.dissipative import is_speed
from jaxsr.diagnosis.mechanisms.site import Site
from jaxsr.diagnosis.mechanisms.springs import summands
from jaxsr.expressions import Term, to_text
from jaxsr.expressions.canonical import simplify
from jaxsr.expressions.derivative import built
from jaxsr.models.force_factor import as_force
from jaxsr.models.model import Model

_SOURCE = "Duclusaud, Passault, Padois & Ly, ICRA (2025), arXiv 2410.08650"


def load_dependent(site: Site) -> Iterator[Candidate]:
    r"""Yield dry friction in proportion to the load L of a joint.

    .. math:: -(F_c + \mu |L|)\,\mathrm{sign}(v), \qquad
        -\tfrac12(\mu + \mu_b) |L|\,\mathrm{sign}(v) - \tfrac12(\mu - \mu_b) L,

    the second with :math:`\mu` where the drive gives power (L v > 0) and :math:`\mu_b` where the
    joint is driven back. Fc is left to the model where it has dry friction already. Where a gear is
    loaded from both sides, each of them may rub for itself: \mu (|L_1| + |L_2|)/2.
    """
    v, f = site.state, site.force_unit
    if not site.reverses or (site.position is None and site.others and not is_speed(site)):
        return
    known = loads(site)
    dry = _is_dry(site)
    own = () if dry else (ParameterSpec("Fc", f, low=0.0),)
    constant = "" if dry else "{Fc} + "

    def make(term: str, *specs: ParameterSpec, sentence: str) -> Candidate:
        return Candidate(
            "load_dependent_friction",
            "dissipative",
            site.name,
            (*own, *specs),
            sentence,
            terms=((v, term),),
            source=_SOURCE,
        )

    mu, back = ParameterSpec("mu", "1", low=0.0), ParameterSpec("mub", "1", low=0.0)
    sizes = [f"Abs({load})" for load in known]
    if len(known) > 1:
        sizes.append(f"({sizes[0]} + {sizes[1]})/2")
    for size in sizes:
        yield make(
            f"- ({constant}{{mu}}*{size})*sign({v})",
            mu,
            sentence="Dry friction along {site} grows with the load that the joint carries.",
        )
    for load in known[-1:]:
        size = f"({constant}({{mu}} + {{mub}})*Abs({load})/2)*sign({v})"
        yield make(
            f"- ({size} + ({{mu}} - {{mub}})*({load})/2)",
            mu,
            back,
            sentence="Dry friction along {site} grows with the load that the joint carries, "
            "otherwise where it is driven than where it is driven back.",
        )


def loads(site: Site) -> list[str]:
    """Return what a joint carries as text: of its drive, of what it holds, and of both.

    None of them where forces enter several rates and no input stands beside this one's.
    """
    model, state = site.model, site.state
    if not model.formulas or model.base is not None:
        return []
    factor = model.force_factors.get(state)
    if factor is not None and len(factor.rows) > 1:
        return [] if factor.beside is None else [factor.beside]
    sides: dict[bool, Term] = {}
    for sign, summand in summands(model.equation_terms[state], 1.0):
        driven = bool(summand.variables & set(model.inputs))
        if not (driven or _holds(site, summand)):
            continue
        force = as_force(model.force_factors, state, summand)
        if force is None:
            return []
        force = force if (sign > 0.0) == driven else built("neg", force)
        sides[driven] = built("add", sides[driven], force) if driven in sides else force
    texts = [written(model, sides[k]) for k in (True, False) if k in sides]
    both = [f"({' + '.join(texts)})/2"] if len(texts) == 2 else []
    return [*texts, *both]


def written(model: Model, term: Term) -> str:
    """Return a term as text in which the definitions of a model stand by their names.

    Written out, those of an arm of six joints are hundreds of thousands of characters.
    """
    names = {d: Term.variable(n) for n, d in model.definition_terms.items() if d.args}
    return to_text(simplify(_named(term, names)))


def _named(term: Term, names: dict[Term, Term]) -> Term:
    """Return a term with known subtrees replaced; `names` is filled on the way."""
    if not term.args:
        return term
    if term not in names:
        args = tuple(_named(a, names) for a in term.args)
        names[term] = term if args == term.args else Term(term.op, args)
    return names[term]


def _holds(site: Site, summand: Term) -> bool:
    """Whether a force without an input is a load: it depends on a position, or on no state."""
    states = summand.variables & set(site.model.states)
    return not states or not states <= set(site.model.dynamic_states)


def _is_dry(site: Site) -> bool:
    """Whether the equation has dry friction."""
    nodes = site.model.equation_terms[site.state].distinct()
    return any(n.op == "sign" and n.args[0].variables == {site.state} for n in nodes)
