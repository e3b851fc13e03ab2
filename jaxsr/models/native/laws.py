r"""Formulas of a simulator that can be asked anywhere, free of noise.

A rate is taken for

.. math:: f(z, p) = \sum_k C_k \prod_i p_i^{n_{ki}} \varphi_k(z)

with few of a library of functions of states and inputs, and whole powers of parameters, if it is
that to rounding, at points that were not used to find it. Where it is not, the rate stays a call.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

Ask = Callable[[np.ndarray], np.ndarray]
"""Rows, shape (samples, columns), to a rate, shape (samples,)."""
EXACT = 1e-9
"""Difference, relative to the size of a rate, up to which it is rounding of sums."""
VOID = 1e-8
"""Size of a term, relative to that of the rate, below which it is rounding of the fit."""
WHOLE = 1e-5
"""How far a power may be from a whole number: a logarithm of two rounded numbers."""
MOST_VARIABLES = 8
"""States and inputs from which the library grows too large for a small sample."""
PER_COLUMN = 3
FEW = 12
"""Terms from which a formula is no law that a reader would recognise."""


@dataclass(frozen=True)
class Column:
    """A function of some variables: its text, and how it is computed from their columns."""

    text: str
    compute: Callable[[np.ndarray], np.ndarray]


def library(names: Mapping[int, str], turning: Sequence[int] = ()) -> list[Column]:
    """Return the functions of the variables, by their columns in the rows.

    Polynomials to the third degree, absolute values, signs, and sines of the variables and of
    sums of two of those that turn.
    """
    out = [Column("1", lambda z: np.ones(len(z)))]

    def add(text: str, compute: Callable[[np.ndarray], np.ndarray]) -> None:
        out.append(Column(text, compute))

    for k, a in names.items():
        add(a, lambda z, k=k: z[:, k])
        add(f"{a}**2", lambda z, k=k: z[:, k] ** 2)
        add(f"{a}**3", lambda z, k=k: z[:, k] ** 3)
        add(f"{a}*Abs({a})", lambda z, k=k: z[:, k] * np.abs(z[:, k]))
        add(f"Abs({a})", lambda z, k=k: np.abs(z[:, k]))
        add(f"sign({a})", lambda z, k=k: np.sign(z[:, k]))
        add(f"sin({a})", lambda z, k=k: np.sin(z[:, k]))
        add(f"cos({a})", lambda z, k=k: np.cos(z[:, k]))
    for (j, a), (k, b) in itertools.combinations(names.items(), 2):
        add(f"{a}*{b}", lambda z, j=j, k=k: z[:, j] * z[:, k])
        add(f"sin({a} + {b})", lambda z, j=j, k=k: np.sin(z[:, j] + z[:, k]))
        add(f"sin({a} - {b})", lambda z, j=j, k=k: np.sin(z[:, j] - z[:, k]))
        if j in turning and k in turning:
            continue
        for (m, c), (n, d) in (((j, a), (k, b)), ((k, b), (j, a))):
            add(f"{c}**2*{d}", lambda z, m=m, n=n: z[:, m] ** 2 * z[:, n])
            add(f"{c}*sin({d})", lambda z, m=m, n=n: z[:, m] * np.sin(z[:, n]))
            add(f"{c}*cos({d})", lambda z, m=m, n=n: z[:, m] * np.cos(z[:, n]))
    return out


@dataclass(frozen=True, eq=False)
class Region:
    """Where a simulator is asked.

    Attributes
    ----------
    names : tuple of str
        Of the columns: time, states, inputs, parameters.
    moving : tuple of int
        Columns of states and inputs.
    parameters : tuple of int
    usual : ndarray, shape (columns,)
        Centre of the columns, the given values of parameters.
    scales : ndarray, shape (columns,)
        How far states and inputs go from it.
    """

    names: tuple[str, ...]
    moving: tuple[int, ...]
    parameters: tuple[int, ...]
    usual: np.ndarray
    scales: np.ndarray

    def rows(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return random rows, parameters as given."""
        rows = np.tile(self.usual, (count, 1))
        for k in self.moving:
            rows[:, k] += self.scales[k] * rng.uniform(-1.0, 1.0, count)
        return rows


def depends(ask: Ask, region: Region, rng: np.random.Generator) -> list[int]:
    """Return the columns that a rate depends on, as far as random points tell."""
    rows = region.rows(rng, 24)
    own = ask(rows)
    size = np.nanmax(np.abs(own)) + 1e-300
    found = []
    for k in range(len(region.names)):
        moved = rows.copy()
        moved[:, k] += np.where(rng.random(24) < 0.5, 0.37, 0.081) * region.scales[k]
        change = np.abs(ask(moved) - own)
        if not np.nanmax(change) <= 1e-13 * size:
            found.append(k)
    return found


