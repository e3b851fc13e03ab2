"""Candidates: one mechanism at one site, as an edit of a model with neutral values."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from jaxsr._result import Verdict
from jaxsr.diagnosis.mechanisms.jumps import jumps_in
from jaxsr.models import Edit, Model, Parameter, apply_edit
from jaxsr.models.balance import Balance
from jaxsr.models.bracket import add_force
from jaxsr.models.edits import add_to_equation
from jaxsr.models.force_columns import written
from jaxsr.models.model import DRIVEN, FREE
from jaxsr.models.simulator import SMOOTHED

UNNAMED = "unnamed"
"""What a law without a name is called."""
UNLIMITED = 1e12
"""Stands for no limit: bounds of a model file are numbers."""


@dataclass(frozen=True)
class ParameterSpec:
    """A constant of a mechanism.

    Attributes
    ----------
    name : str
        As in docs/mechanisms.md.
    unit : str or None
    low, high : float
        Physical limits (friction dissipates: `low` is 0).
    neutral : float
        The value at which the mechanism does nothing (coefficients), or the value that the
        shape starts from (inner constants).
    coefficient : bool
        Whether the effect is linear in it and vanishes at `neutral`.
    fixed : bool
        Whether it is written but never estimated: it only sets the scale of a state.
    hard : bool
        Whether `high` stands for a hard edge, so that an estimate may end there.
    floor : str or None
        Constant of the same mechanism that it is never below, by its own name.
    """

    name: str
    unit: str | None = None
    low: float = -UNLIMITED
    high: float = UNLIMITED
    neutral: float = 0.0
    coefficient: bool = True
    fixed: bool = False
    hard: bool = False
    floor: str | None = None


@dataclass(frozen=True)
class AddedState:
    """A state that a mechanism brings along.

    Attributes
    ----------
    name : str
        Templates of the candidate use it in braces, as they do parameters.
    equation : str
        Template of its rate.
    initial : float or "free"
        Its start in the edited model. While candidates are compared its start is estimated where a
        recording begins; later segments start where the recording has driven it from there.
    """

    name: str
    equation: str
    unit: str | None = None
    initial: float | str = FREE


@dataclass(frozen=True)
class Candidate:
    """A mechanism at a site.

    Templates hold parameter names in braces, e.g. ``"- {Fc}*sign(v)"``.

    Attributes
    ----------
    terms : tuple of (state, template)
        Signed terms appended to equations; forces where the model says how a force along a state
        enters its rates (`entering`).
    inertia : tuple of (row, column, template)
        Terms added to the mass matrix.
    readings : tuple of (output, template)
        New readings; ``{old}`` stands for the old one.
    fixed_parameter : str or None
        For ``wrong_value``: the parameter of the model that is set free.
    states : tuple of AddedState
    replaced : tuple of (symbol, template)
        Inputs for which another expression stands in every equation. Where candidates are
        compared, a switch (0 or 1) blends the two: no value of a time constant undoes a lag
        without making it stiff.
    delays : tuple of (input or output, template)
        Entries of [delays]: the name of a parameter.
    clock : tuple of (output, template)
        Entries of [clock].
    quiet : tuple of str
        Recordings in which the first parameter is zero: a push happened in another one.
    tried : float
        Places at which it was looked for, or laws as long among which it was chosen: what stands
        out of many is worth less.
    borrowed : tuple of (own name, parameter)
        Constants of the mechanism for which parameters of the model stand.
    physical : callable or None
        Tells of values by their own names whether such a thing exists, where bounds cannot.
    substeps : int
        Fewest steps of RK4 between two samples that its states need.
    stiff : bool
        Whether it may be so steep that only an L-stable method follows it.
    sentence : str
        What it means, with ``{site}``.
    """

    mechanism: str
    family: str
    site: str
    parameters: tuple[ParameterSpec, ...]
    sentence: str
    terms: tuple[tuple[str, str], ...] = ()
    inertia: tuple[tuple[str, str, str], ...] = ()
    readings: tuple[tuple[str, str], ...] = ()
    fixed_parameter: str | None = None
    states: tuple[AddedState, ...] = ()
    replaced: tuple[tuple[str, str], ...] = ()
    delays: tuple[tuple[str, str], ...] = ()
    clock: tuple[tuple[str, str], ...] = ()
    quiet: tuple[str, ...] = ()
    tried: float = 1.0
    borrowed: tuple[tuple[str, str], ...] = ()
    physical: Callable[[Mapping[str, float]], bool] | None = None
    substeps: int = 1
    stiff: bool = False
    source: str = ""

    @property
    def jumps(self) -> bool:
        """Whether a law jumps: has a sign that no power of the sign's argument takes to zero."""
        return jumps_in(text for _, text in self.terms)

    @property
    def sharp(self) -> bool:
        """Whether a law jumps, which simulation rounds."""
        return any(f"{op}(" in template for _, template in self.terms for op in SMOOTHED)

    @property
    def label(self) -> str:
        """Mechanism and site, e.g. ``coulomb_friction@equation:v``."""
        return f"{self.mechanism}@{self.site}"

    @property
    def key(self) -> str:
        """Label and inner constants: tells variants of one mechanism apart."""
        inner = [f"{p.name}={p.neutral:.4g}" for p in self.parameters if not p.coefficient]
        return " ".join([self.label, *inner])

    @property
    def passing(self) -> bool:
        """Whether it acts in its recordings alone: a push is no part of the model."""
        return self.family == "external"

    @property
    def verdict(self) -> Verdict:
        """The verdict this family stands for; delay and gain of an input are no structure."""
        if self.mechanism == "input_delay":
            return Verdict.MEASUREMENT
        if self.mechanism == "input_gain":
            return Verdict.PARAMETER
        return {
            "parameter": Verdict.PARAMETER,
            "measurement": Verdict.MEASUREMENT,
            "external": Verdict.EXTERNAL_INPUT,
        }.get(self.family, Verdict.STRUCTURE)

    def names(self, taken: Iterable[str], suffix: str = "") -> dict[str, str]:
        """Choose parameter names that clash with none of `taken`."""
        if self.fixed_parameter is not None:
            return {self.fixed_parameter: self.fixed_parameter}
        used, chosen = set(taken), {}
        state = self.site.partition(":")[2]
        for spec in self.parameters:
            name = f"{spec.name}{suffix}"
            if name in used:
                name = f"{spec.name}_{state}{suffix}"
            count = 2
            while name in used:
                name, count = f"{spec.name}_{state}_{count}{suffix}", count + 1
            chosen[spec.name] = name
            used.add(name)
        return chosen

    def edit(
        self, model: Model, names: Mapping[str, str], values: Mapping[str, float] | None = None
    ) -> Edit:
        """Return the complete edit of `model`, with `values` by the candidate's own names."""
        values = values or {}
        if self.fixed_parameter is not None:
            old = model.parameters[self.fixed_parameter]
            value = values.get(self.fixed_parameter, old.value)
            spec = self.parameters[0]
            bounds = old.bounds or (spec.low, spec.high)
            bounds = (min(bounds[0], value), max(bounds[1], value))
            return Edit({f"parameters.{self.fixed_parameter}": Parameter(value, old.unit, bounds)})
        draft = _Draft(model)
        self._add_parameters(draft, names, values)
        local = {**names, **self._add_states(draft, names, final=bool(values))}
        for symbol, template in self.replaced:
            switch = None if values else self.switch(names)
            _replace_symbol(draft, symbol, template.format(**local), switch, local.values())
        self._add_terms(draft, local, final=bool(values))
        for row, column, template in self.inertia:
            entry = draft.model.inertia.get(row, {}).get(column, "1" if row == column else "0")
            draft.put(f"inertia.{row}.{column}", f"{entry} + {template.format(**local)}")
        for output, template in self.readings:
            old = draft.model.readings[output]
            draft.put(f"readings.{output}", template.format(old=old, **local))
        for signal, template in self.delays:
            draft.put(f"delays.{signal}", template.format(**local))
        for output, template in self.clock:
            old = draft.model.clock.get(output)
            text = template.format(**local)
            draft.put(f"clock.{output}", f"({old})*({text})" if old else text)
        if self.quiet:
            first = names[self.parameters[0].name]
            draft.put(f"per_recording.{first}", dict.fromkeys(self.quiet, 0.0))
        if values:
            _define_gains(draft)
        if self.replaced and not values:
            draft.put(f"parameters.{self.switch(names)}", Parameter(0.0, None, (0.0, 5.0)))
        return Edit(draft.changes)

    def _add_parameters(
        self, draft: _Draft, names: Mapping[str, str], values: Mapping[str, float]
    ) -> None:
        for spec in self.parameters:
            value = values.get(spec.name, spec.neutral)
            bounds = _readable(spec, value) if values else (spec.low, spec.high)
            parameter = Parameter(value, spec.unit, None if spec.fixed else bounds)
            draft.put(f"parameters.{names[spec.name]}", parameter)

    def _add_terms(self, draft: _Draft, names: Mapping[str, str], final: bool) -> None:
        """Add the terms as forces: to formulas beside the others, to a Python function's rates."""
        if not final:
            for state, template in self.terms:
                draft.put(*add_to_equation(draft.model, state, template.format(**names), "forces"))
        elif draft.model.base is None:
            for state, template in self.terms:
                for change in add_force(draft.model, state, template.format(**names)):
                    draft.put(*change)
        else:
            for state, template in self.entering(draft.model):
                draft.put(*add_to_equation(draft.model, state, template.format(**names)))

    def entering(self, model: Model) -> tuple[tuple[str, str], ...]:
        """Return the terms as parts of rates.

        A force enters as the inputs do, by the column of df/du beside which it acts, or by the
        factor common to the terms of the rate.
        """
        return tuple(
            (row, times(factor, template))
            for state, template in self.terms
            for row, factor in model.entries(state)
        )

    def balancing(self, model: Model) -> tuple[tuple[str, str], ...]:
        """Return the terms with the states in whose rows of the weak view they stand.

        Those of a `Balance` are balances of forces: there a force stands for itself, alone.
        """
        balance = Balance.of(model)
        if balance is None:
            return self.terms
        own = [(s, template) for s, template in self.terms if s in balance.states]
        others = [(s, t) for s, t in self.entering(model) if s not in balance.states]
        return (*own, *others)

    def switch(self, names: Mapping[str, str]) -> str:
        """Return the name of the switch of a candidate with replaced symbols."""
        return f"on_{names[self.parameters[0].name]}"

    def _add_states(self, draft: _Draft, names: Mapping[str, str], final: bool) -> dict[str, str]:
        """Add the states of the mechanism, and return their names in the model."""
        if not self.states:
            return {}
        first, place = self.parameters[0].name, self.site.partition(":")[2]
        suffix = names[first][len(first) :]
        model, chosen = draft.model, {}
        taken = {*model.symbols, *model.definitions, *model.outputs, *names.values()}
        for state in self.states:
            options = [f"{state.name}{suffix}", f"{state.name}_{place}{suffix}"]
            options += [f"{options[1]}_{count}" for count in range(2, 100)]
            chosen[state.name] = next(name for name in options if name not in taken)
        draft.put("model.states", (*model.states, *chosen.values()))
        for state in self.states:
            name = chosen[state.name]
            draft.put(f"equations.{name}", state.equation.format(**{**names, **chosen}))
            draft.put(f"initial.{name}", state.initial if final else DRIVEN)
            if state.unit is not None:
                draft.put(f"units.{name}", state.unit)
        return chosen

    def term_text(self, names: Mapping[str, str]) -> str:
        """Return the added term as text."""
        if self.fixed_parameter is not None:
            return self.fixed_parameter
        names = {**{s.name: s.name for s in self.states}, **names}
        parts = [t.format(**names) for _, t in self.terms[:1]]
        parts += [t.format(**names) for _, _, t in self.inertia[:1]]
        parts += [t.format(old="reading", **names) for _, t in self.readings[:1]]
        parts += [s.equation.format(**names) for s in self.states[:1]]
        parts += [t.format(**names) for _, t in (*self.delays, *self.clock)]
        text = parts[0] if parts else ""
        return (
            text.removeprefix("+ ").replace("- ", "-", 1) if text.startswith(("+ ", "- ")) else text
        )


