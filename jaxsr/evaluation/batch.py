"""A batch of terms compiled once and evaluated on any data."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxsr._result import InputError
from jaxsr.evaluation.cache import ColumnCache
from jaxsr.evaluation.engine import Engine, EngineConfig
from jaxsr.evaluation.interpreter import interpret
from jaxsr.expressions.parsing import parse
from jaxsr.expressions.postfix import OPERATORS, PostfixBatch, compile_postfix, decompile
from jaxsr.expressions.term import CONSTANT, VARIABLE, Term

if TYPE_CHECKING:
    from jaxtyping import Float

Method = Literal["machine", "columns", "interpreter"]
_IN_POSTFIX = frozenset(OPERATORS) | {CONSTANT, VARIABLE}


class TermBatch:
    """Terms ready to be evaluated.

    Parameters
    ----------
    terms : sequence of Term or PostfixBatch
    variables : sequence of str
        Order of the columns of the data.
    config : EngineConfig, optional
        Threads, samples at a time, device.
    """

    def __init__(
        self,
        terms: Sequence[Term] | PostfixBatch,
        variables: Sequence[str],
        config: EngineConfig | None = None,
    ) -> None:
        self.variables = tuple(variables)
        self._terms = None if isinstance(terms, PostfixBatch) else tuple(terms)
        self._rest = np.zeros(0, dtype=np.intp)  # terms that only columns can evaluate
        if isinstance(terms, PostfixBatch):
            self._postfix = terms
        else:
            self._postfix = self._written(self.terms)
        self._count = len(terms)
        self._engine = Engine(self._postfix, config)

    def __len__(self) -> int:
        return self._count

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms."""
        if self._terms is None:
            self._terms = tuple(decompile(self.postfix()))
        return self._terms

    @property
    def unique_fraction(self) -> float:
        """Distinct inner nodes, which are computed, over all inner nodes of the terms."""
        return self._engine.unique_fraction

    def evaluate(
        self,
        data: ArrayLike,
        engine: Method = "machine",
        *,
        out: Float[np.ndarray, "samples terms"] | None = None,
    ) -> Float[np.ndarray, "samples terms"]:
        """Return theta (samples, terms) for data (samples, variables).

        float32 data give float32, anything else float64. A sample at which a term has no finite
        value is NaN or infinite there.

        Parameters
        ----------
        data : array_like, (samples, variables)
        engine : {"machine", "columns", "interpreter"}
            ``machine`` runs the compiled register machine: each distinct subtree once, on all
            cores. ``columns`` does the same in NumPy, which needs no compilation; terms that are
            no pointwise function of built-in primitives (``integral``, ``Piecewise``, functions
            of the user) are evaluated so in any case. ``interpreter`` runs the postfix reference.
        out : ndarray, (samples, terms), optional
            Where to write theta; fresh memory costs as much as the evaluation itself. Fastest with
            each term's samples side by side: ``np.empty((terms, samples), dtype).T``.

        Raises
        ------
        InputError
            The data have another number of columns than there are variables, or ``out`` another
            shape or type than theta.
        """
        values = self._checked(data)
        if out is not None:
            if out.shape != (len(values), len(self)) or out.dtype != values.dtype:
                raise InputError(
                    f"out is {out.dtype} {out.shape}",
                    "TermBatch.evaluate",
                    f"Give {values.dtype} {(len(values), len(self))}.",
                )
            if engine == "machine" and not len(self._rest):
                return self._engine.columns(values.T, out.T).T
            out[...] = self.evaluate(values, engine)
            return out
        if engine == "interpreter":
            return interpret(self.postfix(), values)
        if engine == "columns":
            return self._columns(values, range(len(self)))
        if engine != "machine":
            known = "Use 'machine', 'columns' or 'interpreter'."
            raise InputError(f"unknown engine {engine!r}", "", known)
        if not len(self._rest):
            return self._engine.columns(values.T).T
        theta = np.empty((len(values), len(self)), values.dtype)
        plain = np.setdiff1d(np.arange(len(self)), self._rest)
        theta[:, plain] = self._engine.columns(values.T).T
        theta[:, self._rest] = self._columns(values, self._rest.tolist())
        return theta

    def each(self, data: ArrayLike, use: Callable[[NDArray[Any], slice, slice], Any]) -> list[Any]:
        """Call ``use(block, terms, samples)`` on blocks (terms, samples) of the library.

        A block is valid during the call only, and blocks come from several threads: sums over
        samples are taken so without ever holding the library.

        Raises
        ------
        InputError
            The data have another number of columns than there are variables, or a term needs
            whole recordings or a function of the user.
        """
        self._needs_no_recordings()
        return self._engine.each(self._checked(data).T, use)

    def resident(self, data: jax.Array) -> jax.Array:
        """Return theta (samples, terms) on the device, for data (samples, variables) there.

        Nothing comes back to the host. The memory lies term by term: the transpose is the array
        as it was written.

        Raises
        ------
        InputError
            As for :meth:`each`.
        """
        self._needs_no_recordings()
        with jax.enable_x64(True):
            return self._engine.resident(jnp.asarray(data).T).T

    def _needs_no_recordings(self) -> None:
        if len(self._rest):
            raise InputError(
                f"term {self._rest[0]} cannot be evaluated by blocks of samples",
                "TermBatch.each",
                "Use evaluate.",
            )

    def moments(self, data: ArrayLike, y: ArrayLike) -> tuple[NDArray[Any], ...]:
        r"""Return :math:`\sum\theta`, :math:`\sum\theta^2` and :math:`\sum\theta y` of each term.

        These are what a fitness of single terms needs. The library is never held.

        Parameters
        ----------
        data : array_like, (samples, variables)
        y : array_like, (samples,)

        Returns
        -------
        tuple of ndarray, (terms,)
            In float64; not finite where a term is not.
        """
        values = self._checked(data)
        target = np.asarray(y, values.dtype)
        if target.shape != (len(values),):
            raise InputError(f"y has shape {target.shape}, data has {len(values)} samples", "y")
        if self._engine.is_resident and len(self):
            return self._moments_there(values, target)
        total = np.zeros((3, len(self)))

        def reduced(block: NDArray[Any], terms: slice, samples: slice) -> Any:
            with np.errstate(all="ignore"):
                ones = np.ones(block.shape[1], block.dtype)
                squares = np.einsum("ij,ij->i", block, block)
                return terms, np.stack([block @ ones, squares, block @ target[samples]])

        for terms, part in self.each(values, reduced):
            total[:, terms] += part
        return tuple(total)

    def _moments_there(
        self, values: NDArray[np.floating], target: NDArray[np.floating]
    ) -> tuple[NDArray[Any], ...]:
        self._needs_no_recordings()

        def sums(columns: jax.Array, part: slice) -> NDArray[Any]:
            with jax.enable_x64(True):
                return np.stack(_sums()(columns, target[part]))

        parts = self._engine.reduced(np.ascontiguousarray(values.T), sums)
        return tuple(np.sum(parts, axis=0))

    def postfix(self) -> PostfixBatch:
        """Return the terms as postfix arrays.

        Raises
        ------
        InputError
            A term has no postfix code.
        """
        return compile_postfix(self.terms, self.variables) if len(self._rest) else self._postfix

    def _checked(self, data: ArrayLike) -> NDArray[np.floating]:
        values = np.asarray(data)
        if values.ndim != 2 or values.shape[1] != len(self.variables):
            raise InputError(
                f"data must be (samples, {len(self.variables)}), got shape {values.shape}",
                "TermBatch.evaluate",
                f"One column for each of {', '.join(self.variables) or 'no variables'}.",
            )
        dtype = np.float32 if values.dtype == np.float32 else np.float64
        return values.astype(dtype, copy=False)

    def _columns(self, values: NDArray[np.floating], places: Sequence[int]) -> NDArray[Any]:
        columns = dict(zip(self.variables, values.T, strict=True))
        cache = ColumnCache(columns, limit_bytes=2**62, dtype=values.dtype.type)
        theta = np.empty((len(values), len(places)), values.dtype)
        for place, term in enumerate(places):
            theta[:, place] = cache.column(self.terms[term])
        return theta

    def _written(self, terms: tuple[Term, ...]) -> PostfixBatch:
        """Return postfix code of the terms that have one; remember which have none."""
        try:
            return compile_postfix(terms, self.variables)
        except InputError:
            plain = [all(node.op in _IN_POSTFIX for node in term.walk()) for term in terms]
        for term in itertools.compress(terms, np.logical_not(plain)):
            unknown = sorted(term.variables - set(self.variables))
            if unknown:
                known = f"Known: {', '.join(self.variables)}."
                raise InputError(f"unknown variable {unknown[0]}", "", known)
        self._rest = np.flatnonzero(np.logical_not(plain))
        return compile_postfix(list(itertools.compress(terms, plain)), self.variables)


