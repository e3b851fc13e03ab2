"""What results say of the software and the machine that made them."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version


def environment() -> dict[str, str]:
    """Return the versions of what the figures rest on, and the platform in a line."""
    return {
        "python": platform.python_version(),
        **{name: _version(name) for name in ("jax", "numpy")},
        "platform": f"{platform.system()} {platform.machine()}",
    }


def own_version() -> str:
    """Return the installed version, or ``0+uninstalled`` in a bare source tree."""
    try:
        return version("jaxsr-dynamics")
    except PackageNotFoundError:
        return "0+uninstalled"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