@dataclass
class _Draft:
    """A model under change, and the changes made."""

    model: Model
    changes: dict[str, Any] = field(default_factory=dict)

    def put(self, key: str, value: Any) -> None:
        self.changes[key] = value
        self.model = apply_edit(self.model, Edit({key: value}))


def times(factor: str, template: str) -> str:
    """Return a factor times a signed template; an empty factor is 1."""
    if not factor:
        return template
    factor = factor if re.fullmatch(r"[\w.]+", factor) else f"({factor})"
    own = f"-{template[2:]}" if template.startswith("- ") else template.removeprefix("+ ")
    return f"+ {factor}*({own})"


def _define_gains(draft: _Draft) -> None:
    """Write the gains that additions name among the definitions, so that the file says them."""
    model, used = draft.model, " ".join(str(v) for v in draft.changes.values())
    gains = {} if model.vector_field is None else model.vector_field.gains
    for name, gain in gains.items():
        if name in model.definitions or not re.search(rf"\b{name}\b", used):
            continue
        text = written(gain)
        if text is not None:
            draft.put(f"definitions.{name}", text)


def _replace_symbol(
    draft: _Draft, symbol: str, text: str, switch: str | None, added: Iterable[str]
) -> None:
    """Write `text` for an input in definitions and equations, those of `added` states apart.

    With a switch, the input itself stands there where the switch is 0. A Python function keeps
    its input; by how that enters, the difference is added to its rates.
    """
    new = f"({text})" if switch is None else f"({symbol} + {switch}*({text} - {symbol}))"
    if switch is None and re.fullmatch(r"\w+", text):
        new = text
    word, own = re.compile(rf"\b{re.escape(symbol)}\b"), set(added)
    for table in ("definitions", "equations", "additions", "forces"):
        for key, old in dict(getattr(draft.model, table)).items():
            if key not in own and word.search(old):
                draft.put(f"{table}.{key}", word.sub(lambda _: new, old))
    if draft.model.vector_field is not None:
        for state, factor in draft.model.vector_field.inputs.get(symbol, ()):
            change = times(factor, f"+ ({new} - {symbol})")
            draft.put(*add_to_equation(draft.model, state, change))


def _readable(spec: ParameterSpec, value: float) -> tuple[float, float]:
    """Bounds for a model file: the physical ones, or ten times the value where there are none."""
    reach = float(f"{10.0 * abs(value):.1g}") or 1.0
    low = spec.low if spec.low > -UNLIMITED else -reach
    high = spec.high if spec.high < UNLIMITED else reach
    return min(low, value), max(high, value)