@functools.cache
def _sums() -> Any:
    """Return what adds up columns (terms, samples), their squares and their products with y."""

    def sums(columns: jax.Array, y: jax.Array) -> tuple[jax.Array, ...]:
        wide = columns.astype(jnp.float64)
        return jnp.sum(wide, 1), jnp.sum(wide * wide, 1), jnp.sum(wide * y.astype(jnp.float64), 1)

    return jax.jit(sums)


def compile_terms(
    terms: Sequence[str | Term] | PostfixBatch,
    variables: Sequence[str] | None = None,
    config: EngineConfig | None = None,
) -> TermBatch:
    """Make a batch of terms.

    Parameters
    ----------
    terms : sequence of str or Term, or PostfixBatch
        Strings are read in the model grammar.
    variables : sequence of str, optional
        Names of the data's columns, in order; a PostfixBatch brings its own.
    config : EngineConfig, optional
        Threads, samples at a time, device.

    Raises
    ------
    InputError
        A term uses a name that is not a variable.
    """
    if isinstance(terms, PostfixBatch):
        return TermBatch(terms, terms.variables, config)
    if variables is None:
        raise InputError("variables are missing", "compile_terms", "Name the data's columns.")
    names = tuple(variables)
    read = tuple(parse(t, names, "terms") if isinstance(t, str) else t for t in terms)
    return TermBatch(read, names, config)
