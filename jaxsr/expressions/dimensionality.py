"""Dimensions of units as powers of base quantities, and those of the units that models use most.

pint knows all units there are and takes half a second to learn them; the names of most model files
stand here, with what pint makes of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

_ROUNDING = 1e-12  # of a power that cancels


@dataclass(frozen=True)
class Dimensionality(Mapping[str, float]):
    """Base quantities, such as ``[length]``, with their powers.

    Attributes
    ----------
    powers : tuple of (str, float)
        In alphabetical order, none of them zero.
    """

    powers: tuple[tuple[str, float], ...] = ()

    @staticmethod
    def of(powers: Mapping[str, float]) -> Dimensionality:
        """Build one of powers, zeros among them."""
        kept = ((b, float(p)) for b, p in powers.items() if abs(p) > _ROUNDING)
        return Dimensionality(tuple(sorted(kept)))

    def __getitem__(self, base: str) -> float:
        """Return the power of a base quantity that is there."""
        return dict(self.powers)[base]

    def __iter__(self) -> Iterator[str]:
        """Go through the base quantities."""
        return iter(dict(self.powers))

    def __len__(self) -> int:
        """Count the base quantities; none makes it false."""
        return len(self.powers)

    def __mul__(self, other: Dimensionality) -> Dimensionality:
        """Return the dimension of a product."""
        both = {b: self.get(b, 0.0) + other.get(b, 0.0) for b in (*self, *other)}
        return Dimensionality.of(both)

    def __truediv__(self, other: Dimensionality) -> Dimensionality:
        """Return the dimension of a quotient."""
        return self * other**-1.0

    def __pow__(self, exponent: float) -> Dimensionality:
        """Return the dimension of a power."""
        return Dimensionality.of({base: power * exponent for base, power in self.powers})

    def __str__(self) -> str:
        """Write it as ``[mass] * [length] / [time] ** 2``."""
        above = [_factor(base, power) for base, power in self.powers if power > 0]
        below = [_factor(base, -power) for base, power in self.powers if power < 0]
        text = " / ".join([" * ".join(above) or "1", *below])
        return text if self.powers else "dimensionless"


def _factor(base: str, power: float) -> str:
    return base if power == 1.0 else f"{base} ** {power:g}"


def _powers(text: str) -> Dimensionality:
    """Read powers such as ``M1 L2 T-3 I-1``."""
    return Dimensionality.of({_BASES[word[0]]: float(word[1:]) for word in text.split()})


_BASES = {
    **{"L": "[length]", "M": "[mass]", "T": "[time]", "I": "[current]"},
    **{"K": "[temperature]", "N": "[substance]", "J": "[luminosity]"},
}
_UNITS = {
    **{"": "rad deg degree turn count percent mrad radian", "L1": "m mm cm km um meter"},
    **{"T1": "s ms us min h hour second", "M1": "kg g tonne", "I1": "A mA uA ampere"},
    **{"K1": "K degC", "N1": "mol", "J1": "cd lm", "I1 T1": "C", "T-1": "Hz kHz rpm"},
    **{"M1 L1 T-2": "N kN mN newton", "M1 L2 T-2": "J", "M1 L2 T-3": "W kW mW"},
    **{"M1 L-1 T-2": "Pa kPa MPa bar", "M1 L2 T-3 I-1": "V mV kV volt", "L3": "L l"},
    **{"M1 L2 T-3 I-2": "ohm", "M-1 L-2 T3 I2": "S", "M1 L2 T-2 I-2": "H"},
    **{"M-1 L-2 T4 I2": "F", "M1 T-2 I-1": "T", "M1 L2 T-2 I-1": "Wb"},
}
DIMENSIONS: dict[str, Dimensionality] = {
    name: _powers(powers) for powers, names in _UNITS.items() for name in names.split()
}
"""Dimensions of units by their names."""
SI: frozenset[str] = frozenset(
    "m s kg A K mol cd rad N J W Pa V ohm S H F T Wb C Hz meter second newton volt ampere".split()
)
"""Names of units of the SI without a factor."""
