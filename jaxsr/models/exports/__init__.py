"""Models written for other programs: SymPy, LaTeX, NumPy, JAX, C, MATLAB, Modelica, FMI."""

from jaxsr.models.exports.exported import Exported
from jaxsr.models.exports.texts import ENDINGS, export_fmu, export_text

__all__ = ["ENDINGS", "Exported", "export_fmu", "export_text"]
