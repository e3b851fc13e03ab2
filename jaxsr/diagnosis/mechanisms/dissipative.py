"""Dissipative mechanisms: forces that take energy out of a motion."""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.diagnosis.candidates import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site

_FRICTION = "Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994)"


def dissipative(site: Site) -> Iterator[Candidate]:
    """Yield friction and drag at an equation of motion."""
    v, f = site.state, site.force_unit
    if site.position is None and site.others:
        return

    def make(name: str, term: str, *specs: ParameterSpec, sentence: str, source: str = _FRICTION):
        return Candidate(
            name, "dissipative", site.name, specs, sentence, terms=((v, term),), source=source
        )

    yield make(
        "viscous_damping",
        f"- {{Fv}}*{v}",
        ParameterSpec("Fv", site.per(v), low=0.0),
        sentence="A resistance in proportion to velocity acts along {site}.",
    )
    yield make(
        "coulomb_friction",
        f"- {{Fc}}*sign({v})",
        ParameterSpec("Fc", f, low=0.0),
        sentence="Dry friction of constant size opposes the motion along {site}.",
    )
    yield make(
        "asymmetric_friction",
        f"- {{Fa}}*Abs({v})",
        ParameterSpec("Fa", site.per(v)),
        sentence="The viscous resistance along {site} differs between the two directions.",
    )
    yield make(
        "quadratic_drag",
        f"- {{kd}}*{v}*Abs({v})",
        ParameterSpec("kd", site.per(v, v), low=0.0),
        sentence="A drag that grows with the square of velocity acts along {site}.",
        source="Batchelor, An Introduction to Fluid Dynamics (1967), section 5.11",
    )
    speeds = site.scale.get(v)
    if speeds is None:
        return
    top = max(abs(speeds[0]), abs(speeds[-1]))
    for share in (0.02, 0.06, 0.2):
        yield make(
            "stribeck_friction",
            f"- ({{Fc}} + ({{Fs}} - {{Fc}})*exp(-(Abs({v})/{{vs}})**2))*sign({v})",
            ParameterSpec("Fc", f, low=0.0),
            ParameterSpec("Fs", f, low=0.0),
            ParameterSpec(
                "vs",
                site.model.units.get(v),
                low=1e-3 * top,
                high=top,
                neutral=share * top,
                coefficient=False,
            ),
            sentence="Dry friction along {site} is higher near standstill (Stribeck effect).",
        )
