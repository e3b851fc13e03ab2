"""The pages of mechanisms, an index of them, and the picture of each."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache

from docs.generate.signatures import Signature, nearest, offered, picture, signature
from docs.generate.tables import table
from jaxsr.diagnosis.mechanisms import Candidate
from jaxsr.report.words import VERDICT_TITLES, capital, mechanism_words

FAMILIES = {
    "dissipative": "Friction and drag",
    "elastic": "Springs, stops and play",
    "inertial": "Masses, weights and constant forces",
    "coupling": "Springs and dampers between two axes",
    "periodic": "Forces that repeat",
    "memory": "Mechanisms with a memory",
    "actuator": "The actuator",
    "measurement": "Sensors and timing",
    "parameter": "Values",
    "external": "From outside",
}
ALIKE = 60.0
"""Degrees from which two effects are not called alike."""
PLACES = {
    "equation": "an equation of motion",
    "input": "an input",
    "output": "a sensor",
    "parameter": "a fixed parameter",
    "external": "a body, in one window of time",
}
WORDS = {"equation": "axis", "input": "input", "output": "sensor", "external": "body"}


@cache
def known() -> tuple[Mapping[str, list[Candidate]], Mapping[str, Signature]]:
    """Return the candidates and the signature of every mechanism."""
    every = offered()
    return every, {name: signature(many[0]) for name, many in every.items()}


def index() -> Iterator[str]:
    """Yield a table of each family under its heading, every mechanism linked to its page."""
    every, _ = known()
    for family, title in FAMILIES.items():
        names = [name for name, many in every.items() if many[0].family == family]
        if names:
            yield f"## {title}"
            yield table(["mechanism", "formula", "verdict"], map(_row, names))


def _row(name: str) -> tuple[str, str, str]:
    many = known()[0][name]
    first = formulas(many)[0]
    return f"[`{name}`](mechanisms/{name}.md)", f"`{first}`", f"`{many[0].verdict}`"


def sections() -> dict[str, str]:
    """Return the Markdown page of every mechanism, by file name."""
    return {f"{name}.md": section(name, many) for name, many in known()[0].items()}


def section(name: str, many: Sequence[Candidate]) -> str:
    """Return the Markdown page of one mechanism."""
    first = many[0]
    image = f"../images/mechanisms/{name}.svg"
    alt = f"{mechanism_words(name)} along the reference motion"
    place = PLACES[first.site.partition(":")[0]]
    family = FAMILIES[first.family]
    anchor = family.lower().replace(",", "").replace(" ", "-")
    lines = [
        f"# `{name}`",
        f'<img src="{image}" alt="{alt}" align="right" width="220">',
        f"{capital(mechanism_words(name))}: {_sentence(first)} It is looked for at {place}.",
        "\n".join(f"- `{formula}`" for formula in formulas(many)),
        f"*Constants*: {constants(first)}. *Verdict*: "
        f"{VERDICT_TITLES[first.verdict].lower()} (`{first.verdict}`).",
        f"*Confused with*: {confused(name)}.",
        f"*Source*: {first.source}.",
        f"[{family}](../mechanisms.md#{anchor}) · [How to read this page](../mechanisms.md)",
    ]
    return "\n\n".join(lines) + "\n"


def _sentence(candidate: Candidate) -> str:
    """Return what a candidate means, its place in words, to follow a colon."""
    kind, _, name = candidate.site.partition(":")
    place = "level" if name == "h" else WORDS.get(kind, "model")
    text = re.sub(r"\b[Ss]ensor \{site\}", "{site}", candidate.sentence)
    text = text.replace("{site}", f"the {place}").replace("equation:vj", "another axis")
    if candidate.fixed_parameter is not None:
        text = "the value of a parameter without bounds is wrong."
    return text[:1].lower() + text[1:]


def formulas(many: Sequence[Candidate]) -> list[str]:
    """Return what the variants of a mechanism add or change, each form once."""
    found = dict.fromkeys(text for candidate in many for text in [_formula(candidate)])
    plain = dict.fromkeys(re.sub(r"\b-?\d+\.\d+\b", "c", text) for text in found)
    return list(plain)[:5]


def _formula(candidate: Candidate) -> str:
    parts = [f"{state}: {text}" for state, text in candidate.terms]
    parts += [f"inertia of {row}: + {text}" for row, _, text in candidate.inertia]
    parts += [f"d({s.name})/dt = {s.equation}" for s in candidate.states]
    parts += [f"{symbol} → {text}" for symbol, text in candidate.replaced]
    parts += [f"reading → {text.replace('{old}', 'reading')}" for _, text in candidate.readings]
    parts += [f"delay: {text}" for _, text in candidate.delays]
    parts += [f"clock: {text}" for _, text in candidate.clock]
    parts += [f"value of {candidate.fixed_parameter}"] if candidate.fixed_parameter else []
    return re.sub(r"[{}]", "", "; ".join(parts)).replace("0.564189583547756", "1/sqrt(pi)")


def constants(candidate: Candidate) -> str:
    """Return the constants with their units in the reference model."""
    rows = [(s.name, s.unit) for s in candidate.parameters if not s.fixed]
    return ", ".join(f"`{n}`" + (f" (`{u}`)" if u and u != "1" else "") for n, u in rows)


def confused(name: str) -> str:
    """Return the mechanisms that look most alike along the reference motion."""
    close = [(n, a) for n, a in nearest(known()[1], name) if a < ALIKE]
    if close and close[0][0] == "free parameters":
        return "a wrong value of a free parameter, which reproduces it exactly"
    texts = [f"[`{n}`]({n}.md) ({a:.0f}°)" for n, a in close]
    return ", ".join(texts) or "nothing along this motion"


def pictures() -> dict[str, str]:
    """Return the pictures by file name."""
    return {f"{name}.svg": picture(found) for name, found in known()[1].items()}
