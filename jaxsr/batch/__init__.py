"""Many diagnoses: a case each, in processes of their own, one table and one page over all."""

from jaxsr.batch.cases import Case, read_cases
from jaxsr.batch.fleet import Fleet
from jaxsr.batch.many import diagnose_many

__all__ = ["Case", "Fleet", "diagnose_many", "read_cases"]
