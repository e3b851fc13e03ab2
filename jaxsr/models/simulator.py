"""The simulator: a vector field plus readings, differentiable in states and parameters."""

# JAX and pandas state the types of some members in part alone.
# pyright: reportUnknownMemberType=false
from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxsr._files import sha256
from jaxsr._result import InputError
from jaxsr.expressions import DISCONTINUOUS, Term, evaluate
from jaxsr.models.arrays import Array, Arrays
from jaxsr.models.exports.exported import Exported
from jaxsr.models.mass_matrix import pivoted_rows
from jaxsr.models.model import Model
from jaxsr.models.stepping import factorised
from jaxsr.recordings import Recording

Named = dict[str, Any]
Shared = dict[Term, Any]
SMOOTHED = frozenset({"sign", "heaviside"})
DEFAULT_WIDTH = 1e-4


class Simulator(Exported, eqx.Module):
    """A model that can be run.

    Parameters
    ----------
    model : Model
    function : callable, optional
        A Python vector field ``f(t, x, u, p) -> dx`` with x and u arrays in the order of the
        model's states and inputs and p a mapping from parameter names to values; replaces the
        model's [equations]. It is called as it is; `from_file` reads it as formulas where it can
        (`vector_field`), which runs faster.
    files : tuple of (str, str)
        Names and SHA-256 of the files that it was read from.

    Notes
    -----
    ``sign(a)`` is run as ``tanh(a/w)`` and ``Heaviside(a)`` as ``(1 + tanh(a/w))/2``. The
    widths w are arguments (`widths`, one per distinct a), so that a fit can set them from the
    scale of a in the recordings.
    """

    model: Model = eqx.field(static=True)
    function: Callable[..., Any] | None = eqx.field(static=True, default=None)
    files: tuple[tuple[str, str], ...] = eqx.field(static=True, default=())

    @staticmethod
    def from_file(path: str | Path, model: str | Path | None = None) -> Simulator:
        """Read a simulator from ``model.toml``, ``robot.xml`` or ``path/file.py:function``.

        Parameters
        ----------
        path : path
        model : path, optional
            For a Python function: the model file that stands on it, such as the explained.toml
            of a diagnosis; by default ``path/file.toml``. For a robot: its sidecar.

        Raises
        ------
        InputError
            The model cannot be read, or a TOML asks for Python that was not named in the call.
        """
        return Simulator._read(path, model).read_from(path, model)

    def read_from(self, *paths: str | Path | None) -> Simulator:
        """Return the simulator as one that was read from these files, none of them for None."""
        names = (re.sub(r"\.py:[^/\\]*$", ".py", str(path)) for path in paths if path is not None)
        files = (Path(name) for name in names)
        read = tuple((file.name, sha256(file)) for file in files if file.is_file())
        return Simulator(self.model, self.function, read)

    @staticmethod
    def _read(path: str | Path, model: str | Path | None) -> Simulator:
        """Read a simulator by the kind of its file."""
        from jaxsr._arguments import is_format
        from jaxsr.models.document import read_document
        from jaxsr.models.python_base import read_python_simulator
        from jaxsr.models.reading import build_model

        text = str(path)
        if ".py:" in text or text.endswith(".py"):
            from jaxsr.models.formats.step_map import is_step, read_steps

            if is_step(text):
                return read_steps(text, model).simulator
            return read_python_simulator(text, model)
        if text.lower().endswith(".fmu"):
            from jaxsr.models.formats.fmu import read_fmu

            return read_fmu(text, model).simulator
        if is_format(text):
            from jaxsr.models.formats.opening import read_robot

            return Simulator(read_robot(text, model).model)
        if model is not None:
            raise InputError("two model files", f"{text} and {model}", "Name one of them")
        document = read_document(Path(path))
        head = document.get("model")
        base = cast("Any", head).get("base") if isinstance(head, Mapping) else None
        if isinstance(base, str) and is_format(base):
            remedy = f"Name {Path(text).parent / base} itself"
            raise InputError(f"is the sidecar of {base}", text, remedy)
        found = build_model(document, Path(path).name)
        if found.base is not None:
            raise InputError(
                f"the model stands on Python ({found.base})",
                text,
                f"Name it in the call: {_with_table(Path(text), found.base)}",
            )
        return Simulator(found)

    @staticmethod
    def from_sympy(
        equations: Mapping[Any, Any],
        parameters: Mapping[Any, Any] | None = None,
        *,
        inputs: Sequence[Any] = (),
        readings: Mapping[str, Any] | None = None,
        inertia: Any = None,
        name: str = "model",
        **tables: Any,
    ) -> Simulator:
        """Return the simulator of SymPy equations.

        Parameters
        ----------
        equations : mapping
            State to its rate; with `inertia`, to the generalised force along it. A state is a
            symbol, a name, or a function of time as those of ``sympy.physics.mechanics``.
        parameters : mapping, optional
            Symbol or name to a value, to ``(value, low, high)`` where it may be re-calibrated, or
            to a row of [parameters].
        inputs : sequence of symbols, optional
        readings : mapping, optional
            Output to what its sensor reads; by default every state is read.
        inertia : SymPy Matrix or mapping of mappings, optional
            Mass matrix in the order of the states, or by state and state.
        name : str
        **tables
            Other tables of a model file: ``initial``, ``units``, ``columns``, ``noise``, ...

        Raises
        ------
        InputError
            An expression is outside the grammar, or a table breaks a rule of model files.

        Examples
        --------
        >>> import sympy
        >>> q, v, u, c = sympy.symbols("q v u c")
        >>> Simulator.from_sympy({q: v, v: u - c * v}, {c: (0.5, 0, 2)}, inputs=[u]).model.states
        ('q', 'v')
        """
        from jaxsr.models.from_sympy import model_of

        document = dict(inputs=inputs, readings=readings, inertia=inertia, name=name, **tables)
        return Simulator(model_of(equations, parameters or {}, document))

    def simulate(
        self,
        recording: Recording | None = None,
        *,
        duration: float | None = None,
        dt: float | None = None,
    ) -> Recording:
        """Run the model freely, finely enough to be trusted.

        Parameters
        ----------
        recording : Recording, optional
            Time and inputs; a start that [initial] leaves free is estimated on its first 5 %.
        duration, dt : float, optional
            Length and interval in s, without a recording.

        Returns
        -------
        Recording
            Inputs and outputs under the names of their columns, and the other states.

        Raises
        ------
        InputError
            Inputs or starts are unknown, or no step resolves the model.
        """
        from jaxsr.models.simulation import simulate_to_csv

        table = simulate_to_csv(self, recording, duration, dt)
        name = self.model.name if recording is None else recording.name
        time = table.pop(self.model.column(self.model.time))
        channels = {str(column): values.to_numpy() for column, values in table.items()}
        return Recording(f"simulated {name}", time.to_numpy(), channels)

    # Compiled runs are kept by simulator: properties already computed must not tell two apart,
    # and parameters in another order must, since they are passed by position.
    def __hash__(self) -> int:
        return hash((self.model, self.function))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Simulator):
            return False
        same = self.model == other.model and self.function is other.function
        same = same and self.model.vector_field is other.model.vector_field
        return same and tuple(self.model.parameters) == tuple(other.model.parameters)

    @cached_property
    def smoothed_arguments(self) -> tuple[Term, ...]:
        """Distinct arguments of sign and Heaviside that depend on a state."""
        found: dict[Term, None] = {}
        for term in self._all_terms():
            for node in term.distinct():
                if node.op in SMOOTHED and node.args[0].variables & set(self.model.states):
                    found.setdefault(node.args[0])
        return tuple(found)

    @property
    def discontinuous(self) -> bool:
        """Whether an equation jumps."""
        return any(term.uses(DISCONTINUOUS) for term in self._all_terms())

    @property
    def default_widths(self) -> tuple[float, ...]:
        """Widths used where nothing is known of the scale."""
        return (DEFAULT_WIDTH,) * len(self.smoothed_arguments)

    def values(self, changes: Mapping[str, float] | None = None) -> tuple[float, ...]:
        """Parameter values in the order of the model, with `changes` made."""
        changes = changes or {}
        return tuple(changes.get(n, p.value) for n, p in self.model.parameters.items())

    def environment(self, t: Array, x: Arrays, u: Arrays, p: Arrays) -> Named:
        """Names to arrays."""
        model = self.model
        env: Named = {model.time: t}
        env.update(zip(model.states, x, strict=True))
        env.update(zip(model.inputs, u, strict=True))
        env.update(zip(model.parameters, p, strict=True))
        return env

    def rates(self, t: Array, x: Arrays, u: Arrays, p: Arrays, widths: Arrays = ()) -> Arrays:
        """Return dx/dt, one array per state (inputs and outputs alike are tuples of arrays)."""
        model = self.model
        env, shared = self._prepared(t, x, u, p, widths)
        if self.function is not None:
            forces = list(self._python_rates(t, x, u, env))
            for state, term in self.smooth_equations.items():
                i = model.states.index(state)
                forces[i] = forces[i] + evaluate(term, env, "jax", shared)
            rates: Named = dict(zip(model.states, forces, strict=True))
        else:
            rates = {s: evaluate(e, env, "jax", shared) for s, e in self.smooth_equations.items()}
        if model.inertia:
            rates = self._accelerations(rates, env, shared)
        like = jnp.zeros_like(sum(x) + 0.0 * t)
        return tuple(rates[s] + like for s in model.states)

    def forces(self, t: Array, x: Arrays, u: Arrays, p: Arrays, widths: Arrays = ()) -> Arrays:
        """Return the right-hand sides: generalised forces where a mass matrix stands."""
        env, shared = self._prepared(t, x, u, p, widths)
        if self.function is not None:
            return self.rates(t, x, u, p, widths)
        return tuple(
            evaluate(self.smooth_equations[s], env, "jax", shared) for s in self.model.states
        )

    def inertia(self, t: Array, x: Arrays, u: Arrays, p: Arrays) -> dict[tuple[str, str], Array]:
        """Return the mass matrix entries (row, column); identity rows are left out."""
        env = self.environment(t, x, u, p)
        shared: Shared = {}
        return {
            (i, j): evaluate(term, env, "jax", shared)
            for i, row in self.model.inertia_terms.items()
            for j, term in row.items()
        }

    def readings(self, t: Array, x: Arrays, u: Arrays, p: Arrays, widths: Arrays = ()) -> Arrays:
        """Return what the sensors read, one array per output."""
        env, shared = self._prepared(t, x, u, p, widths)
        return tuple(
            evaluate(self.smooth_readings[y], env, "jax", shared) for y in self.model.outputs
        )

    def _all_terms(self) -> list[Term]:
        return [*self.model.equation_terms.values(), *self.model.reading_terms.values()]

    def _prepared(
        self, t: Array, x: Arrays, u: Arrays, p: Arrays, widths: Arrays
    ) -> tuple[Named, Shared]:
        env = self.environment(t, x, u, p)
        widths = widths or self.default_widths
        env.update({f"width {i}": w for i, w in enumerate(widths)})
        return env, {}

    @cached_property
    def smooth_equations(self) -> dict[str, Term]:
        known: dict[Term, Term] = {}
        return {s: self._smooth(e, known) for s, e in self.model.equation_terms.items()}

    @cached_property
    def smooth_readings(self) -> dict[str, Term]:
        known: dict[Term, Term] = {}
        return {y: self._smooth(e, known) for y, e in self.model.reading_terms.items()}

    def _smooth(self, term: Term, known: dict[Term, Term]) -> Term:
        """Return a term with rounded steps; `known` holds those of subtrees met before."""
        for node in term.upward(known):
            known[node] = self._rounded(node, known)
        return known.get(term, term)

    def _rounded(self, term: Term, known: dict[Term, Term]) -> Term:
        args = tuple(known.get(arg, arg) for arg in term.args)
        if term.op in SMOOTHED and term.args[0] in self.smoothed_arguments:
            width = Term.variable(f"width {self.smoothed_arguments.index(term.args[0])}")
            sign = Term.apply("tanh", Term.apply("div", args[0], width))
            if term.op == "sign":
                return sign
            half = Term.constant(0.5)
            return Term.apply("add", half, Term.apply("mul", half, sign))
        return term if args == term.args else Term(term.op, args)

    @cached_property
    def mass_rows(self) -> tuple[str, ...]:
        """States with a row in [inertia], in the order in which the rows are eliminated."""
        return pivoted_rows(self.model)

    def _accelerations(self, rates: Named, env: Named, shared: Shared) -> Named:
        """Solve the mass matrix for the rates of the states that have a row in it."""
        rows = tuple(s for s in self.model.states if s in self.model.inertia)
        matrix = [[0.0 for _ in rows] for _ in rows]
        right: list[Any] = []
        for i, row in enumerate(self.mass_rows):
            force = rates[row]
            for column, term in self.model.inertia_terms[row].items():
                entry = evaluate(term, env, "jax", shared)
                if column in rows:
                    matrix[i][rows.index(column)] = entry
                else:
                    force = force - entry * rates[column]
            right.append(force)
        solved = factorised(matrix)(tuple(right))
        return {**rates, **dict(zip(rows, solved, strict=True))}

    def _python_rates(self, t: Array, x: Arrays, u: Arrays, env: Named) -> Arrays:
        p = {name: env[name] for name in self.model.parameters}
        # One call per segment through vmap: users write f for one state vector.
        import jax

        xs = jnp.stack(jnp.broadcast_arrays(*x), axis=-1)
        us = jnp.stack(jnp.broadcast_arrays(*u), axis=-1) if u else jnp.zeros((*xs.shape[:-1], 0))
        assert self.function is not None
        function = self.function
        if xs.ndim == 1:
            return tuple(jnp.moveaxis(jnp.asarray(function(t, xs, us, p)), -1, 0))
        ts = jnp.broadcast_to(t, xs.shape[:-1])

        def rates(t: Any, x: Any, u: Any, p: Any) -> jax.Array:
            return jnp.asarray(function(t, x, u, p))

        p = {name: jnp.broadcast_to(v, xs.shape[:-1]) for name, v in p.items()}
        return tuple(jnp.moveaxis(jax.vmap(rates)(ts, xs, us, p), -1, 0))


def _with_table(table: Path, base: str) -> str:
    """Return how a Python function is named with its table, as far as the table tells."""
    beside = table.parent / base
    if table.stem == Path(base).stem:
        return str(beside)
    there = Path(str(beside).rpartition(":")[0]).is_file()
    return f"{beside if there else f'path/{base}'} with --model {table}"


def width_scales(simulator: Simulator, environment: Mapping[str, np.ndarray]) -> tuple[float, ...]:
    """Widths for sign and Heaviside: 2/1000 of the rms of their argument in the recordings.

    Half as much where a reading has the jump in it, as accelerometers do: it shows the width
    itself, not what the motion makes of it.
    """
    terms = simulator.model.reading_terms.values()
    seen = {n.args[0] for t in terms for n in t.distinct() if n.op in SMOOTHED}
    widths: list[float] = []
    for argument in simulator.smoothed_arguments:
        value = np.asarray(evaluate(argument, environment, "numpy"), dtype=float)
        rms = float(np.sqrt(np.nanmean(value**2)))
        share = 1e-3 if argument in seen else 2e-3
        widths.append(share * rms if np.isfinite(rms) and rms > 0 else DEFAULT_WIDTH)
    return tuple(widths)
