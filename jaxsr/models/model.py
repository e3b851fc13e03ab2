"""The model: one immutable value for a simulator, a discovered model and an explained model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

from jaxsr._result import InputError
from jaxsr.expressions import Term, parse, to_text
from jaxsr.expressions.derivative import built
from jaxsr.expressions.parsing import MAX_CHARACTERS
from jaxsr.models.parameter import Parameter
from jaxsr.models.rates import rate_symbols, rate_terms

if TYPE_CHECKING:
    from jaxsr.models.force_factor import Factor
    from jaxsr.models.traced_rates import VectorField
    from jaxsr.recordings import Recording

FREE = "free"
DRIVEN = "driven"
"""Start of a state that its drive decides: never estimated, and in no model file."""
Hold = Literal["linear", "zero", "bandlimited"]


@dataclass(frozen=True)
class Event:
    """A jump of states when an expression crosses zero."""

    when: str
    direction: int
    reset: Mapping[str, str]


def _in_order(error: InputError, later: Mapping[str, str], known: Mapping[str, None]) -> InputError:
    """Say of an unknown symbol that is a definition further down that it is one."""
    for name in later:
        if name not in known and error.what == f"unknown symbol {name!r}":
            what = f"{name!r} is defined by itself or further down"
            remedy = "Order definitions so that each uses earlier ones alone"
            return InputError(what, error.where, remedy)
    return error


@dataclass(frozen=True)
class Model:
    """A model file as a value (docs/model-file.md).

    With states x, inputs u, parameters p and time t,

        sum_j inertia[i][j] * dx_j/dt = equations[i]        (identity where no row is given)
        output_k(t) = readings_k at time clock_k(t) - delay_k

    `noise` and `resolution` hold what a data sheet says of an output, in its unit: the standard
    deviation of the sensor's noise, and the step of its converter, whose readings lie on a grid
    of it. Steps that are read without a word of theirs are noise; three times as wide as stated,
    they are a finding.

    Expressions are kept as the text of the file; `term` parses them. Where the model stands on a
    Python function (`base`), `vector_field` holds what that function says; it is in no file, and
    no part of what makes two models equal. `forces` are forces by the state along which they act,
    in no file either: a file says in its equations, or in [additions], what they add to the rates.
    `factors` say by what they are multiplied there, where edits must not change it (`pinned`).
    `within` takes out of a recording what the equations do not cover, such as a robot's contacts.
    """

    name: str
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    equations: Mapping[str, str]
    readings: Mapping[str, str]
    inputs: tuple[str, ...] = ()
    time: str = "t"
    input_hold: Hold = "linear"
    sample_time: float | None = None
    base: str | None = None
    additions: Mapping[str, str] = field(default_factory=dict[str, str])
    definitions: Mapping[str, str] = field(default_factory=dict[str, str])
    inertia: Mapping[str, Mapping[str, str]] = field(default_factory=dict[str, Mapping[str, str]])
    parameters: Mapping[str, Parameter] = field(default_factory=dict[str, Parameter])
    per_recording: Mapping[str, Mapping[str, float]] = field(
        default_factory=dict[str, Mapping[str, float]]
    )
    initial: Mapping[str, float | str] = field(default_factory=dict[str, float | str])
    delays: Mapping[str, float | str] = field(default_factory=dict[str, float | str])
    clock: Mapping[str, str] = field(default_factory=dict[str, str])
    noise: Mapping[str, float] = field(default_factory=dict[str, float])
    resolution: Mapping[str, float] = field(default_factory=dict[str, float])
    events: tuple[Event, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    columns: Mapping[str, str] = field(default_factory=dict[str, str])
    vector_field: VectorField | None = field(default=None, compare=False, repr=False)
    forces: Mapping[str, str] = field(default_factory=dict[str, str])
    factors: Mapping[str, Factor] | None = field(default=None, compare=False, repr=False)
    within: Callable[[Recording], Recording] | None = field(default=None, compare=False, repr=False)

    def __hash__(self) -> int:
        return hash((self.name, self.states, tuple(self.equations.items())))

    @property
    def symbols(self) -> tuple[str, ...]:
        """Names an expression may use, definitions apart."""
        return (self.time, *self.states, *self.inputs, *self.parameters)

    @cached_property
    def definition_terms(self) -> dict[str, Term]:
        """Definitions with earlier ones substituted."""
        given = dict[str, Term]() if self.vector_field is None else self.vector_field.gains
        terms = {name: term for name, term in given.items() if name not in self.definitions}
        known = dict.fromkeys((*self.symbols, *terms))
        for name, text in self.definitions.items():
            try:
                term = parse(text, known.keys(), f"[definitions] {name}", longest=MAX_CHARACTERS)
            except InputError as error:
                raise _in_order(error, self.definitions, known) from None
            terms[name] = term.substitute(terms)
            known[name] = None
        return terms

    @cached_property
    def _names(self) -> frozenset[str]:
        return frozenset((*self.symbols, *self.definition_terms, *self._promised))

    def term(self, text: str, where: str = "", extra: tuple[str, ...] = ()) -> Term:
        """Parse an expression of this model, definitions substituted."""
        names = self._names.union(extra) if extra else self._names
        term = parse(text, names, where, longest=MAX_CHARACTERS)
        known = self.definition_terms
        return term.substitute(known) if known else term

    @property
    def _promised(self) -> tuple[str, ...]:
        """Symbols that a Python function gives a meaning, once it is loaded."""
        if self.base is None or self.vector_field is not None:
            return ()
        return tuple(f"{s}_per_{u}" for s in self.states for u in self.inputs)

    @property
    def formulas(self) -> bool:
        """Whether all equations are known: a Python function has to be loaded for it."""
        return self.base is None or self.vector_field is not None

    @cached_property
    def equation_terms(self) -> dict[str, Term]:
        """Right-hand side by state, additions included."""
        terms = dict(self._own_terms)
        forces = {s: self.term(f, f"force along {s}") for s, f in self.forces.items()}
        if self.vector_field is not None:
            terms = self.vector_field.forced(forces, self.term) | terms
        else:
            for state, force in forces.items():
                for row, factor in self.force_factors[state].rows:
                    terms[row] = built("add", terms[row], built("mul", factor, force))
        for state, text in self.additions.items():
            added = self.term(text, f"[additions] {state}")
            terms[state] = Term.apply("add", terms[state], added) if state in terms else added
        return terms

    @cached_property
    def _own_terms(self) -> dict[str, Term]:
        """Right-hand sides as the equations say them."""
        return {s: self.term(e, f"[equations] {s}") for s, e in self.equations.items()}

    @cached_property
    def force_factors(self) -> Mapping[str, Factor]:
        """What forces along states are multiplied by in equations, where that is not 1."""
        from jaxsr.models.force_factor import force_factors

        if self.factors is not None:
            return self.factors
        return {} if self.base is not None else force_factors(self, self._own_terms)

    def pinned(self) -> Model:
        """Return the model with the factors of its forces as they are, whatever edits follow."""
        return replace(self, factors=self.force_factors)

    def entries(self, state: str) -> tuple[tuple[str, str], ...]:
        """Return the rates to which a force along a state adds, with the text of its factors."""
        if self.vector_field is not None and state in self.vector_field.columns:
            return self.vector_field.columns[state].rows
        if state in self.force_factors:
            return tuple((row, to_text(term)) for row, term in self.force_factors[state].rows)
        return ((state, ""),)

    @cached_property
    def reading_terms(self) -> dict[str, Term]:
        """Reading by output, d(STATE) replaced by what the equations say."""
        return {y: self._reading(e, f"[readings] {y}") for y, e in self.readings.items()}

    def _reading(self, text: str, where: str) -> Term:
        plain, symbols = rate_symbols(text, self.states)
        term = self.term(plain, where, tuple(symbols))
        if not symbols:
            return term
        return term.substitute({name: self.rate_terms[s] for name, s in symbols.items()})

    @cached_property
    def rate_terms(self) -> dict[str, Term]:
        """Rate of every state as a formula, the mass matrix solved."""
        return rate_terms(self)

    @cached_property
    def inertia_terms(self) -> dict[str, dict[str, Term]]:
        """Mass matrix entries by row and column state."""
        return {
            i: {j: self.term(e, f"[inertia] {i}.{j}") for j, e in row.items()}
            for i, row in self.inertia.items()
        }

    @property
    def free_parameters(self) -> tuple[str, ...]:
        """Names of the parameters that may be re-calibrated."""
        return tuple(name for name, p in self.parameters.items() if p.free)

    def column(self, role: str) -> str:
        """Column of a recording that holds `role`."""
        return self.columns.get(role, role)

    def kinematic_parent(self, state: str) -> str | None:
        """Return q where the model says d(q)/dt = `state` and nothing more."""
        for parent, term in self.equation_terms.items():
            if term.is_variable and term.name == state and parent not in self.inertia:
                return parent
        return None

    @property
    def dynamic_states(self) -> tuple[str, ...]:
        """States whose equation says more than that they are another state's integral."""
        return tuple(
            s
            for s in self.states
            if s not in self.driven
            and (s in self.inertia or not self._integrates_a_state(self.equation_terms[s]))
        )

    @property
    def driven(self) -> tuple[str, ...]:
        """States that start where the recorded inputs and sensors have driven them."""
        return tuple(s for s in self.states if self.initial.get(s) == DRIVEN)

    def _integrates_a_state(self, term: Term) -> bool:
        return term.is_variable and term.name in self.states
