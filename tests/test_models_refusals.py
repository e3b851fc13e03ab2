"""What breaks a rule of the model file is refused, naming file, key, symbol and remedy."""

from __future__ import annotations

import pytest
from model_texts import EVERYTHING

from jaxsr._result import InputError
from jaxsr.models import parse_model

BROKEN = [
    ("[noise]", "[nose]", ["nose", "noise"]),
    ("input_hold =", "input_holt =", ["[model]", "input_holt", "input_hold"]),
    ('"zero"', '"cubic"', ["[model]", "cubic", "bandlimited"]),
    ("sample_time = 0.01", 'sample_time = "x"', ["sample_time", "number"]),
    ("- pull", "- pul", ["[equations] v", "'pul'", "pull"]),
    ("- pull", "- __import__('os')", ["[equations] v", "__import__", "Known"]),
    ("- pull", "- q.real", ["[equations] v", "q.real", "grammar"]),
    ("- pull", "- 9**9**9", ["[equations] v", "power"]),
    ("- pull", "- sgn(v)", ["[equations] v", "sgn", "sign"]),
    ('z = "(q - z)/tau"\n', "", ["[equations]", "'z'", "Write"]),
    ('w = "v"\n', "", ["[readings]", "'w'", "Write"]),
    ('z = "(q - z)/tau"', "z = 3.0", ["[equations] z", "text", "Write"]),
    ('w = "v"', 'w = "v"\nx = "q"', ["[readings]", "'x'", "Known"]),
    ("bounds = [1.0, 3.0]", "bounds = [3.0, 4.0]", ["[parameters] M", "bounds", "Widen"]),
    ("bounds = [1.0, 3.0]", "bounds = [1.0]", ["[parameters] M", "bounds", "two numbers"]),
    ("bounds = [1.0, 3.0]", "limits = [1.0, 3.0]", ["[parameters] M", "limits", "bounds"]),
    ("value = 2.0", "value = nan", ["[parameters] M", "finite", "number"]),
    ("value = 2.0, ", "", ["[parameters] M", "value", "Write"]),
    ('"q", "v", "z"]', '"q", "v", "v"]', ["[model] states", "'v'", "Rename"]),
    ('inputs = ["u"]', 'inputs = ["q"]', ["[model]", "'q'", "Rename"]),
    ('"y", "w"]', '"y", "y"]', ["[model] outputs", "'y'", "Rename"]),
    ("s = 1e-4", "sin = 1e-4", ["'sin'", "Use"]),
    ("s = 1e-4", "lambda = 1e-4", ["'lambda'", "Use"]),
    ('v = { v = "M" }', 'x = { v = "M" }', ["[inertia]", "'x'", "Known"]),
    ('v = { v = "M" }', 'v = { x = "M" }', ["[inertia] v", "'x'", "Known"]),
    ('v = { v = "M" }', 'v = "M"', ["[inertia] v", "table", "Write"]),
    ("q = 0.25", 'q = "fre"', ["[initial] q", "fre", "free"]),
    ("q = 0.25", "qq = 0.25", ["[initial]", "'qq'", "'q'"]),
    ("u = 0.002", "uu = 0.002", ["[delays]", "'uu'", "'u'"]),
    ("u = 0.002", "u = -0.1", ["[delays] u", "-0.1", "zero"]),
    ('y = "tau"', 'y = "taw"', ["[delays] y", "taw", "[parameters]"]),
    ('"1 + s"', '"1 + r"', ["[clock] y", "'r'"]),
    ("y = 1e-6", "x = 1e-6", ["[noise]", "'x'", "Known"]),
    ("y = 1e-6", "y = -1e-6", ["[noise] y", "-1e-06", "more than zero"]),
    ('reset = { v = "-0.8*v" }', "", ["events", "reset", "Write"]),
    ('reset = { v = "-0.8*v" }', 'reset = { x = "-v" }', ["[[events]] reset", "'x'", "Known"]),
    ("direction = -1", "direction = 2", ["events", "2", "-1"]),
    ('when = "q"', 'when = "qq"', ["[[events]] when", "'qq'", "'q'"]),
    ('y0 = { "a', 'y1 = { "a', ["[per_recording]", "'y1'", "Known: M"]),
    ('"b.csv" = -2.0', '"b.csv" = "x"', ["[per_recording] y0", "b.csv", "number"]),
    ('unit = "kg"', 'unit = "kgg"', ["[parameters] M", "kgg", "Write"]),
    ('unit = "kg"', 'unit = "m**(9**9**9)"', ["[parameters] M", "9**9"]),
    ('unit = "kg"', 'unit = "__import__(1)"', ["[parameters] M", "__import__", "Write"]),
    ('unit = "kg"', 'unit = "s"', ["[equations] v", "dimension", "Check"]),
    ('v = "m/s"\n', 'v = "m"\n', ["[equations] q", "dimension", "Check"]),
    ('u = "N"', 'uu = "N"', ["[units]", "'uu'", "'u'"]),
    ('t = "time_s"', 'tt = "time_s"', ["[columns]", "'tt'", "'t'"]),
    ("[model]", "[model", ["TOML"]),
    ('name = "every table, \\"quoted\\""', "name = 5", ["[model] name", "text"]),
    ('name = "every table, \\"quoted\\""', 'name = ""', ["[model] name", "empty"]),
    ('time = "t"', 'time = ""', ["[model] time", "empty"]),
    ('time = "t"', 'time = ["t"]', ["[model] time", "text"]),
    ('time = "t"', 'time = "q"', ["'q'", "declared twice"]),
    ('states = ["q", "v", "z"]', 'states = "q"', ["[model]", "states", "list of names"]),
    ('outputs = ["y", "w"]', 'outputs = ["y", "𝐯"]', ["[model] outputs", "𝐯", "[columns]"]),
    ('inputs = ["u"]', 'inputs = ["u", 5]', ["[model]", "inputs", "list of names"]),
    ('input_hold = "zero"', 'input_hold = ["zero"]', ["[model]", "input_hold", "linear"]),
    ("sample_time = 0.01", "sample_time = 0", ["sample_time", "more than zero"]),
    ("sample_time = 0.01", "sample_time = true", ["sample_time", "number"]),
    ("sample_time = 0.01", "base = 5", ["[model] base", "text"]),
    ('stretch = "q - z"', 'stretch = "q - pull"', ["[definitions] stretch", "pull", "Order"]),
    ('stretch = "q - z"', 'stretch = "stretch"', ["[definitions] stretch", "by itself"]),
    ('stretch = "q - z"', "stretch = 5", ["[definitions] stretch", "in quotes"]),
    ('z = "(q - z)/tau"', 'z = ""', ["[equations] z", "empty"]),
    ('z = "(q - z)/tau"', 'z = "d(q)"', ["[equations] z", "d(...)", "right-hand side"]),
    ('z = "(q - z)/tau"', 'z = "q/(tau - 0.1)"', ["[equations] z", "tau = 0.1", "finite"]),
    ('w = "v"\n', 'w = "log(-1.0)"\n', ["[readings] w", "log(-1", "finite"]),
    ('v = { v = "M" }', "v = {}", ["[inertia] v", "empty"]),
    ('v = { v = "M" }', "v = { v = 2.0 }", ["[inertia] v.v", "in quotes"]),
    (
        'M = { value = 2.0, unit = "kg", bounds = [1.0, 3.0] }',
        "M = []",
        ["[parameters] M", "value"],
    ),
    ("value = 2.0", "value = true", ["[parameters] M", "number"]),
    ("value = 2.0", f"value = {10**400}", ["[parameters] M", "integer of 401 digits"]),
    ("value = 2.0", f"value = 0x{'f' * 9000}", ["[parameters] M", "integer of 1083"]),
    ("value = 2.0", "value = " + "1" * 4301, ["m.toml", "value that cannot be read", "1.5e-3"]),
    ("bounds = [1.0, 3.0]", "bounds = [3.0, 1.0]", ["[parameters] M", "do not rise"]),
    ("bounds = [1.0, 3.0]", "bounds = [2.0, 2.0]", ["[parameters] M", "do not rise"]),
    ("bounds = [1.0, 3.0]", "bounds = [1.0, inf]", ["[parameters] M bounds", "finite"]),
    ("bounds = [1.0, 3.0]", 'bounds = "1 3"', ["[parameters] M", "bounds", "two numbers"]),
    ('unit = "kg"', "unit = 5", ["[parameters] M unit", "text"]),
    ('unit = "kg"', "unit = []", ["[parameters] M unit", "text"]),
    ('unit = "kg"', 'unit = ""', ["[parameters] M unit", "empty"]),
    ('y0 = { "a file.csv" = 0.1', 'y0 = { "a file.csv" = nan', ["a file.csv", "finite"]),
    ('y0 = { "a file.csv" = 0.1, "b.csv" = -2.0 }', "y0 = 3", ["[per_recording] y0", "table"]),
    ("q = 0.25", "q = inf", ["[initial] q", "finite"]),
    ("q = 0.25", "q = []", ["[initial] q", "number"]),
    ("u = 0.002", "u = nan", ["[delays] u", "finite"]),
    ("u = 0.002", "u = {}", ["[delays] u", "number"]),
    ('"1 + s"', '"1 + q"', ["[clock] y", "states", "time"]),
    ('"1 + s"', "1", ["[clock] y", "in quotes"]),
    ('"1 + s"', '"s - 1.0"', ["[clock] y", "s = 0.0001", "rate of the clock"]),
    ("y = 1e-5", "y = 0", ["[resolution] y", "more than zero"]),
    ("y = 1e-5", "x = 1e-5", ["[resolution]", "'x'", "Known"]),
    ("y = 1e-5", 'y = "1e-5"', ["[resolution] y", "number"]),
    ("direction = -1", "direction = true", ["events", "direction", "falling"]),
    ('reset = { v = "-0.8*v" }', "reset = 0", ["[[events]]", "reset", "table"]),
    ('reset = { v = "-0.8*v" }', "reset = { v = 1 }", ["[[events]] reset v", "in quotes"]),
    ('when = "q"', "when = 5", ["[[events]] when", "text"]),
    ("[[events]]", "[events]", ["[[events]]", "list"]),
    ('v = "m/s"\n', "v = 5\n", ["[units] v", "text"]),
    ('t = "time_s"', 't = ""', ["[columns] t", "empty"]),
    ('t = "time_s"', "t = 1", ["[columns] t", "text"]),
    ('[columns]\nt = "time_s"', '[columns]\nt = "a"\nt = "b"', ["TOML", "overwrite"]),
]


@pytest.mark.parametrize(
    ("old", "new", "words"), BROKEN, ids=[ascii(f"{o}->{n[:60]}") for o, n, _ in BROKEN]
)
def test_errors_name_file_key_symbol_and_remedy(old: str, new: str, words: list[str]) -> None:
    assert EVERYTHING.count(old) >= 1
    with pytest.raises(InputError) as caught:
        parse_model(EVERYTHING.replace(old, new, 1), "m.toml")
    message = str(caught.value)
    assert message.startswith("m.toml") and message.isprintable() and len(message) < 450
    for word in words:
        assert word in message, message
