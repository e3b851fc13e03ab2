"""Many diagnoses: a case each, in processes of their own, one table and one page over all.

The names are resolved on first use: the process of a case, and a worker that waits for it, load
nothing of the page.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxsr.batch.cases import Case
    from jaxsr.batch.fleet import Fleet
    from jaxsr.batch.islands import Islands
    from jaxsr.batch.listing import read_cases
    from jaxsr.batch.many import diagnose_many

__all__ = ["Case", "Fleet", "Islands", "diagnose_many", "read_cases"]

_HOMES = {
    "Case": "cases",
    "Fleet": "fleet",
    "Islands": "islands",
    "diagnose_many": "many",
    "read_cases": "listing",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'jaxsr.batch' has no attribute {name!r}")
    return getattr(importlib.import_module(f"jaxsr.batch.{_HOMES[name]}"), name)
