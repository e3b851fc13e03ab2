"""The sidecar of a simulator: ``robot.toml`` beside ``robot.xml``, drafted at the first call."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.models.document import read_document
from jaxsr.models.formats.columns import Matched
from jaxsr.models.formats.summands import names_in
from jaxsr.models.writing import table_text

SWITCHES = ("fixed_base", "contacts", "limits")
"""Keys of [model] that say what a robot met: whether its base stood still, or nothing touched."""
KEYS = ("base", "name", "outputs", "input_hold", "sample_time", "time", *SWITCHES)
TABLES = (
    *("model", "readings", "parameters", "per_recording", "initial", "delays", "clock", "noise"),
    *("resolution", "units", "columns", "additions", "servos"),
)

DRAFT = """\
# Drafted by jaxsr: how recordings go with {base}, and what a diagnosis may re-calibrate.
# [readings]    output = expression of the joints' positions q_JOINT and rates v_JOINT
# [parameters]  the constants that are free, inside their bounds; every other one keeps the value of
#               {base}. Masses are fixed: to free one, write mass_BODY = {{ bounds = [low, high] }}
# [columns]     output or input = column of a recording
{more}# Assumed, change it where it is wrong: between two samples a control {hold}.
# (input_hold "zero" as MuJoCo steps, "linear" for a torque that a sensor measures.)
"""

LOOPS = """\
# [servos]      position loops of a controller, force = kp*(target - position) - kv*rate, in N m and
#               rad or N and m: estimated here from the recordings. A joint's damping acts as kv
#               does: write the gains that the controller has, and take kp out of [parameters]
"""

HOLDS = {"zero": "stays what it was", "linear": "lies on a line"}


def read_sidecar(path: Path, base: Path) -> dict[str, Any]:
    """Return the tables of a sidecar; none where there is no such file.

    A model file of that name which stands on nothing, such as an ``explained.toml`` beside its
    ``explained.xml``, says which columns there are, and no more.

    Raises
    ------
    InputError
        It cannot be read, or holds what a sidecar may not.
    """
    if not path.is_file():
        return {}
    document = read_document(path)
    head = document.get("model", {})
    if isinstance(head, Mapping) and "base" not in head and "equations" in document:
        return {"columns": document["columns"]} if "columns" in document else {}
    for name in document:
        if name not in TABLES:
            what = f"unknown table [{shortened(str(name))}] of a sidecar"
            raise InputError(what, path.name, f"Use {', '.join(TABLES)}")
    if not isinstance(head, Mapping):
        raise InputError("[model] is no table", path.name, f'Write [model] base = "{base.name}"')
    for key in head:
        if key not in KEYS:
            what = f"unknown key {shortened(str(key))!r} in [model] of a sidecar"
            raise InputError(what, path.name, f"Use {', '.join(KEYS)}")
    for key in SWITCHES:
        if not isinstance(head.get(key, False), bool):
            raise InputError(f"{key} is no truth value", path.name, f"Write {key} = true or false")
    if head.get("base") != base.name:
        what = f"[model] base is not {base.name}"
        raise InputError(what, path.name, f'Write base = "{base.name}", or rename the file')
    return document


def merged(tables: Mapping[str, Any], sidecar: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the tables of a simulator with what its sidecar says.

    [parameters] of a sidecar lists those that are free, and may give others a value; [additions]
    add to equations; the other tables add to their own.

    Raises
    ------
    InputError
        [parameters] names a constant that the simulator does not have.
    """
    out = {name: dict(table) for name, table in tables.items()}
    head = {k: v for k, v in sidecar.get("model", {}).items() if k not in ("base", *SWITCHES)}
    out["model"] |= head
    for name in TABLES[1:]:
        if name not in sidecar or name in ("parameters", "servos"):
            continue
        own = sidecar[name]
        out[name] = {**out.get(name, {}), **own} if isinstance(own, Mapping) else own
    if "readings" in sidecar and "outputs" not in head:
        out["model"]["outputs"] = list(sidecar["readings"])
    if "parameters" in sidecar:
        texts = [*_texts(sidecar.get("additions")), *_texts(sidecar.get("readings"))]
        used = set().union(*(names_in(text) for text in texts))
        out["parameters"] = _freed(out["parameters"], sidecar["parameters"], used, where)
    return out


def _texts(table: Any) -> list[str]:
    return [t for t in table.values() if isinstance(t, str)] if isinstance(table, Mapping) else []


def _freed(own: Mapping[str, Any], given: Any, used: set[str], where: str) -> dict[str, Any]:
    """Return the parameters with what a sidecar says; it may add those that it uses itself."""
    if not isinstance(given, Mapping):
        raise InputError("[parameters] is no table", where, "Write NAME = { bounds = [0, 1] }")
    fixed = {n: {k: v for k, v in e.items() if k != "bounds"} for n, e in own.items()}
    for name, entry in given.items():
        if name not in fixed and name not in used:
            what = f"unknown parameter {shortened(str(name))!r}"
            remedy = f"Known: {shortened(', '.join(fixed), 200)}"
            raise InputError(what, f"{where} [parameters]", remedy)
        if isinstance(entry, int | float) and not isinstance(entry, bool):
            entry = {"value": entry}
        if not isinstance(entry, Mapping):
            raise InputError(
                f"{name} is no table", f"{where} [parameters]", "Write { bounds = [0, 1] }"
            )
        fixed[name] = {**fixed.get(name, {}), **entry}
    return fixed


def draft(
    base: Path,
    tables: Mapping[str, Any],
    matched: Matched,
    servos: Mapping[str, Mapping[str, float]] | None = None,
    valued: Collection[str] = (),
) -> str:
    """Return the text of a sidecar that says what was assumed.

    Parameters `valued` have their value from the recordings, in no file.
    """
    head = {
        "base": base.name,
        "outputs": [q.role for q in matched.outputs],
        "input_hold": tables["model"]["input_hold"],
    }
    free = {
        name: {k: entry[k] for k in ("value", "bounds") if k == "bounds" or name in valued}
        for name, entry in tables["parameters"].items()
        if "bounds" in entry
    }
    parts = [
        DRAFT.format(
            base=base.name,
            hold=HOLDS[tables["model"]["input_hold"]],
            more=LOOPS if servos else "",
        ),
        table_text("model", head),
        table_text("servos", servos or {}),
        table_text("readings", {q.role: q.reading for q in matched.outputs}),
        table_text("parameters", free) or "[parameters]\n",
        table_text("units", {q.role: q.unit for q in matched.outputs if q.unit}),
        table_text("columns", matched.columns),
    ]
    return "\n".join(part for part in parts if part)
