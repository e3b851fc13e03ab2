"""Views: linear operators through which a regression looks at recordings."""

from jaxsr.views.derivative import DERIVATIVES, choose_method, derivative
from jaxsr.views.finite_difference import finite_difference
from jaxsr.views.half_width import choose_half_width
from jaxsr.views.savitzky_golay import LocalFit, choose_fit, savitzky_golay, smooth_states
from jaxsr.views.total_variation import total_variation
from jaxsr.views.weak import WeakView

__all__ = [
    "DERIVATIVES",
    "LocalFit",
    "WeakView",
    "choose_fit",
    "choose_half_width",
    "choose_method",
    "derivative",
    "finite_difference",
    "savitzky_golay",
    "smooth_states",
    "total_variation",
]
