"""Thin wrappers of the peers, imported only when called: equations as SymPy expressions."""

from __future__ import annotations

import contextlib
import io
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

OPERON_SYMBOLS = "add,sub,mul,div,constant,variable,sin,cos,sqrt,exp,abs"
THRESHOLDS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)


@dataclass(frozen=True)
class Answer:
    """An equation found by a peer, and the seconds it took."""

    expression: sympy.Expr
    seconds: float


def missing(name: str) -> str | None:
    """Return why a peer cannot run, None if it can."""
    try:
        __import__(name)
    except ImportError:
        return "not installed"
    return None


def operon(columns: Mapping[str, np.ndarray], y: np.ndarray, seed: int, seconds: float) -> Answer:
    """Return pyoperon's pick: Levenberg-Marquardt, population 1000, 2 threads, time at most."""
    from pyoperon.sklearn import SymbolicRegressor

    names = list(columns)
    X = np.column_stack([columns[n] for n in names])
    model = SymbolicRegressor(
        allowed_symbols=OPERON_SYMBOLS,
        optimizer="lm",
        optimizer_iterations=10,
        population_size=1000,
        generations=1_000_000,
        max_evaluations=1_000_000_000,
        n_threads=2,
        max_time=max(1, round(seconds)),
        random_state=seed,
    )
    began = time.perf_counter()
    model.fit(X, np.array(y))  # a copy: it takes no read-only array
    spent = time.perf_counter() - began
    text = model.get_model_string(model.model_, precision=17)
    known: dict[str, Any] = {f"X{k + 1}": sympy.Symbol(n, real=True) for k, n in enumerate(names)}
    return Answer(
        sympy.parse_expr(text.replace("^", "**"), local_dict=known | {"abs": sympy.Abs}), spent
    )


def sindy(
    recordings: Sequence[Mapping[str, np.ndarray]],
    states: Sequence[str],
    inputs: Sequence[str],
    held: Sequence[Mapping[str, np.ndarray]],
) -> dict[str, Answer]:
    """Return pysindy's equation for every state: STLSQ over a polynomial and Fourier library.

    Parameters
    ----------
    recordings : mappings of column to samples, with ``t`` and ``dSTATE``
    states, inputs : sequence of str
        Inputs are held as they are; name ``t`` to let the library use time.
    held
        Recordings on which the threshold is chosen, for each equation by itself, by the error
        of the derivative; a larger threshold wins within 1 %.
    """
    import pysindy

    def matrices(part: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        X = np.column_stack([part[n] for n in (*states, *inputs)])
        return X, np.column_stack([part[f"d{s}"] for s in states])

    pairs = [matrices(part) for part in recordings]
    X, rates = (np.vstack([p[k] for p in pairs]) for k in (0, 1))
    checks = [matrices(part) for part in held]
    X_held, rates_held = (np.vstack([p[k] for p in checks]) for k in (0, 1))
    # sines and cosines of 1, ..., 5 times every column, time among them: this library happens to
    # hold the frequencies 2 and 5 of the two-mass chain
    polynomial, waves = pysindy.PolynomialLibrary(degree=3), pysindy.FourierLibrary(n_frequencies=5)
    library = pysindy.GeneralizedLibrary([polynomial, waves])
    began = time.perf_counter()
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        theta = np.asarray(library.fit_transform(X))
        theta_held = np.asarray(library.transform(X_held))
        scale = np.linalg.norm(theta, axis=0) / np.sqrt(len(theta))
        scale[scale == 0.0] = 1.0
        best: list[tuple[float, np.ndarray]] = [(np.inf, np.zeros(0))] * len(states)
        for threshold in THRESHOLDS:
            for k in range(len(states)):
                # in units of the target's rms, so that one grid serves all equations
                size = float(np.sqrt(np.mean(rates[:, k] ** 2)))
                fit = pysindy.STLSQ(threshold=threshold, alpha=1e-10, max_iter=20)
                fit.fit(theta / scale, rates[:, [k]] / size)
                xi = np.asarray(fit.coef_)[0] * size / scale
                error = float(np.mean((theta_held @ xi - rates_held[:, k]) ** 2))
                if error <= max(1.01 * best[k][0], 1e-20 * size**2):
                    best[k] = (error, xi)
    spent = time.perf_counter() - began
    names = _readable(library, (*states, *inputs))
    return {
        s: Answer(
            sympy.Add(
                *(sympy.Float(c, 17) * f for c, f in zip(best[k][1], names, strict=True) if c)
            ),
            spent / len(states),
        )
        for k, s in enumerate(states)
    }


def _readable(library: Any, columns: Sequence[str]) -> list[sympy.Expr]:
    known: dict[str, Any] = {c: sympy.Symbol(c, real=True) for c in columns}
    out = []
    for name in library.get_feature_names(list(columns)):
        out.append(sympy.parse_expr(name.replace("^", "**").replace(" ", "*"), local_dict=known))
    return out
