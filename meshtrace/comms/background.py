"""Background light at the receiver: filters, counts, and the widest filter of a working link."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import Field

from meshtrace.checks import ErrorRate, check_call
from meshtrace.comms.ook import OokLink
from meshtrace.comms.spectra import Curve
from meshtrace.errors import warn
from meshtrace.results.daylight import Background

MOST_BIAS_CURRENT = 10e-3
"""Mean bias current of a SiPM above which background light brings a warning [A]."""

DARK = "none: dark, without sun, moon and sky"
"""Name of the light without background."""


def name_of_light(name: str) -> str:
    """Extract the name of the light from a description of background light.

    Examples
    --------
    >>> name_of_light(DARK), name_of_light("clear sky at zenith angle 30 deg, 1.88e+12 counts/s")
    ('dark', 'clear sky at zenith angle 30 deg')
    """
    return "dark" if name == DARK else name.partition(",")[0]


_NARROWEST = 1e-6  # [nm]


class DaylightWarning(UserWarning):
    """Background light beyond the design of a receiver: narrow filter, large bias current."""


@check_call
def filter_shift_nm(
    wavelength_nm: float,
    angle_deg: Annotated[float, Field(ge=0.0, le=90.0)],
    n_eff: Annotated[float, Field(ge=1.0)] = 2.0,
) -> float:
    """Return the shift of an interference filter at oblique incidence [nm].

    lambda_0 - lambda(theta) = lambda_0 (1 - (1 - (sin theta / n_eff)^2)^(1/2))

    Parameters
    ----------
    wavelength_nm : float
        Wavelength at normal incidence [nm].
    angle_deg : float
        Angle of incidence theta [deg], 0 ... 90.
    n_eff : float
        Effective index of the layers, >= 1.

    Examples
    --------
    >>> [round(filter_shift_nm(470.0, angle), 2) for angle in (30.0, 10.0, 2.98)]
    [14.92, 1.77, 0.16]
    """
    sine = math.sin(math.radians(angle_deg)) / n_eff
    return wavelength_nm * (1.0 - math.sqrt(1.0 - sine * sine))


@check_call
def with_background(ook: OokLink, background: Background, scale: float = 1.0) -> OokLink:
    """Add the counts of background light to a transmission.

    Parameters
    ----------
    ook : OokLink
        Transmission; optics, filter and SiPM as behind the aperture of the background.
    background : Background
        Background light.
    scale : float
        Factor on it, >= 0.
    """
    rate = ook.background_rate + scale * background.count_rate(ook)
    return ook.replace(background_rate=rate)


@check_call
def occupancy(ook: OokLink) -> float:
    """Return the mean dark and background counts of a cell in its dead time, x = r tau / N."""
    rate = ook.sipm.dark_count_rate + ook.background_rate
    return rate * ook.sipm.recovery_time / ook.sipm.n_spads


def warn_of_background(ook: OokLink, background: Background) -> None:
    """Warn of a filter narrower than its shift over the field of view or a large bias current."""
    optics = ook.optics
    shift = filter_shift_nm(background.wavelength_nm, 0.5 * optics.fov_deg)
    texts = []
    if not optics.spectral and optics.filter_width_nm < shift:
        texts.append(
            f"filter_width_nm {optics.filter_width_nm:g} is less than the shift of an interference "
            f"filter at the edge of the field of view, {shift:.3g} nm: light from there is lost"
        )
    rate = ook.sipm.dark_count_rate + ook.background_rate
    current = float(ook.sipm.bias_current(rate))
    if current > MOST_BIAS_CURRENT:
        texts.append(
            f"background light of {ook.background_rate:.3g} counts per second draws "
            f"{1e3 * current:.3g} mA of bias current through the SiPM: narrow the filter"
        )
    for text in texts:
        warn(text, DaylightWarning)


@check_call
def widest_filter_nm(ook: OokLink, background: Background, power: float, ber: ErrorRate) -> float:
    """Return the widest filter with which a link reaches a bit error rate under a background.

    Parameters
    ----------
    ook : OokLink
        Transmission without the background.
    background : Background
        Background light; its counts grow with the width of the filter.
    power : float
        Optical power of the signal on the SiPM [W].
    ber : float
        Target, 0 < ber < 0.5.

    Returns
    -------
    float
        Width [nm]; 0 if no filter suffices, inf above twice the wavelength.

    Notes
    -----
    The averaging window stays that of `ook`. Where light has a spectrum the width also changes the
    share of the signal, and the widest of the widths is returned, sought in steps of a tenth; nan
    for a filter by a table.
    """
    from scipy.optimize import brentq

    if isinstance(ook.optics.filter_transmission, Curve):
        return math.nan
    if ook.filter_share == 0.0:
        return 0.0
    # a free window would be searched anew at every trial width
    fixed = ook.replace(window=ook.averaging_window) if ook.averaging_window else ook
    # `power` is behind the present filter; a trial passes another share of what comes in
    incident, widest = power / ook.filter_share, 2.0 * background.wavelength_nm

    def excess(log_width: float) -> float:
        width = min(math.exp(log_width), widest)
        trial = fixed.replace("optics.filter_width_nm", width)
        error = float(with_background(trial, background).ber(incident * trial.filter_share))
        # nearly straight over the logarithm of the width; the bound keeps an underflow to 0 finite
        return math.log(max(error, 1e-300) / ber)

    # without spectra the error rate rises with the width and one bracket will do; with them it may
    # fall and rise again, so that steps look for the widest root
    ends = math.log(widest), math.log(_NARROWEST)
    proportional = not (ook.spectral or isinstance(ook.sipm.pde, Curve))
    steps = ends if proportional else np.arange(*ends, math.log(0.9)).tolist()
    for wider, log_width in pairwise((math.inf, *steps)):
        if excess(log_width) <= 0.0:
            if math.isinf(wider):
                return math.inf
            return math.exp(float(brentq(excess, log_width, wider, xtol=1e-4)))
    return 0.0
