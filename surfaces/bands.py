"""Frequencies and directions of a wave sum: the bands, their bins, and the waves within them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .parameters import Floats
from .spectra import Spectrum, sea_state
from .spreading import Spreading, direction_grid, direction_weights


class Band(NamedTuple):
    """Frequencies and directions of a wave sum [rad s-1 and rad].

    With logarithmic spacing `d_omega` is the width of the lowest bin.
    """

    omega_min: float
    omega_max: float
    d_omega: float
    d_theta: float


class Waves(NamedTuple):
    """Variance [m2], frequency [rad s-1] and direction from the wind [rad] of each wave."""

    variance: Floats
    omega: Floats
    theta: Floats


PAPER_FETCH = 30e3
PAPER_BANDS = {
    5.0: Band(1.2, 4.0, 0.2, math.pi / 5),
    13.0: Band(0.9, 3.0, 0.1, math.pi / 20),
}
"""The paper's table of bands, by wind speed [m s-1]; its fetch is 30 km."""

PER_OCTAVE = 16
"""Bins of an octave with logarithmic spacing."""

DIRECTIONS = 36
"""Directions over the range of a spreading, one more where its two ends differ."""

_NODES = 16  # of the quadrature over a bin, of either kind
_LAYOUT = 20_260_501  # key of the places of waves within their bins, the same for every seed
_NEGLIGIBLE = 1e-9  # of a bin: rounding of its edges


def natural_band(omega_p: float, half_range: float) -> Band:
    """Return the band of the default sea: 0.6 to 2.1 omega_p, in 36 directions.

    Parameters
    ----------
    omega_p : float
        Peak frequency [rad s-1].
    half_range : float
        Largest |theta| of the spreading [rad].

    Notes
    -----
    A JONSWAP sea keeps 96 % of the variance of its elevation in it. Its waves do not focus light
    within a few metres, so that a mean gain costs the same as over the paper's sea.
    """
    low = 0.6 * omega_p
    width = low * (2.0 ** (1.0 / PER_OCTAVE) - 1.0)
    return Band(low, 2.1 * omega_p, width, 2.0 * half_range / DIRECTIONS)


def sparse_band(omega_p: float, half_range: float) -> Band:
    """Return the natural band of a sea of second order: 10 frequencies in 10 directions.

    Parameters
    ----------
    omega_p : float
        Peak frequency [rad s-1].
    half_range : float
        Largest |theta| of the spreading [rad].

    Notes
    -----
    Every pair of waves has two bound waves: the 1073 waves of `natural_band` would have more than
    a million.
    """
    return Band(0.6 * omega_p, 2.1 * omega_p, 0.15 * omega_p, 2.0 * half_range / 10)


def scaled_band(omega_p: float) -> Band:
    """Return the band that moves with the peak: 0.6 to 2.1 omega_p in 21 steps, 21 directions.

    Parameters
    ----------
    omega_p : float
        Peak frequency [rad s-1].

    Returns
    -------
    Band
        omega_p (0.6, 2.1, 0.075) and pi / 20.

    Notes
    -----
    The limits are those of the paper's two bands, (0.61, 2.04) and (0.64, 2.12) omega_p, rounded,
    so that a sweep over wind speed does not jump at 5 and 13 m/s. A JONSWAP sea keeps 96 % of
    its variance in it, but only a third (2 m/s) to a tenth (30 m/s) of the mean square slope of
    Cox and Munk.
    """
    return Band(0.6 * omega_p, 2.1 * omega_p, 0.075 * omega_p, math.pi / 20)


def paper_band(wind_speed: float, fetch: float = PAPER_FETCH) -> str:
    """Return "paper" for the sea states of the paper's table, "scaled" for all others.

    Examples
    --------
    >>> paper_band(5.0), paper_band(8.0), paper_band(5.0, fetch=5e3)
    ('paper', 'scaled', 'scaled')
    """
    # a list: values of any type come from link files, before they are checked
    known = wind_speed in list(PAPER_BANDS) and fetch == PAPER_FETCH
    return "paper" if known else "scaled"


def bin_count(band: Band, log: bool) -> int:
    """Return the number of frequency bins of a band without creating them."""
    if log:
        return math.ceil(PER_OCTAVE * math.log2(band.omega_max / band.omega_min) - _NEGLIGIBLE)
    return math.ceil((band.omega_max - band.omega_min) / band.d_omega - _NEGLIGIBLE)


