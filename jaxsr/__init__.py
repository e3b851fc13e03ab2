"""Equations of motion from recordings, and the physics that a simulator left out.

Only re-exports live here. They are resolved on first use, so that ``import jaxsr`` and the
command line start quickly and JAX is loaded only by work that needs it.
"""

from __future__ import annotations

import importlib
import os
import sys
import warnings

TYPE_CHECKING = False  # for type checkers true: ``typing`` takes longer to load than all the rest
if TYPE_CHECKING:
    from typing import Any

    from jaxsr._interval import Interval
    from jaxsr._result import InputError
    from jaxsr._saved import load
    from jaxsr.batch import diagnose_many
    from jaxsr.diagnosis import Diagnosis, Finding, diagnose, learn_simulator
    from jaxsr.diagnosis.mechanisms import register_mechanism
    from jaxsr.discovery import Discovery, Prior, Roles, Run, SymbolicSparseRegressor, discover
    from jaxsr.discovery.treatment import Treatment
    from jaxsr.evaluation import compile_terms
    from jaxsr.evolution import SearchConfig
    from jaxsr.models import Model, Simulator
    from jaxsr.monitoring import Alarm, Monitor, monitor
    from jaxsr.recordings import Recording, read_recording

    __version__: str

__all__ = [
    "Recording",
    "read_recording",
    "Model",
    "Simulator",
    "diagnose",
    "diagnose_many",
    "Diagnosis",
    "Finding",
    "Interval",
    "learn_simulator",
    "register_mechanism",
    "monitor",
    "Monitor",
    "Alarm",
    "discover",
    "Discovery",
    "Roles",
    "Prior",
    "SearchConfig",
    "Run",
    "Treatment",
    "SymbolicSparseRegressor",
    "compile_terms",
    "load",
    "InputError",
    "__version__",
]

_HOMES = {
    "Recording": "jaxsr.recordings",
    "read_recording": "jaxsr.recordings",
    "Model": "jaxsr.models",
    "Simulator": "jaxsr.models",
    "diagnose": "jaxsr.diagnosis",
    "diagnose_many": "jaxsr.batch",
    "Diagnosis": "jaxsr.diagnosis",
    "Finding": "jaxsr.diagnosis",
    "Interval": "jaxsr._interval",
    "learn_simulator": "jaxsr.diagnosis",
    "register_mechanism": "jaxsr.diagnosis.mechanisms",
    "monitor": "jaxsr.monitoring",
    "Monitor": "jaxsr.monitoring",
    "Alarm": "jaxsr.monitoring",
    "discover": "jaxsr.discovery",
    "Discovery": "jaxsr.discovery",
    "Roles": "jaxsr.discovery",
    "Prior": "jaxsr.discovery",
    "SearchConfig": "jaxsr.evolution",
    "Run": "jaxsr.discovery",
    "Treatment": "jaxsr.discovery.treatment",
    "SymbolicSparseRegressor": "jaxsr.discovery",
    "compile_terms": "jaxsr.evaluation",
    "load": "jaxsr._saved",
    "InputError": "jaxsr._result",
}


def _warn_of_namesake() -> None:
    """Say so when PyPI's ``jaxsr``, another project, shares the environment and import name."""
    if not any(_holds_namesake(folder) for folder in sys.path):
        return
    from importlib import metadata

    try:
        namesake = metadata.version("jaxsr")
    except metadata.PackageNotFoundError:
        return
    warnings.warn(
        f"the distribution 'jaxsr' {namesake}, another project with the same import name, is "
        "installed beside 'jaxsr-dynamics' and their files may be mixed. Uninstall both, then "
        "install the one you want.",
        stacklevel=3,
    )


def _holds_namesake(folder: str) -> bool:
    """Return whether a folder may hold the other project; its metadata take long to load."""
    try:
        names = os.listdir(folder or ".")
    except OSError:
        return False
    return any(name.lower().startswith("jaxsr-") for name in names)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from jaxsr._versions import own_version

        value = own_version()
    elif name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module 'jaxsr' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))


_warn_of_namesake()
