"""Terms offered to the front: known small ones, and shapes whose constants start on a grid."""

from __future__ import annotations

from dataclasses import dataclass

from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.front import Front
from jaxsr.evolution.individual import Individual, Problem
from jaxsr.evolution.library import FEW, shape_terms, small_terms
from jaxsr.evolution.seeds import complete
from jaxsr.expressions.printing import kind
from jaxsr.expressions.term import Term

Terms = tuple[Term, ...]
_MEMBERS = 4  # of the front that are offered shapes in a generation
_SHAPES = 4  # different shapes offered to each
_ALL, _STARTS = 150, 2  # and to a whole basis, from so many grid points each
_PLAIN = 3  # terms of a law that nothing needs to be offered to
_BEAM = 2  # generation of a population in which pairs and triples are weighed
_SMALL = 800  # small terms, and shapes, among which they are sought
_WIDTH = 80  # pairs, and triples, kept
_PEAKS, _MANY_PEAKS, _SHORT = 2, 12, 80  # frequencies tried; rows of a short record
_PHASE = Term.constant(0.8)  # of the second of two waves: one may start where no descent ends well
_LOOKED_AT = 10  # grid points looked at for each different shape


@dataclass(frozen=True, slots=True)
class Offer:
    """When terms are offered: generation, how many since the population was drawn, how often it
    was drawn, and the loss at which nothing more is to be explained."""

    generation: int
    age: int
    drawn: int
    enough: float


def small_offers(problem: Problem, config: SearchConfig, terms: Terms, count: int) -> list[Term]:
    """Return the small terms that would lower the loss most beside ``terms``."""
    primitives = config.primitives
    library = problem.dictionary(
        ("small", primitives), lambda: small_terms(list(problem.variables), primitives)
    )
    return library.best(terms, count)


def with_shapes(problem: Problem, front: Front, offer: Offer, config: SearchConfig) -> list[Terms]:
    """Return members of the front joined by a shape that explains most of their residual.

    The first generation of a population looks at whole bases of monomials too: the right part of
    a law without its shape is often no member of any front. Every population has its own grid.
    """
    primitives, shift = config.primitives, _shift(offer)
    shapes = problem.dictionary(
        ("shapes", primitives, shift), lambda: shape_terms(problem.variables, primitives, shift)
    )
    out: list[Terms] = []
    most = config.sizes.terms - 1
    members = [(member.terms, _SHAPES) for member in few(front, most, offer.generation)]
    if offer.age == 1 and not explained(front, offer.enough):
        members += [(basis, _ALL) for basis in complete(problem, config)]
    for terms, count in members:
        starts = _STARTS if count == _ALL else 1
        kinds: dict[str, list[Term]] = {}
        for term in shapes.best(terms, _LOOKED_AT * count):
            kinds.setdefault(kind(term), []).append(term)
        for same in list(kinds.values())[:count]:
            out += [(*terms, term) for term in same[:starts]]
    return out


def with_frequencies(
    problem: Problem, front: Front, offer: Offer, config: SearchConfig
) -> list[Terms]:
    """Return members of the front joined by a sine at a frequency of their residual.

    Time, if there is one, is looked at every generation; another variable takes its turn every
    third one, its waves alone and times each of the others, as a motor's torque ripples in
    proportion to its current. The first generation of a population looks at whole bases, too.
    """
    if "sin" not in config.primitives.functions:
        return []
    names = [n for n in problem.variables if n == problem.time]
    others = [n for n in problem.variables if n != problem.time]
    if others and offer.generation % 3 == 0:
        names.append(others[(offer.generation // 3) % len(others)])
    sets = [member.terms for member in few(front, config.sizes.terms - 1, offer.generation)]
    if offer.age == 1 and not explained(front, offer.enough):
        sets += complete(problem, config)
    # a short record's spectrum is all side lobes: its highest peaks need not be near a wave
    peaks = _PEAKS if problem.rows >= _SHORT else _MANY_PEAKS
    out: list[Terms] = []
    for terms in sets:
        for name in names:
            found = [("", w) for w in problem.frequencies(terms, name, peaks)]
            if name != problem.time and "mul" in config.primitives.functions and len(others) <= FEW:
                factors = [n for n in others if n != name]
                found += problem.modulated(terms, name, factors, peaks)
            for factor, w in found:
                out += _waves(terms, name, w, factor)
    return out


def _waves(terms: Terms, name: str, w: float, factor: str) -> list[Terms]:
    angle = Term.apply("mul", Term.constant(w), Term.variable(name))
    waves = [Term.apply("sin", angle), Term.apply("sin", Term.apply("add", angle, _PHASE))]
    if factor:
        waves = [Term.apply("mul", Term.variable(factor), wave) for wave in waves]
    return [(*terms, wave) for wave in waves]


def _shift(offer: Offer) -> float:
    """Return where between its points the grid of a population lies: evenly spread, never twice."""
    return (offer.drawn * 0.618034) % 1.0


def with_beam(problem: Problem, front: Front, offer: Offer, config: SearchConfig) -> list[Terms]:
    """Return the best pairs and triples of small terms and shapes, once, if much is left."""
    if offer.age != _BEAM or explained(front, offer.enough):
        return []
    primitives = config.primitives
    small = small_terms(list(problem.variables), primitives)[:_SMALL]
    shapes = shape_terms(problem.variables, primitives, _shift(offer))
    shapes = shapes[:: max(1, len(shapes) // _SMALL)]
    return problem.beam([*small, *shapes], _WIDTH)


def explained(front: Front, enough: float) -> bool:
    """Tell whether a few terms explain the target as well as can be."""
    return any(m.loss <= enough for m in front.members if len(m.terms) <= _PLAIN)


def few(front: Front, most: int, generation: int) -> list[Individual]:
    """Return the smallest and largest members and two between that change with the generation."""
    members = [m for m in front.members if len(m.terms) <= most]
    if len(members) <= _MEMBERS:
        return members
    picks = {(generation * 2) % len(members), (generation * 2 + 1) % len(members)}
    return [members[k] for k in sorted({0, len(members) - 1, *picks})]


def with_quotients(
    problem: Problem, front: Front, offer: Offer, config: SearchConfig
) -> list[Terms]:
    """Return quotients of short sums, waves of the front's frequencies among their parts.

    Without waves at first; then in generations 2, 4, 8, ... while the frequencies settle.
    """
    generation = offer.generation
    if "div" not in config.primitives.functions or generation & (generation - 1):
        return []
    waves = frequencies_of(front, problem.time) if generation > 1 else []
    if generation > 1 and not waves:
        return []
    return problem.quotients(waves[:2], 8)


def frequencies_of(front: Front, time: str) -> list[float]:
    """Return the distinct frequencies of sines and cosines of time on the front, lowest first."""
    out: list[float] = []
    for member in reversed(front.members):
        for term in member.terms:
            w = _frequency(term.args[0], time) if term.op in ("sin", "cos") else None
            if w and not any(abs(w - other) <= 1e-3 * other for other in out):
                out.append(w)
    return sorted(out)


def _frequency(angle: Term, time: str) -> float | None:
    """Return w of w t or w t + phi."""
    if angle.op == "add":
        angle = angle.args[0]
    if angle.op != "mul" or not angle.args[0].is_constant or angle.args[1].name != time:
        return None
    return abs(angle.args[0].value)
