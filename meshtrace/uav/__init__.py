"""Hovering UAV: wind and gusts, the tilt of its receiver over time and as a law, its route.

The airframe leans into the wind until thrust balances drag. `Uav.tilt` maps winds to tilts, also
those over time of `Dryden.simulate_wind`; `Uav.tilt_law` is the law of the tilt angle, exact or as
the paper's Gamma approximation.
"""

from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
