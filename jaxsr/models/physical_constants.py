"""Parameters that are constants of nature: nothing that a recording says makes them another value.

A parameter without bounds whose value lies within a per mille of standard gravity or of a CODATA
constant, and whose unit is that constant's, is known far better than any recording tells it. A
model that gets a thrust wrong must not be mended by another gravity.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

from jaxsr._result import InputError
from jaxsr.expressions.dimensionality import Dimensionality
from jaxsr.expressions.unit_text import dimensionality, si_factor
from jaxsr.models.model import Model, Parameter

WITHIN = 1e-3
"""Relative distance at which a value is that of a constant: gravity varies by 0.5 % over the
earth, is written as 9.8, 9.81 or 9.80665, and a fitted value hits no constant so closely."""
GRAVITY = "standard acceleration of gravity"
_UNITS = frozenset("m kg s A K mol cd N J C V F Pa W ohm H T Hz S Wb lm".split())
_NO_CONSTANT = re.compile(
    # conversions, conventions and round numbers: a resistance of 1 ohm is no constant of nature
    r"relationship|conventional|natural unit|atomic unit|standard-state|molar mass constant"
)
_GRAVITY_NAMES = re.compile(r"g|g_?0|g_?n|grav(ity)?|g_?acc|g_?earth|gee", re.IGNORECASE)


@dataclass(frozen=True)
class Constant:
    """A constant of nature.

    Attributes
    ----------
    name : str
        As CODATA has it.
    value : float
        In SI units.
    dimension : Dimensionality
    """

    name: str
    value: float
    dimension: Dimensionality


@lru_cache(maxsize=1)
def constants() -> tuple[Constant, ...]:
    """Return standard gravity and the CODATA constants that have a dimension.

    References
    ----------
    Mohr, Newell, Taylor & Tiesinga, "CODATA recommended values of the fundamental physical
    constants: 2022", Rev. Mod. Phys. 97 (2025); the table of `scipy.constants`.
    """
    from scipy.constants import physical_constants

    found = []
    for name, (value, unit, _) in physical_constants.items():
        names = set(re.findall(r"[^\W\d_]+", unit))
        if not unit or not names <= _UNITS or _NO_CONSTANT.search(name):
            continue
        try:
            found.append(Constant(name, float(value), dimensionality(unit)))
        except InputError:
            continue
    found.sort(key=lambda c: c.name != GRAVITY)
    return tuple(found)


def constant_of(parameter: Parameter) -> Constant | None:
    """Return the constant of nature that a fixed parameter is; None for any other one.

    By value, with either sign, and dimension; bounds say that the parameter is to be estimated.
    """
    if parameter.free or parameter.unit is None or parameter.value == 0.0:
        return None
    try:
        unit, factor = dimensionality(parameter.unit), si_factor(parameter.unit)
    except InputError:
        return None
    return _known(abs(parameter.value) * factor, unit)


@lru_cache(maxsize=512)
def _known(value: float, unit: Dimensionality) -> Constant | None:
    if not unit:
        return None
    for constant in constants():
        near = abs(value - abs(constant.value)) <= WITHIN * abs(constant.value)
        if near and constant.dimension == unit:
            return constant
    return None


def fixed_for_good(model: Model) -> dict[str, Constant]:
    """Return the parameters of a model that are constants of nature."""
    found = ((n, constant_of(p)) for n, p in model.parameters.items())
    return {name: constant for name, constant in found if constant is not None}


def remarks(model: Model) -> Iterator[Mapping[str, str]]:
    """Yield data checks on what looks like standard gravity and has no unit."""
    for name, parameter in model.parameters.items():
        if parameter.free or parameter.unit is not None or not _GRAVITY_NAMES.fullmatch(name):
            continue
        if _known(abs(parameter.value), dimensionality("m/s^2")) is not None:
            message = f"{name} = {parameter.value:g} looks like standard gravity"
            remedy = "give its unit (m/s^2) to fix it"
            none = {"file": "", "channel": "", "check": "physical_constant"}
            yield {**none, "message": f"{message}; {remedy}"}