def frequency_edges(band: Band, log: bool) -> Floats:
    """Return the edges of the bins [rad s-1]; the last bin ends with the band.

    A wider band adds bins to those of a narrower one.
    """
    steps = np.arange(bin_count(band, log) + 1, dtype=np.float64)
    if log:
        edges = band.omega_min * 2.0 ** (steps / PER_OCTAVE)
    else:
        edges = band.omega_min + band.d_omega * steps
    edges[-1] = band.omega_max
    return edges


def frequency_count(band: Band) -> int:
    """Return the number of frequencies of an equally spaced band."""
    # The tolerance keeps 1.2, 1.4, ..., 4.0 at 15 whatever the last bit of the quotient.
    return math.floor((band.omega_max - band.omega_min) / band.d_omega + 1e-9) + 1


def lattice(
    band: Band, spectrum: Spectrum, spreading: Spreading, offsets: Floats | None = None
) -> Waves:
    """Return the waves of equally spaced frequencies in equally spaced directions.

    Parameters
    ----------
    band : Band
        The band.
    spectrum, spreading : Spectrum, Spreading
        The sea.
    offsets : ndarray, shape (n_omega, n_theta), optional
        Displacements of the frequencies over the width of a bin, within -+1/2.
    """
    centers = band.omega_min + band.d_omega * np.arange(frequency_count(band))
    theta = direction_grid(spreading.half_range, band.d_theta)
    shares = direction_weights(spreading, centers, theta, band.d_theta, **sea_state(spectrum))
    omega = np.broadcast_to(centers[:, None], shares.shape)
    if offsets is not None:
        omega = omega + band.d_omega * offsets
    variance = spectrum(omega) * band.d_omega * shares
    return Waves(variance, omega, np.broadcast_to(theta, shares.shape))


def drawn_waves(edges: Floats, d_theta: float, spectrum: Spectrum, spreading: Spreading) -> Waves:
    r"""Return one wave for each cell of frequency and direction, drawn within the cell.

    .. math:: \sigma_{ij}^2 = \int_{\omega_i}^{\omega_{i+1}} S d\omega
        \int_{\theta_j}^{\theta_{j+1}} D(\bar\omega_i, \theta) d\theta

    Parameters
    ----------
    edges : ndarray, shape (n_omega + 1,)
        Edges of the frequency bins [rad s-1].
    d_theta : float
        Width of the cells over direction [rad]; those at -+pi/2 are cut there.
    spectrum, spreading : Spectrum, Spreading
        The sea.

    Notes
    -----
    The frequencies of a bin fall into as many equal parts of it as there are directions, in
    random order (Latin hypercube), so that no two waves of a sea share a frequency or a direction:
    neither a period nor a lattice remains. All seeds share the places, which keeps the factors of
    the grid; the phases alone differ.
    """
    rng_frequency, rng_order, rng_direction = (
        np.random.default_rng([_LAYOUT, i]) for i in range(3)
    )
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    width = np.diff(edges)
    at = edges[:-1, None] + width[:, None] * 0.5 * (nodes + 1.0)
    variance = 0.5 * width * (spectrum(at) * weights).sum(axis=1)
    half = spreading.half_range
    middle = direction_grid(half, d_theta)
    low = np.maximum(middle - 0.5 * d_theta, -half)
    cell = np.minimum(middle + 0.5 * d_theta, half) - low
    theta = low[:, None] + cell[:, None] * 0.5 * (nodes + 1.0)
    center = np.sqrt(edges[:-1] * edges[1:])[:, None]
    density = spreading.density(center, theta.ravel(), **sea_state(spectrum))
    shares = (density.reshape(len(width), *theta.shape) * weights).sum(axis=2) * cell
    shares /= shares.sum(axis=1, keepdims=True)
    # ranks of random numbers, row by row: wider bands keep the places of the narrower
    part = rng_order.random(shares.shape).argsort(axis=1) + rng_frequency.random(shares.shape)
    omega = edges[:-1, None] + width[:, None] * part / len(middle)
    place = low + cell * rng_direction.random(shares.shape)
    return Waves(variance[:, None] * shares, omega, place)