def recognised(ask: Ask, region: Region, rng: np.random.Generator) -> str | None:
    """Return the text of a rate as a formula, None where it is none of the library.

    Parameters
    ----------
    ask : callable
    region : Region
    rng : numpy.random.Generator
        Of the points.
    """
    on = depends(ask, region, rng)
    moving = {k: region.names[k] for k in on if k in region.moving}
    own = [k for k in on if k in region.parameters]
    if any(k not in moving and k not in own for k in on) or len(moving) > MOST_VARIABLES:
        return None
    columns = library(moving)
    rows = region.rows(rng, PER_COLUMN * len(columns) + 20)
    support = _support(columns, rows, ask(rows))
    if support is None:
        return None
    chosen = [columns[k] for k in support]
    found = [_monomial(ask, region, rows, chosen, own, k) for k in range(len(chosen))]
    terms = [(column.text, m) for column, m in zip(chosen, found, strict=True) if m is not None]
    if len(terms) < len(chosen):
        return None
    rows = region.rows(rng, 2 * len(columns))
    for k in own:
        rows[:, k] *= rng.choice([0.8, 1.25, 1.0], len(rows))
    truth = ask(rows)
    total = np.zeros(len(rows))
    for column, m in zip(chosen, found, strict=True):
        assert m is not None
        total += m.value(rows) * column.compute(rows)
    if not np.abs(total - truth).max() <= 10 * EXACT * np.abs(truth).max():
        return None
    return written(terms, region.names)


def _fitted(columns: Sequence[Column], rows: np.ndarray, y: np.ndarray) -> np.ndarray | None:
    """Return the coefficients of what a rate is exactly, None where it is not."""
    theta = np.stack([c.compute(rows) for c in columns], axis=1)
    size = np.sqrt(np.mean(theta**2, axis=0)) + 1e-300
    if not (np.isfinite(theta).all() and np.isfinite(y).all()):
        return None
    xi = np.linalg.lstsq(theta / size, y, rcond=1e-13)[0]
    rest = y - theta @ (xi / size)
    if not np.abs(rest).max() <= EXACT * (np.abs(y).max() + 1e-300):
        return None
    return xi / size


def _support(columns: Sequence[Column], rows: np.ndarray, y: np.ndarray) -> list[int] | None:
    """Return which columns a rate consists of."""
    xi = _fitted(columns, rows, y)
    if xi is None:
        return None
    rms = np.array([np.sqrt(np.mean(c.compute(rows) ** 2)) for c in columns])
    kept = [int(k) for k in np.flatnonzero(np.abs(xi) * rms > VOID * np.abs(y).max())]
    if not kept or len(kept) > FEW or _fitted([columns[k] for k in kept], rows, y) is None:
        return None
    return kept


@dataclass(frozen=True)
class Monomial:
    """C times powers of parameters, by their columns."""

    factor: float
    powers: tuple[tuple[int, int], ...]

    def value(self, rows: np.ndarray) -> np.ndarray:
        """Return it at rows, shape (samples,)."""
        out = np.full(len(rows), self.factor)
        for k, n in self.powers:
            out = out * rows[:, k] ** n
        return out


def _monomial(
    ask: Ask,
    region: Region,
    rows: np.ndarray,
    chosen: Sequence[Column],
    parameters: Sequence[int],
    place: int,
) -> Monomial | None:
    """Return how a coefficient depends on parameters."""

    def coefficient(k: int | None, factor: float) -> float | None:
        moved = rows.copy()
        if k is not None:
            moved[:, k] *= factor
        xi = _fitted(chosen, moved, ask(moved))
        return None if xi is None else float(xi[place])

    value = coefficient(None, 1.0)
    if not value:
        return None
    powers = []
    for k in parameters:
        if region.usual[k] == 0.0:
            return None
        other = coefficient(k, 1.25)
        if other is None or other / value <= 0.0:
            return None
        power = np.log(other / value) / np.log(1.25)
        if abs(power - round(power)) > WHOLE:
            return None
        if round(power):
            powers.append((k, round(power)))
    for k, n in powers:
        value /= float(region.usual[k]) ** n
    return Monomial(_short(value), tuple(powers))


def _short(value: float) -> float:
    """Return the number of few digits that a value is to rounding."""
    near = float(f"{value:.9g}")
    return near if abs(near - value) <= EXACT * abs(value) else value


def written(terms: Sequence[tuple[str, Monomial]], names: Sequence[str]) -> str:
    """Return a sum as text; what divides all terms stands under it once."""
    shared = dict(terms[0][1].powers)
    for _, m in terms[1:]:
        own = dict(m.powers)
        shared = {k: n for k, n in shared.items() if own.get(k) == n}
    below = {k: n for k, n in shared.items() if n < 0}
    parts = []
    for text, m in terms:
        rest = [(k, n) for k, n in m.powers if k not in below]
        factors = [_power(names[k], n) for k, n in rest if n > 0]
        under = [_power(names[k], -n) for k, n in rest if n < 0]
        number = abs(m.factor)
        above = [repr(number)] if number != 1.0 or not (factors or text != "1") else []
        above += factors + ([text] if text != "1" else [])
        one = "*".join(above) or "1.0"
        one += "".join(f"/{u}" for u in under)
        parts.append(("-" if m.factor < 0 else "+", one))
    first, *others = parts
    total = ("-" if first[0] == "-" else "") + first[1]
    total += "".join(f" {sign} {one}" for sign, one in others)
    if not below:
        return total
    divisor = "*".join(_power(names[k], -n) for k, n in below.items())
    top = f"({total})" if len(parts) > 1 or first[0] == "-" else total
    return f"{top}/({divisor})" if len(below) > 1 else f"{top}/{divisor}"


def _power(name: str, n: int) -> str:
    return name if n == 1 else f"{name}**{n}"
