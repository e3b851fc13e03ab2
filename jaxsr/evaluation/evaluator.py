"""The one evaluator of a search: new terms in one batch, by the compiled machine or by NumPy."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from jaxsr.evaluation.cache import ColumnCache
from jaxsr.evaluation.engine import Engine, EngineConfig
from jaxsr.evaluation.open import OpenTerms, written
from jaxsr.evaluation.resident import has_kernel, padded, put
from jaxsr.expressions.postfix import OPERATORS, PostfixBatch, compile_postfix
from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import BOOLEAN, CONSTANT, VARIABLE, Term

Array = NDArray[Any]

PIECE = 4096
"""Samples gone through at once where columns are reduced: a few of them fill a core's cache."""
TOGETHER = 512
"""Most terms whose columns are reduced together, and columns that the machine holds at once."""
_COMPILED_FROM = 32_768  # samples; columns this long no longer fit a core's cache
_SLOPES_FROM, _SLOPES_WORK = 8192, 2**17  # samples; samples times sets of terms
_RESIDENT_FROM = 32_768  # samples; see `resident_device`
_COMPILED_NODES = 2**22  # terms times samples of a batch after which more batches will follow
_IN_POSTFIX = frozenset(OPERATORS) | {CONSTANT, VARIABLE}
_LEAVES = frozenset({CONSTANT, VARIABLE, BOOLEAN})


def is_compiled(samples: int, terms: int) -> bool:
    """Tell whether a batch of new terms pays for the compiled machine; the others follow it.

    Measured (``python -m benchmarks.generation``): up to 16,000 samples NumPy's columns stay in a
    core's cache and the machine gains at most half, which never repays its compilation (1.5 s of
    a core, once for a process and a number of variables); at 65,000 it is three times as fast on
    each core. An estimate of a few terms, however long, is not worth compiling for.
    """
    return samples >= _COMPILED_FROM and terms * samples >= _COMPILED_NODES


def are_slopes_compiled(samples: int, sets: int) -> bool:
    """Tell whether a search over the constants of so many sets pays for the compiled machine.

    Measured as above: from 8,000 samples on a population's first search saves what the compilation
    costs; on fewer samples, and for a few sets, NumPy's slopes are as fast. It depends on nothing
    that went before, so that a search that is resumed goes on as if it had not stopped.
    """
    return samples >= _SLOPES_FROM and samples * sets >= _SLOPES_WORK


def resident_device(samples: int) -> Any:
    """Return the device on which a search keeps its columns; None for the host.

    Measured (``python -m benchmarks.throughput_gpu``): at 10,000 samples a generation gains a
    seventh, and programs take ten seconds to compile, once; at 100,000 it is more than twice as
    fast as eight cores. A device is worth using with the kernel made for it alone.
    """
    if samples < _RESIDENT_FROM or jax.default_backend() != "gpu" or not has_kernel():
        return None
    return jax.devices()[0]


