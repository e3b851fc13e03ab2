"""What a diagnosis changes of an FMU or a step function, in files that their own tools read.

``explained.ssv`` holds changed values as a parameter set of SSP (System Structure and
Parameterization 1.0, section 6), which importers of FMUs read beside the FMU. What is added to
rates stands in ``explained.py``, which runs the FMU with it, or is a step function again.
"""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

from jaxsr.models.formats.callback import meanings
from jaxsr.models.formats.fmu import Unit
from jaxsr.models.formats.summands import names_in, needed_by
from jaxsr.models.formats.unit_script import RUN_FMU, RUN_STEP
from jaxsr.models.model import Model

SSV, PY = "explained.ssv", "explained.py"
SAME = 1e-12
"""Relative difference below which a value was not changed."""


def edited_unit(unit: Unit, given: Model, explained: Model) -> tuple[dict[str, str], list[str]]:
    """Return files by name, and what was changed and what could not be.

    Parameters
    ----------
    unit : Unit
    given, explained : Model
        As the sidecar says, and as a diagnosis ended.
    """
    files: dict[str, str] = {}
    said: list[str] = []
    changed = {
        p: v.value
        for p, v in explained.parameters.items()
        if p in unit.variables
        and p in given.parameters
        and abs(v.value - given.parameters[p].value) > SAME * abs(v.value)
    }
    if changed and not unit.step_function:
        files[SSV] = ssv_text({unit.variables[p]: v for p, v in changed.items()})
        values = ", ".join(f"{unit.variables[p]} = {v:.6g}" for p, v in changed.items())
        said.append(f"{SSV} sets {values}")
    said += _left(given, explained)
    new = [s for s in explained.states if s in explained.equations and s not in given.states]
    if not explained.additions and not new and not (changed and unit.step_function):
        return files, said
    texts = [*explained.additions.values(), *(explained.equations[s] for s in new)]
    used = {
        n
        for d in needed_by(texts, explained.definitions)
        for n in names_in(explained.definitions[d])
    }
    used |= {n for text in texts for n in names_in(text)}
    field = explained.vector_field
    calls = sorted(used & set(field.gains)) if field is not None else []
    if calls:
        said.append(
            f"what is added is multiplied by {calls[0]}, which {unit.path.name} computes itself: "
            "it stands in explained.toml alone, for jaxsr simulate --model"
        )
        return files, said
    files[PY] = script_text(unit, explained, new)
    said.append(f"{PY} runs {unit.path.name} with what was added")
    return files, said


def _left(given: Model, explained: Model) -> list[str]:
    """Say what no file but explained.toml holds."""
    said = []
    for y, text in explained.readings.items():
        if given.readings.get(y) != text:
            said.append(f"the sensor {y} reads {text}: see explained.toml")
    for name, value in explained.delays.items():
        if given.delays.get(name) != value:
            seconds = explained.parameters[value].value if isinstance(value, str) else value
            said.append(f"a delay of {name} by {seconds:.4g} s stands in explained.toml alone")
    if explained.clock != given.clock:
        said.append("a clock stands in explained.toml alone")
    return said


def ssv_text(values: dict[str, float]) -> str:
    """Return a parameter set of SSP."""
    lines = [
        f'    <ssv:Parameter name={quoteattr(name)}><ssv:Real value="{value!r}"/></ssv:Parameter>'
        for name, value in values.items()
    ]
    space = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<ssv:ParameterSet xmlns:ssv="{space}" version="1.0" name="explained">\n'
        "  <ssv:Parameters>\n" + "\n".join(lines) + "\n  </ssv:Parameters>\n</ssv:ParameterSet>\n"
    )


def script_text(unit: Unit, explained: Model, new: list[str]) -> str:
    """Return ``explained.py``."""
    own = [s for s in explained.states if s not in explained.equations]
    needed = needed_by(
        [*explained.additions.values(), *(explained.equations[s] for s in new)],
        explained.definitions,
    )
    body = [f"{n} = {explained.definitions[n]}" for n in needed]
    rates = [explained.additions.get(s, "0.0") for s in own] + [
        f"{explained.equations[s]}" for s in new
    ]
    names = {n for text in (*body, *rates) for n in names_in(text)}
    constants = [f"{n} = {p.value!r}" for n, p in explained.parameters.items() if n in names]
    listed = [*own, *new]
    lines = [
        *meanings(names),
        *constants,
        "",
        "",
        "def added(t, x, u):",
        '    """Return what is added to the rates, and the rates of what the simulator has not."""',
        f"    {', '.join(listed)}, = x",
        *([f"    {', '.join(explained.inputs)}, = u"] if explained.inputs else []),
        *([f"    {explained.time} = t"] if explained.time != "t" else []),
        *(f"    {line}" for line in body),
        f"    return np.array([{', '.join(rates)}], dtype=float)",
    ]
    parameters = {
        unit.variables[p]: v.value for p, v in explained.parameters.items() if p in unit.variables
    }
    start = [explained.initial.get(s) for s in listed]
    values = {
        "name": unit.path.name,
        "stem": unit.path.stem,
        "function": (explained.base or "").rpartition(":")[2],
        "states": [unit.variables[s] for s in own],
        "listed": listed,
        "inputs": [unit.variables.get(u, u) for u in explained.inputs],
        "columns": [explained.column(u) for u in explained.inputs],
        "time": explained.column(explained.time),
        "parameters": parameters,
        "start": [float(v) if isinstance(v, int | float) else 0.0 for v in start],
        "step": unit.step,
        "count": len(own),
        "call": f"x[:{len(own)}], u" + (", p" if unit.arguments == 3 else ""),
        "lines": "\n".join(lines),
    }
    template = RUN_STEP if unit.step_function else RUN_FMU
    return template.format(**{k: v if isinstance(v, str) else repr(v) for k, v in values.items()})
