"""Results name the software and the machine that made them."""

from __future__ import annotations

import importlib.metadata
import platform

from jaxsr._versions import environment


def test_the_environment_is_named() -> None:
    found = environment()
    assert list(found) == ["python", "jax", "numpy", "platform"]
    assert found["jax"] == importlib.metadata.version("jax")
    assert platform.system() in found["platform"]
    assert all(isinstance(value, str) and value for value in found.values())