class Evaluator:
    """Columns of terms on fixed samples.

    New terms go to the compiled machine as one batch of postfix arrays, each distinct subtree
    computed once, on all cores. With few samples, and for terms that have no postfix code
    (integrals, ``Piecewise``, functions of the user), the columns are NumPy's, every subtree's
    kept: the reference. Which of both is settled by :func:`is_compiled` alone, at the first batch
    that is large enough; from then on a column's last bit does not depend on the batch.

    Parameters
    ----------
    variables : mapping of str to ndarray, (samples,)
    limit_bytes : int
        Memory for columns that are kept.
    time, group
        As for :class:`jaxsr.evaluation.ColumnCache`.
    threads : int, optional
        By default one for each core this process may use.

    Attributes
    ----------
    variables : dict of str to ndarray, (samples,)
    threads : int or None
    cache : ColumnCache
        Of NumPy's columns, and of those of the machine that are kept.
    device : jax.Device or None
        Where a search keeps its columns; None for the host.
    """

    def __init__(
        self,
        variables: Mapping[str, Array],
        limit_bytes: int = 128 * 2**20,
        *,
        time: str | Array = "t",
        group: Array | None = None,
        threads: int | None = None,
    ) -> None:
        self.cache = ColumnCache(variables, limit_bytes, time=time, group=group)
        self.variables = {n: np.asarray(v, np.float64) for n, v in variables.items()}
        self._names = tuple(self.variables)
        self._samples = next((len(v) for v in self.variables.values()), 1)
        self.threads = threads
        self._data: Array | None = None
        self._there: jax.Array | None = None
        self._compiled = False
        self.device = resident_device(self._samples) if self._names else None

    def serves(self, terms: int) -> bool:
        """Tell whether the compiled machine evaluates so many new terms, and those to come."""
        if not self._compiled and self._names:
            self._compiled = is_compiled(self._samples, terms)
        return self._compiled

    def column(self, term: Term, *, keep: bool = True) -> Array:
        """Return the column (samples,) of a term, every subtree of it kept, by NumPy."""
        return self.cache.column(term, keep=keep)

    def columns(self, terms: Sequence[Term], *, keep: bool = True) -> Array:
        """Return the columns (samples, terms), each term's samples side by side.

        Parameters
        ----------
        terms : sequence of Term
        keep : bool
            Whether the columns are kept for the next call; those of a search over constants
            are visited once.
        """
        out = np.empty((len(terms), self._samples))
        new: dict[Term, list[int]] = {}
        if self.serves(len(terms)):
            for place, term in enumerate(terms):
                if term.args and term not in self.cache and _is_coded(term):
                    new.setdefault(term, []).append(place)
        done = {place for places in new.values() for place in places}
        for place, term in enumerate(terms):
            if place not in done:
                out[place] = self.cache.column(term, keep=keep)
        if new:
            self._fill(out, new)
            for term, places in new.items() if keep else ():
                self.cache.hold(term, out[places[0]].copy())
        return out.T

    def reduced(
        self, terms: Sequence[Term], use: Callable[[Array, slice], Any], samples: int | None = None
    ) -> list[Any]:
        """Return what ``use(columns, rows)`` makes of each piece of the samples, in their order.

        ``columns`` (terms, rows of the piece) are valid during the call only. The compiled machine
        goes through several pieces at once, so ``use`` must write to nothing that is shared.

        Parameters
        ----------
        samples : int, optional
            How many there are, for terms without variables.
        """
        served = self.serves(len(terms))
        fits = _is_coded if served else is_pointwise
        whole = {k: self.cache.column(t, keep=False) for k, t in enumerate(terms) if not fits(t)}
        plain = [k for k in range(len(terms)) if k not in whole]
        rows = samples or self._samples

        def complete(columns: Array, part: slice) -> Any:
            if not whole:
                return use(columns, part)
            every = np.empty((len(terms), part.stop - part.start))
            every[plain] = columns
            for place, column in whole.items():
                every[place] = column[part]
            return use(every, part)

        if served and plain and len(plain) <= TOGETHER:
            engine = self._engine([terms[k] for k in plain])

            def piece(block: Array, _: slice, part: slice) -> Any:
                return complete(block, part)

            return engine.each(self._matrix(), piece, whole=True)
        columns = np.empty((len(plain), min(PIECE, rows)))
        answers = []
        for first in range(0, rows, PIECE):
            part = slice(first, min(first + PIECE, rows))
            here = columns[:, : part.stop - first]
            samples_of = {name: values[part] for name, values in self.variables.items()}
            cache = ColumnCache(samples_of, 8 * PIECE * max(64, len(plain)))
            for slot, k in enumerate(plain):
                here[slot] = cache.column(terms[k])
            answers.append(complete(here, part))
        return answers

    def differentiates(self, sets: int) -> bool:
        """Tell whether the compiled machine searches over the constants of so many sets."""
        return bool(self._names) and are_slopes_compiled(self._samples, sets)

    def opens(self, form: Term, count: int) -> PostfixBatch | None:
        """Return the code of a form and its derivatives by ``count`` open constants.

        None where it holds what the machine does not know.
        """
        return written(form, count, self._names)

    def opened(
        self, forms: Sequence[PostfixBatch], first: Sequence[int]
    ) -> Callable[[Array, Callable[[Array, slice], Any]], list[Any]]:
        """Return a function of open constants, which starts with those numbered ``first``.

        It takes constants and what is made of each piece; see
        :meth:`jaxsr.evaluation.open.OpenTerms.each`.
        """
        terms = OpenTerms(forms, first, self._names, self._config())
        return functools.partial(terms.each, self._matrix())

    def opened_there(
        self, forms: Sequence[PostfixBatch], first: Sequence[int]
    ) -> Callable[[Array], jax.Array]:
        """Return a function of open constants to the columns on the device.

        Rows of zeros stand behind those of the forms, up to a power of four.
        """
        config = EngineConfig(device=self.device)
        terms = OpenTerms(forms, first, self._names, config, padded(sum(map(len, forms)), 128))
        return functools.partial(terms.resident, self._variables_there())

    def resident(self, terms: Sequence[Term]) -> jax.Array:
        """Return columns (terms, samples) on the device.

        The last is repeated behind them, up to a power of four: what is compiled for a shape
        serves many batches.
        """
        count = padded(len(terms), 16)
        coded = [k for k, term in enumerate(terms) if _is_coded(term)]
        if len(coded) == len(terms):
            batch = compile_postfix([*terms, *[terms[-1]] * (count - len(terms))], self._names)
            engine = Engine(batch, EngineConfig(device=self.device))
            return engine.resident(self._variables_there())
        out = np.empty((count, self._samples))
        for k, term in enumerate(terms):
            out[k] = self.cache.column(term, keep=False)
        out[len(terms) :] = out[len(terms) - 1]
        return put(out, self.device)

    def _variables_there(self) -> jax.Array:
        if self._there is None:
            self._there = put(self._matrix(), self.device)
        return self._there

    def _fill(self, out: Array, new: Mapping[Term, Sequence[int]]) -> None:
        """Evaluate distinct terms in one batch, each into its rows of ``out``."""
        engine = self._engine(list(new))
        if len(new) == len(out):
            engine.columns(self._matrix(), out)
            return
        places = np.array([places[0] for places in new.values()])

        def keep(block: Array, own: slice, samples: slice) -> None:
            out[places[own], samples] = block

        engine.each(self._matrix(), keep)
        for first, *others in new.values():
            out[others] = out[first]

    def _config(self) -> EngineConfig:
        host = jax.local_devices(backend="cpu")[0] if jax.default_backend() != "cpu" else None
        return EngineConfig(self.threads, chunk=PIECE, window=TOGETHER, device=host)

    def _engine(self, terms: Sequence[Term]) -> Engine:
        return Engine(compile_postfix(terms, self._names), self._config())

    def _matrix(self) -> Array:
        """Return the variables (variables, samples), made once."""
        if self._data is None:
            self._data = np.array([self.variables[name] for name in self._names])
        return self._data


class Reference(Evaluator):
    """The same by NumPy at any number of samples: what the machine is tested against."""

    def serves(self, terms: int) -> bool:
        """Tell that the machine evaluates nothing."""
        return False

    def differentiates(self, sets: int) -> bool:
        """Tell that the machine evaluates nothing."""
        return False


def is_pointwise(term: Term) -> bool:
    """Tell whether a value depends on the same sample's variables alone."""
    return all(node.op in _LEAVES or PRIMITIVES[node.op].pointwise for node in term.walk())


def _is_coded(term: Term) -> bool:
    return all(node.op in _IN_POSTFIX for node in term.walk())
