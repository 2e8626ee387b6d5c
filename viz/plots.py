"""Plots of every kind of result, one function each; all return the matplotlib axes."""

from .plots_gain import (
    plot_autocorrelation,
    plot_coverage,
    plot_fates,
    plot_gain_cdf,
    plot_gain_pdf,
    plot_gain_series,
)
from .plots_medium import (
    plot_bubble_profile,
    plot_phase_cdf,
    plot_phase_function,
    plot_spectrum,
    plot_spreading,
)
from .plots_signal import (
    plot_ber,
    plot_eye,
    plot_impulse_response,
    plot_performance,
)
from .plots_sweep import (
    fitted_order,
    plot_convergence,
    plot_sweep,
)

__all__ = [
    "fitted_order",
    "plot_autocorrelation",
    "plot_ber",
    "plot_bubble_profile",
    "plot_convergence",
    "plot_coverage",
    "plot_eye",
    "plot_fates",
    "plot_gain_cdf",
    "plot_gain_pdf",
    "plot_gain_series",
    "plot_impulse_response",
    "plot_performance",
    "plot_phase_cdf",
    "plot_phase_function",
    "plot_spectrum",
    "plot_spreading",
    "plot_sweep",
]
