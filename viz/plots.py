"""Plots of every kind of result, one function each; all return the matplotlib axes."""

from .plots_gain import plot_autocorrelation as plot_autocorrelation
from .plots_gain import plot_coverage as plot_coverage
from .plots_gain import plot_fates as plot_fates
from .plots_gain import plot_gain_cdf as plot_gain_cdf
from .plots_gain import plot_gain_pdf as plot_gain_pdf
from .plots_gain import plot_gain_series as plot_gain_series
from .plots_medium import plot_bubble_profile as plot_bubble_profile
from .plots_medium import plot_phase_cdf as plot_phase_cdf
from .plots_medium import plot_phase_function as plot_phase_function
from .plots_medium import plot_spectrum as plot_spectrum
from .plots_medium import plot_spreading as plot_spreading
from .plots_signal import plot_ber as plot_ber
from .plots_signal import plot_eye as plot_eye
from .plots_signal import plot_impulse_response as plot_impulse_response
from .plots_signal import plot_performance as plot_performance
from .plots_sweep import fitted_order as fitted_order
from .plots_sweep import plot_convergence as plot_convergence
from .plots_sweep import plot_sweep as plot_sweep
