"""Shapes of arrays: results are what the annotations of public calls say."""

from __future__ import annotations

import inspect
import sys
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import jaxtyping
import numpy as np
import pytest

import jaxsr
from jaxsr.models import parse_model
from jaxsr.views import smooth

TIME = np.linspace(0.0, 2.0, 40)
RUN = jaxsr.Recording("run", TIME, {"y": np.sin(TIME), "u": np.cos(TIME)})
CART = """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - c*v"
[readings]
y = "q"
[parameters]
c = 0.5
"""


def hints_of(call: Any) -> dict[str, Any]:
    """Return the annotations of a function or class with their shapes.

    Shapes are for readers and type checkers: no module of the package loads jaxtyping for them.
    """
    function = inspect.unwrap(getattr(call, "__func__", call))
    space = vars(sys.modules[function.__module__]) | {"np": np, "jax": sys.modules["jax"]}
    names = {name: getattr(jaxtyping, name) for name in ("Bool", "Float", "Integer")}
    return typing.get_type_hints(function, space | names, include_extras=True)


def fits(value: Any, kind: Any, sizes: dict[str, int]) -> bool:
    """Return whether a value is what an annotation says; `sizes` has the lengths met so far."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is tuple:
        return all(fits(item, inner[0], sizes) for item in value)
    if isinstance(kind, type) and issubclass(kind, jaxtyping.AbstractArray):
        return isinstance(value, kind) and same_sizes(np.shape(cast("Any", value)), kind, sizes)
    if inner:
        return any(fits(value, one, sizes) for one in inner)
    return isinstance(value, kind)


def same_sizes(shape: tuple[int, ...], kind: Any, sizes: dict[str, int]) -> bool:
    names = kind.dim_str.replace("*", "").split()
    return all(sizes.setdefault(name, n) == n for name, n in zip(names, shape, strict=False))


def calls() -> list[tuple[Callable[..., Any], tuple[Any, ...], dict[str, int]]]:
    """Return public calls, what they are given, and the sizes that follow from that."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(60, 2))
    small = jaxsr.SymbolicSparseRegressor(population=20, generations=1, random_state=0).fit(x, x)
    cart = jaxsr.Simulator(parse_model(CART))
    motion = TIME, (RUN.channels["y"],) * 2, (RUN.channels["u"],), cart.values()
    samples = {"samples": len(TIME)}
    return [
        (RUN.channel, ("y",), samples),
        (smooth, (TIME, RUN.channels["y"]), samples),
        (smooth, (TIME, np.stack([RUN.channels["y"]] * 3, axis=1)), samples),
        (cart.rates, motion, samples),
        (cart.readings, motion, samples),
        (small.predict, (x[:50],), {"samples": 50, "outputs": 2}),
        (
            jaxsr.compile_terms(["a*b", "a", "2.0"], ["a", "b"]).evaluate,
            (x,),
            {"samples": 60, "terms": 3},
        ),
    ]


def test_results_have_the_shapes_that_annotations_say() -> None:
    for call, given, sizes in calls():
        kind = hints_of(call)["return"]
        result = call(*given)
        assert fits(result, kind, dict(sizes)), call
        last = list(sizes)[-1]
        assert not fits(result, kind, {**sizes, last: sizes[last] + 1}), call


@pytest.mark.parametrize("kind", [jaxsr.Recording, jaxsr.Monitor.feed, jaxsr.Simulator.rates])
def test_annotations_of_public_classes_can_be_read(kind: Any) -> None:
    assert any("Float" in str(hint) for hint in hints_of(kind).values())


def test_shapes_cost_no_import() -> None:
    for path in Path(jaxsr.__file__).parent.rglob("*.py"):
        assert "\nfrom jaxtyping" not in path.read_text(encoding="utf-8"), path
