"""Views: linear operators through which a regression looks at recordings."""

from jaxsr.views.derivative import DERIVATIVES, choose_method, derivative
from jaxsr.views.finite_difference import finite_difference
from jaxsr.views.half_width import choose_half_width, choose_half_widths
from jaxsr.views.integral import integrate
from jaxsr.views.noise_model import noise_by_sample
from jaxsr.views.savitzky_golay import LocalFit, choose_fit, savitzky_golay, smooth_states
from jaxsr.views.smoothing import SMOOTHERS, choose_smoother, smooth
from jaxsr.views.tikhonov import adaptive_spline, fit_adaptive, fit_spline, tikhonov
from jaxsr.views.total_variation import total_variation
from jaxsr.views.weak import WeakView

__all__ = [
    "DERIVATIVES",
    "LocalFit",
    "SMOOTHERS",
    "WeakView",
    "adaptive_spline",
    "choose_fit",
    "choose_half_width",
    "choose_half_widths",
    "choose_method",
    "choose_smoother",
    "derivative",
    "finite_difference",
    "fit_adaptive",
    "fit_spline",
    "integrate",
    "noise_by_sample",
    "savitzky_golay",
    "smooth",
    "smooth_states",
    "tikhonov",
    "total_variation",
]
