"""The weak view: signals integrated against compact test functions."""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
import scipy.sparse as sparse

from jaxsr._result import InputError

GAP = 3.0  # an interval longer than this many medians is a gap
_MOMENTS = 4  # polynomials below this degree are integrated exactly, whatever the grid
_CHUNK = 4_000_000  # entries of the weights made at once


@dataclass(frozen=True, eq=False)
class WeakView:
    r"""Integrate signals and their derivatives against test functions, by parts.

    With phi(s) proportional to (1 - s^2)^order, s = (t - c) / half_width, scaled so that its
    integral is 1, row c of ``integrate(y, k)`` is

        (-1)^k * int phi^(k)(t) y(t) dt  =  int phi(t) y^(k)(t) dt,

    so that no derivative of data is ever taken. Made by `WeakView.build`.

    Attributes
    ----------
    time : ndarray, shape (samples,)
    centres : ndarray, shape (tests,)
        Centre of each test function, in seconds.
    valid : ndarray of bool, shape (tests,)
        False where the support touches a missing sample or a gap.
    half_width : float
        Half the support, in seconds.
    order : int
        Exponent of (1 - s^2).
    matrices : tuple of csr_array, shape (tests, samples)
        The weights for k = 0, 1, 2.

    References
    ----------
    Messenger and Bortz, "Weak SINDy: Galerkin-based data-driven model selection",
    Multiscale Model. Simul. 19 (2021), Eq. 2.2 and section 3.
    """

    time: np.ndarray
    centres: np.ndarray
    valid: np.ndarray
    half_width: float
    order: int
    matrices: tuple[sparse.csr_array, sparse.csr_array, sparse.csr_array]

    @staticmethod
    def build(
        time: np.ndarray,
        half_width: float,
        spacing: float | None = None,
        order: int = 8,
        mask: np.ndarray | None = None,
    ) -> WeakView:
        """Place test functions over a record.

        Parameters
        ----------
        time : ndarray, shape (samples,)
            Strictly increasing, in seconds; need not be uniform.
        half_width : float
            Half the support of a test function, in seconds.
        spacing : float, optional
            Distance of the centres in seconds; a quarter of `half_width` by default.
        order : int
            Exponent of (1 - s^2), at least 3 so that the second derivative ends at zero.
        mask : ndarray of bool, shape (samples,), optional
            True where a sample is present in every signal that will be integrated.

        Raises
        ------
        InputError
            If the record is shorter than one support, or a support has too few samples.
        """
        time = np.asarray(time, dtype=np.float64)
        spacing = half_width / 4.0 if spacing is None else spacing
        _check(time, half_width, spacing, order)
        present = np.ones(time.size, bool) if mask is None else np.asarray(mask, dtype=bool)
        centres = _centres(time, half_width, spacing)
        first = np.searchsorted(time, centres - half_width, side="left")
        stop = np.searchsorted(time, centres + half_width, side="right")
        valid = _valid(time, present, centres, half_width, stop - first)
        matrices = _matrices(time, centres, first, stop, valid, half_width, order)
        return WeakView(time, centres, valid, float(half_width), order, matrices)

    def covered(self, present: np.ndarray) -> np.ndarray:
        """Return which supports hold no missing sample, shape (tests,).

        Parameters
        ----------
        present : ndarray of bool, shape (samples,)
        """
        missing = np.concatenate([[0], np.cumsum(~np.asarray(present, dtype=bool))])
        first = np.searchsorted(self.time, self.centres - self.half_width, side="left")
        stop = np.searchsorted(self.time, self.centres + self.half_width, side="right")
        return missing[stop] == missing[first]

    def integrate(self, y: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Return int phi y^(derivative) dt for every test function.

        Parameters
        ----------
        y : ndarray, shape (samples,) or (samples, columns)
        derivative : int
            0, 1 or 2.

        Returns
        -------
        ndarray, shape (tests,) or (tests, columns)
            NaN in the rows that are not `valid`.
        """
        y = np.asarray(y, dtype=np.float64)
        if y.shape[0] != self.time.size:
            raise InputError(f"y has {y.shape[0]} samples, the view {self.time.size}")
        result = np.asarray(self.matrices[derivative] @ y)
        result[~self.valid] = np.nan
        return result


def _check(time: np.ndarray, half_width: float, spacing: float, order: int) -> None:
    span = time[-1] - time[0]
    if not (np.isfinite(half_width) and 0.0 < 2.0 * half_width <= span * (1 + 1e-12)):
        raise InputError(
            f"test functions of half-width {half_width:.4g} s do not fit into {span:.4g} s",
            remedy="Use a shorter half-width or a longer recording",
        )
    if not spacing > 0.0:
        raise InputError(f"spacing of test functions is {spacing}", remedy="Give seconds above 0")
    if order < 3:
        raise InputError(f"order={order} of the test functions", remedy="Use 3 or more")


def _centres(time: np.ndarray, half_width: float, spacing: float) -> np.ndarray:
    """Evenly spaced, whole supports inside the record, what is left over shared by both ends."""
    room = max(time[-1] - time[0] - 2.0 * half_width, 0.0)
    steps = int(np.floor(room / spacing + 1e-9))
    start = time[0] + half_width + (room - steps * spacing) / 2.0
    return start + spacing * np.arange(steps + 1)


def _valid(
    time: np.ndarray,
    present: np.ndarray,
    centres: np.ndarray,
    half_width: float,
    samples: np.ndarray,
) -> np.ndarray:
    """Whether every support is free of missing samples and of gaps."""
    times = time[present]
    if times.size < 2:
        return np.zeros(centres.size, bool)
    before = np.searchsorted(time, centres - half_width, side="left")
    after = np.searchsorted(time, centres + half_width, side="right")
    missing = np.concatenate([[0], np.cumsum(~present)])
    whole = missing[after] == missing[before]
    dt = np.diff(time)
    long = dt > GAP * np.median(dt)
    starts, ends = time[:-1][long], time[1:][long]
    # gaps are disjoint and ordered: count those that begin before the end and end after the start
    inside = np.searchsorted(starts, centres + half_width) - np.searchsorted(
        ends, centres - half_width, side="right"
    )
    return whole & (inside <= 0) & (samples >= _MOMENTS + 1)


def _matrices(
    time: np.ndarray,
    centres: np.ndarray,
    first: np.ndarray,
    stop: np.ndarray,
    valid: np.ndarray,
    half_width: float,
    order: int,
) -> tuple[sparse.csr_array, sparse.csr_array, sparse.csr_array]:
    quadrature = np.empty(time.size)
    quadrature[1:-1] = (time[2:] - time[:-2]) / 2.0
    quadrature[[0, -1]] = (time[1] - time[0]) / 2.0, (time[-1] - time[-2]) / 2.0
    rows = np.flatnonzero(valid)
    counts = np.zeros(centres.size, dtype=np.int64)
    counts[rows] = (stop - first)[rows]
    pointer = np.concatenate([[0], np.cumsum(counts)])
    data = np.zeros((3, pointer[-1]))
    indices = np.zeros(pointer[-1], dtype=np.int64)
    width = int(counts.max(initial=1))
    for part in np.array_split(rows, max(1, -(-rows.size * width // _CHUNK))):
        columns = first[part, None] + np.arange(width)
        inside = columns < stop[part, None]
        columns = np.minimum(columns, time.size - 1)
        s = np.where(inside, (time[columns] - centres[part, None]) / half_width, 1.0)
        weights = _weights(s, np.where(inside, quadrature[columns], 0.0), half_width, order)
        place = (pointer[part, None] + np.arange(width))[inside]
        data[:, place] = weights[:, inside]
        indices[place] = columns[inside]
    shape = (centres.size, time.size)
    zeroth, first_, second = (sparse.csr_array((d, indices, pointer), shape=shape) for d in data)
    return zeroth, first_, second


def _weights(s: np.ndarray, quadrature: np.ndarray, half_width: float, order: int) -> np.ndarray:
    """Weights of the three integrals, shape (3, tests, width).

    The trapezoid rule is nearly exact for these smooth compact functions on a uniform grid. On
    any grid a small multiple of phi * polynomial is added so that polynomials up to degree 3 are
    integrated exactly by parts; constants then leave no trace in a derivative.
    """
    p = order
    bump = np.clip(1.0 - s**2, 0.0, None)
    phi = bump**p
    phi_1 = -2.0 * p * s * bump ** (p - 1)
    phi_2 = -2.0 * p * bump ** (p - 1) + 4.0 * p * (p - 1) * s**2 * bump ** (p - 2)
    scale = 1.0 / np.sum(quadrature * phi, axis=1, keepdims=True)
    base = quadrature * scale * np.stack([phi, -phi_1, phi_2])
    powers = s[..., None] ** np.arange(_MOMENTS)
    weighted = base[0][..., None] * powers
    gram = np.einsum("iwa,iwb->iab", weighted, powers)
    moments = np.einsum("kiw,iwa->kia", base, powers)
    wanted = np.stack([_moments_of_phi(order, k) for k in range(3)])[:, None, :]
    correction = np.linalg.solve(gram[None], (wanted - moments)[..., None])[..., 0]
    exact = base + np.einsum("iwa,kia->kiw", weighted, correction)
    return exact / half_width ** np.arange(3)[:, None, None]


def _moments_of_phi(order: int, derivative: int) -> np.ndarray:
    """int phi d^k(s^m)/ds^k ds for m = 0 ... 3, with int phi ds = 1."""
    second = 1.0 / (2 * order + 3)  # int s^2 phi ds
    plain = {0: 1.0, 1: 0.0, 2: second, 3: 0.0}
    return np.array(
        [
            factorial(m) / factorial(m - derivative) * plain[m - derivative]
            if m >= derivative
            else 0.0
            for m in range(_MOMENTS)
        ]
    )
