"""Types of what a simulator takes and gives: one array for each state, input or output."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from typing import Any

    from jaxtyping import Float

Array: TypeAlias = "Float[Any, '*samples']"
"""A value per sample, of NumPy or JAX; a number stands for all of them."""
Arrays: TypeAlias = "tuple[Array, ...]"
"""One array for each name, in the order of the model."""
