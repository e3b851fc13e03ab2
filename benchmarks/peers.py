"""Thin wrappers of the peers, imported only when called.

``operon`` and ``sindy`` return equations as SymPy expressions; ``OperonTrees`` and
``GplearnPrograms`` evaluate our terms with the peer's own machine.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from jaxsr.expressions import PRIMITIVES, Term

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


class OperonTrees:
    """Our terms as pyoperon's trees, on one data set.

    pyoperon keeps postfix order with the *first* argument next to the operator.

    Parameters
    ----------
    terms : sequence of Term
        Of add, sub, mul, div, sin, cos, exp, log, sqrt, tanh, abs, constants and variables.
    variables : sequence of str
        Names of the data's columns.
    data : ndarray of float32, (samples, variables)
    """

    def __init__(
        self, terms: Sequence[Term], variables: Sequence[str], data: NDArray[np.float32]
    ) -> None:
        self._module: Any = importlib.import_module("pyoperon")
        self._data = np.asfortranarray(data)  # kept: the data set is a view of it
        self._set: Any = self._module.Dataset(self._data)
        self._range: Any = self._module.Range(0, len(data))
        hashes = dict(zip(variables, self._set.VariableHashes, strict=True))
        self._trees = [self._tree(term, hashes) for term in terms]
        self._theta = np.zeros((len(terms), len(data)), np.float32)

    def _tree(self, term: Term, hashes: Mapping[str, int]) -> Any:
        nodes = [self._node(node, hashes) for node in term.walk()]
        return self._module.Tree(nodes[::-1]).UpdateNodes()

    def _node(self, node: Term, hashes: Mapping[str, int]) -> Any:
        if node.is_constant:
            return self._module.Node.Constant(node.value)
        if node.is_variable:
            out = self._module.Node.Variable(1.0)
            out.HashValue = out.CalculatedHashValue = hashes[node.name]
            return out
        return self._module.Node(getattr(self._module.NodeType, node.op.capitalize()))

    def evaluate(self, threads: int = 2) -> NDArray[np.float32]:
        """Return theta (terms, samples), always the same array: no page is touched first here."""
        theta = self._theta.reshape(-1)
        self._module.EvaluateTrees(self._trees, self._set, self._range, theta, threads)
        return self._theta


class GplearnPrograms:
    """Our terms as gplearn's programs, executed one by one.

    The operators are NumPy's own, without gplearn's protection: the same function as ours, and
    less work. gplearn makes constants float64, whatever the data are.
    """

    def __init__(self, terms: Sequence[Term], variables: Sequence[str]) -> None:
        from gplearn._program import _Program
        from gplearn.functions import _Function

        place = {name: k for k, name in enumerate(variables)}
        functions = {
            name: _Function(PRIMITIVES[name].numpy, name, PRIMITIVES[name].arity)
            for name in {node.op for term in terms for node in term.walk() if node.args}
        }

        def program(term: Term) -> Any:
            out: list[Any] = []
            for node in term.walk():
                if node.is_constant:
                    out.append(float(node.value))
                else:
                    out.append(place[node.name] if node.is_variable else functions[node.op])
            rest = dict.fromkeys(("function_set", "arities", "metric", "random_state"))
            return _Program(
                **rest,
                init_depth=(2, 6),
                init_method="grow",
                n_features=len(variables),
                const_range=(-1.0, 1.0),
                p_point_replace=0.0,
                parsimony_coefficient=0.0,
                program=out,
            )

        self._programs = [program(term) for term in terms]

    def evaluate(self, data: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return theta (terms, samples)."""
        theta = np.empty((len(self._programs), len(data)), np.float32)
        with np.errstate(all="ignore"):
            for row, program in zip(theta, self._programs, strict=True):
                row[:] = program.execute(data)
        return theta
