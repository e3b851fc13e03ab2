"""The kernel of a CUDA device: every thread runs the chosen terms' code on a few samples.

All threads of a block run the same term, so a branch over operations costs what one comparison
does. The kernel is written from a table of expressions, one for each operation.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from jaxsr.evaluation.stream import BESIDE, LEFT, LOAD, NAMES, RIGHT
from jaxsr.expressions.postfix import OPERATORS, arity_of

THREADS, LANES = 128, 4  # of a block; samples of each thread
DEPTHS = (4, 8, 32)
"""Values on a stack that kernels are made for: a short one stays in registers."""
_BLOCKS = 65535  # along the terms

EXPRESSIONS: dict[str, str] = {
    "add": "a + b",
    "sub": "a - b",
    "mul": "a * b",
    "div": "a / b",
    "pow": "math.pow(a, b) if a != ZERO else (ZERO if b > ZERO else (ONE if b == ZERO else INF))",
    "neg": "-b",
    "lt": "ONE if a < b else ZERO",
    "le": "ONE if a <= b else ZERO",
    "gt": "ONE if a > b else ZERO",
    "ge": "ONE if a >= b else ZERO",
    "eq": "ONE if a == b else ZERO",
    "ne": "ONE if a != b else ZERO",
    **{
        name: f"math.{name}(b)"
        for name in "sin cos tan sinh cosh tanh exp log sqrt asin acos atan floor".split()
    },
    "atan2": "math.atan2(a, b)",
    "abs": "math.fabs(b)",
    "sign": "ONE if b > ZERO else (-ONE if b < ZERO else b)",
    "max": "a if (a > b or a != a) else b",
    "min": "a if (a < b or a != a) else b",
    "heaviside": "ONE if b > ZERO else (ZERO if b < ZERO else (HALF if b == ZERO else b))",
    "not": "ONE if b == ZERO else ZERO",
    "square": "a * a",
    "cube": "a * a * a",
}
"""Each operation on its left argument a and its right, or only, one b."""

_HEAD = f"""
def kernel(words, values, starts, chosen, data, out):
    stack = cuda.local.array((DEPTH, LANES), KIND)
    top = cuda.local.array(LANES, KIND)
    left = cuda.local.array(LANES, KIND)
    right = cuda.local.array(LANES, KIND)
    rows = out.shape[1]
    first = cuda.blockIdx.x * cuda.blockDim.x * LANES + cuda.threadIdx.x
    number = cuda.blockIdx.y
    while number < chosen.shape[0]:
        term = chosen[number]
        height = 0
        for v in range(LANES):
            top[v] = ZERO
        for k in range(starts[term], starts[term + 1]):
            word = words[k]
            operation, way, place = word & 63, (word >> 6) & 3, word >> 8
            if operation == {LOAD}:
                for v in range(LANES):
                    stack[height, v] = top[v]
                height += 1
            if way == {BESIDE}:
                for v in range(LANES):
                    left[v], right[v] = top[v], top[v]
            if operation == {LOAD} or way != {BESIDE}:
                for v in range(LANES):
                    row = min(first + v * cuda.blockDim.x, rows - 1)
                    right[v] = values[k] if place == 0 else data[place - 1, row]
            if way == {RIGHT}:
                for v in range(LANES):
                    left[v] = top[v]
            elif way == {LEFT}:
                for v in range(LANES):
                    left[v], right[v] = right[v], top[v]
            if operation == {LOAD}:
                for v in range(LANES):
                    top[v] = right[v]
"""
_BRANCH = """
            elif operation == {number}:{pop}
                for v in range(LANES):
                    a, b = left[v], right[v]
                    top[v] = {expression}
"""
_POP = f"""
                if way == {BESIDE}:
                    height -= 1
                    for v in range(LANES):
                        left[v] = stack[height, v]"""
_TAIL = """
        for v in range(LANES):
            row = first + v * cuda.blockDim.x
            if row < rows:
                out[term, row] = top[v]
        number += cuda.gridDim.y
"""
_BINARY = frozenset(name for name in OPERATORS if arity_of(name) == 2)


def source() -> str:
    """Return the kernel's text."""
    branches = [
        _BRANCH.format(
            number=NAMES.index(name), expression=text, pop=_POP if name in _BINARY else ""
        )
        for name, text in EXPRESSIONS.items()
    ]
    return "".join([_HEAD.rstrip("\n"), *(b.rstrip("\n") for b in branches), _TAIL])


@functools.cache
def kernel(depth: int, dtype: str, library: Any = math) -> Any:
    """Return the kernel for stacks of so many values, compiled at its first launch."""
    from numba import cuda

    kind = np.dtype(dtype).type
    names = {
        "cuda": cuda,
        "math": library,
        "DEPTH": depth,
        "LANES": LANES,
        "KIND": _numba_type(dtype),
        "ZERO": kind(0.0),
        "HALF": kind(0.5),
        "ONE": kind(1.0),
        "INF": kind(np.inf),
    }
    exec(source(), names)  # the text is made of this module alone
    return cuda.jit(names["kernel"])


def _numba_type(dtype: str) -> Any:
    import numba

    return getattr(numba, dtype)


def grid(terms: int, rows: int) -> tuple[int, int]:
    """Return the number of blocks along samples and terms."""
    return -(-rows // (THREADS * LANES)), min(terms, _BLOCKS)


def tried() -> None:
    """Compile the smallest kernel and run it on one sample.

    Raises
    ------
    Exception
        Whatever keeps Numba from it.
    """
    from numba import cuda

    out = cuda.to_device(np.zeros((1, 1), np.float32))
    word = np.array([LOAD], np.int32)
    code = (word, np.array([2.5], np.float32), np.array([0, 1], np.int32), np.zeros(1, np.int32))
    kernel(DEPTHS[0], "float32")[grid(1, 1), THREADS](*code, np.zeros((1, 1), np.float32), out)
    if out.copy_to_host()[0, 0] != 2.5:
        raise RuntimeError("the kernel's answer is wrong")
