"""Models: the model file, the simulator, free run and multiple shooting."""

from jaxsr.models.edits import Edit, apply_edit, difference, with_values
from jaxsr.models.model import Event, Model, Parameter
from jaxsr.models.reading import build_model, parse_model, read_model
from jaxsr.models.simulator import Simulator
from jaxsr.models.writing import model_text, write_model

__all__ = [
    "Edit",
    "Event",
    "Model",
    "Parameter",
    "Simulator",
    "apply_edit",
    "build_model",
    "difference",
    "model_text",
    "parse_model",
    "read_model",
    "with_values",
    "write_model",
]
