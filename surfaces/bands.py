"""Bands of frequency and direction, and the discrete waves that stand for their energy."""

from __future__ import annotations

import math
from functools import partial
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from meshtrace.checks import Shape, check_call
from meshtrace.errors import Refused, is_number, require_between
from meshtrace.models import Model
from meshtrace.quadrature import gauss_legendre

from .parameters import Floats, Positive, named_or_given
from .spectra import Jonswap, Spectrum
from .spreadings import Spreading

PER_OCTAVE = 16
"""Bins of an octave, where no width is given."""

DIRECTIONS = 36
"""Directions over the range of a spreading, one more where its two ends differ."""

PAPER_FETCH = 30e3
"""Fetch of the paper [m]."""

_NODES = 16  # of the quadrature over a bin, of either kind
_LAYOUT = 20_260_501  # key of the places of waves within their bins, the same for every seed
_MOST_DIRECTIONS = 100_000
_NEGLIGIBLE = 1e-9  # of a bin: rounding of its edges


Waves = tuple[Floats, Floats, Floats]
"""Variance [m2], frequency [rad s-1] and direction from the wind [rad] of each wave."""


class Band(Model, frozen=True):
    """Band of frequencies and directions that the waves of a sea sample.

    Parameters
    ----------
    omega_min, omega_max : float
        Lowest and highest frequency [rad s-1].
    d_theta : float
        Distance of directions [rad].
    d_omega : float, optional
        Width of the bins of frequency [rad s-1]; a sixteenth of an octave by default.
    drawn : bool
        One wave at a random place of each cell of frequency and direction: the same for every seed,
        so that a sea has no period. False: equally spaced waves, as in the paper, with
        which it repeats after 2 pi / d_omega.

    Raises
    ------
    Refused
        If a parameter is out of range, or equally spaced waves have no `d_omega`.

    Examples
    --------
    >>> Band(omega_min=1.2, omega_max=4.0, d_omega=0.2, d_theta=math.pi / 5, drawn=False).bins
    15
    """

    omega_min: Positive
    omega_max: Positive
    d_theta: Positive
    d_omega: Positive | None = None
    drawn: bool = True

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.omega_max <= self.omega_min:
            allowed = f"> {self.omega_min:.4g} rad/s, the lowest frequency of the band"
            raise Refused("omega_max", self.omega_max, allowed)
        if self.d_omega is None and not self.drawn:
            raise Refused("d_omega", None, "a distance [rad/s] of equally spaced waves")
        return self

    @property
    def bins(self) -> int:
        """Number of bins, or of equally spaced frequencies."""
        # the tolerance keeps 1.2, 1.4, ..., 4.0 at 15 whatever the last bit of the quotient
        if self.d_omega is None:
            return math.ceil(PER_OCTAVE * math.log2(self.omega_max / self.omega_min) - _NEGLIGIBLE)
        steps = (self.omega_max - self.omega_min) / self.d_omega
        return math.ceil(steps - _NEGLIGIBLE) if self.drawn else math.floor(steps + 1e-9) + 1

    @property
    def edges(self) -> Floats:
        """Edges of the bins [rad s-1]; the last bin ends with the band.

        A wider band adds bins to those of a narrower one.
        """
        steps = np.arange(self.bins + 1, dtype=np.float64)
        if self.d_omega is None:
            edges = self.omega_min * 2.0 ** (steps / PER_OCTAVE)
        else:
            edges = self.omega_min + self.d_omega * steps
        edges[-1] = self.omega_max
        return edges

    def waves(self, spectrum: Spectrum, spreading: Spreading) -> Waves:
        """Return the waves of a sea in this band, arrays (n_omega, n_theta)."""
        if self.drawn:
            return drawn_waves(self.edges, self.d_theta, spectrum, spreading)
        assert self.d_omega is not None
        centers = self.omega_min + self.d_omega * np.arange(self.bins)
        theta = direction_grid(spreading.half_range, self.d_theta)
        shares = direction_weights(
            spreading, centers, theta, self.d_theta,
            omega_p=spectrum.omega_p, wind_speed=spectrum.wind_speed,
        )  # fmt: skip
        # the paper's rule: density at the frequency of the wave times the distance of waves
        variance = (spectrum(centers) * self.d_omega)[:, None] * shares
        omega = np.broadcast_to(centers[:, None], shares.shape)
        return variance, omega, np.broadcast_to(theta, shares.shape)


PAPER_BANDS = {
    5.0: Band(omega_min=1.2, omega_max=4.0, d_omega=0.2, d_theta=math.pi / 5, drawn=False),
    13.0: Band(omega_min=0.9, omega_max=3.0, d_omega=0.1, d_theta=math.pi / 20, drawn=False),
}
"""The paper's table of bands, by wind speed [m s-1]; its fetch is 30 km."""

BandName = Literal["mean", "paper", "scaled"]


@check_call
def named_band(name: BandName, spectrum: Spectrum, half_range: float, order: int = 1) -> Band:
    """Return a band by its name.

    Parameters
    ----------
    name : {"mean", "paper", "scaled"}
        "mean", for mean gains: 0.6 to 2.1 omega_p, in bins of a sixteenth of an octave and 36
        directions; with `order` 2 in 10 frequencies and 10 directions.
        "paper": the paper's table, for JONSWAP spectra at 5 and 13 m/s.
        "scaled": 0.6 to 2.1 omega_p in 21 equally spaced frequencies, and directions of pi / 20.
    spectrum : Spectrum
        Spectrum of the sea.
    half_range : float
        Largest |theta| of its spreading [rad].
    order : {1, 2}
        Order of the sea in the slopes.

    Raises
    ------
    Refused
        If the paper has no such sea.

    Notes
    -----
    A JONSWAP sea keeps 96 % of the variance of its elevation in each of them, but only a third
    (2 m/s) to a tenth (30 m/s) of the mean square slope of Cox and Munk. Its waves do not focus
    light within a few metres, so that a mean gain costs little.

    The limits are those of the paper's two bands, (0.61, 2.04) and (0.64, 2.12) omega_p, rounded,
    so that a sweep over wind speed does not jump at 5 and 13 m/s. In second order every pair of
    waves has two bound waves: 1073 waves would have more than a million.
    """
    peak = spectrum.omega_p
    low, high = 0.6 * peak, 2.1 * peak
    if name == "mean" and order == 1:
        return Band(omega_min=low, omega_max=high, d_theta=2.0 * half_range / DIRECTIONS)
    if name == "mean":
        # ten bins over 1.5 peak frequencies: every pair of these waves makes two more
        step, turn = 0.15 * peak, 2.0 * half_range / 10
        return Band(omega_min=low, omega_max=high, d_omega=step, d_theta=turn)
    if name == "scaled":
        step, turn = 0.075 * peak, math.pi / 20
        return Band(omega_min=low, omega_max=high, d_omega=step, d_theta=turn, drawn=False)
    band = PAPER_BANDS.get(spectrum.wind_speed) if type(spectrum) is Jonswap else None
    if band is None:
        raise Refused("waves", name, "JONSWAP seas at 5 and 13 m/s only; 'scaled' takes any wind")
    return band


@check_call
def paper_waves(spectrum: Spectrum) -> BandName:
    """Return "paper" for the sea states of the paper's table, "scaled" for all others.

    Examples
    --------
    >>> paper_waves(Jonswap(wind_speed=5.0)), paper_waves(Jonswap(wind_speed=5.0, fetch=5e3))
    ('paper', 'scaled')
    """
    known = type(spectrum) is Jonswap and spectrum.fetch == PAPER_FETCH
    return "paper" if known and spectrum.wind_speed in PAPER_BANDS else "scaled"


_read_name = partial(named_or_given, Band, get_args(BandName), "waves")


def _read(value: Any, more: str = "") -> Any:
    """Validate a band or its name; `more` names further allowed values."""
    return value if value is None else _read_name(value, more=more)


def _read_of_mesh(value: Any) -> Any:
    if value == "fading" or (is_number(value) and 0.0 < value < math.inf):
        return value
    return _read(value, ", fading, a frequency > 0 rad/s")


OwnWaves = Annotated[BandName | Band | None, BeforeValidator(_read)]
"""Field type of the waves of a sea: the name of a band, a `Band`, or its plain data."""

MeshWaves = Annotated[
    BandName | Literal["fading"] | Positive | Band | None, BeforeValidator(_read_of_mesh)
]
"""Field type of the waves of a mesh: also "fading", or all up to a frequency."""


def _two_edges(edges: Floats) -> Floats:
    if len(edges) < 2 or edges[0] < 0.0 or not (np.diff(edges) > 0.0).all():
        raise Refused("", edges, "two or more rising frequencies [rad s-1]")
    return edges


Edges = Annotated[Floats, Shape("n"), AfterValidator(_two_edges)]


@check_call
def drawn_waves(edges: Edges, d_theta: float, spectrum: Spectrum, spreading: Spreading) -> Waves:
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
    """
    nodes, weights = gauss_legendre(_NODES)
    width = np.diff(edges)
    at = edges[:-1, None] + width[:, None] * 0.5 * (nodes + 1.0)
    variance = 0.5 * width * (spectrum(at) * weights).sum(axis=1)
    half = spreading.half_range
    middle = direction_grid(half, d_theta)
    low = np.maximum(middle - 0.5 * d_theta, -half)
    cell = np.minimum(middle + 0.5 * d_theta, half) - low
    theta = low[:, None] + cell[:, None] * 0.5 * (nodes + 1.0)
    # the spreading of a bin is that of its geometric middle
    center = np.sqrt(edges[:-1] * edges[1:])[:, None]
    density = spreading.density(
        center, theta.ravel(), omega_p=spectrum.omega_p, wind_speed=spectrum.wind_speed
    )
    shares = (density.reshape(len(width), *theta.shape) * weights).sum(axis=2) * cell
    # whatever the error of the quadrature, a bin keeps its variance
    shares /= shares.sum(axis=1, keepdims=True)
    return variance[:, None] * shares, *drawn_places(edges, low, cell)


def drawn_places(edges: Floats, low: Floats, width: Floats | float) -> tuple[Floats, Floats]:
    """Return the frequency [rad s-1] and direction [rad] of one wave in each cell.

    Parameters
    ----------
    edges : ndarray, shape (m + 1,)
        Edges of the frequency bins [rad s-1].
    low, width : ndarray, shape (n,)
        Lowest direction of each cell, and its width [rad].

    Returns
    -------
    omega, theta : ndarray, shape (m, n)

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
    shape = len(edges) - 1, len(low)
    # ranks of random numbers, row by row: wider bands keep the places of the narrower
    part = rng_order.random(shape).argsort(axis=1) + rng_frequency.random(shape)
    omega = edges[:-1, None] + np.diff(edges)[:, None] * part / len(low)
    return omega, low + width * rng_direction.random(shape)


@check_call
def direction_grid(
    half_range: Annotated[float, Field(gt=0.0, le=math.pi)], d_theta: float
) -> Floats:
    """Return directions spaced by `d_theta` and symmetric about the wind.

    Parameters
    ----------
    half_range : float
        pi / 2 or pi [rad]: the largest |theta| with energy.
    d_theta : float
        Distance of neighbouring directions [rad].

    Returns
    -------
    ndarray, shape (n,)
        As many directions as fit; the ends -+pi/2 are included, -pi and pi are not both.

    Raises
    ------
    Refused
        If `d_theta` is not in (0, half_range].

    Examples
    --------
    >>> [len(direction_grid(math.pi / 2, step)) for step in (math.pi / 5, math.pi / 20)]
    [6, 21]
    """
    require_between(d_theta, 0.0, half_range, "d_theta", "(]")
    # the tolerance keeps pi over pi / 20 at 20 steps whatever the last bit of the quotient
    fits = math.floor(2.0 * half_range / d_theta * (1.0 + 1e-12))
    if fits > _MOST_DIRECTIONS:
        raise Refused("d_theta", d_theta, f"at most {_MOST_DIRECTIONS:,} directions")
    n = fits if half_range == math.pi else fits + 1
    return d_theta * (np.arange(n, dtype=np.float64) - 0.5 * (n - 1))


@check_call
def direction_weights(
    spreading: Spreading,
    omega: Annotated[ArrayLike, Shape("n")],
    theta: Annotated[Floats, Shape("m")],
    d_theta: Positive,
    *,
    omega_p: float,
    wind_speed: float,
) -> Floats:
    """Return the energy fractions D(theta_j) d_theta, normalised at each frequency.

    Parameters
    ----------
    spreading : Spreading
        The spreading.
    omega : array_like, shape (m,)
        Angular frequencies [rad s-1].
    theta : ndarray, shape (n,)
        Directions of `direction_grid` [rad].
    d_theta : float
        Their distance [rad].
    omega_p, wind_speed : float
        Peak frequency [rad s-1] and wind speed [m s-1] of the sea.

    Returns
    -------
    ndarray, shape (m, n)
        Shares, every row summing to one.

    Notes
    -----
    Cells that reach beyond the half-range are cut there, so that the ends -+pi/2 count half, as
    in the trapezoidal rule. For the paper's directions (6 by pi/5, 21 by pi/20) and cos^2 the
    shares of the paper, D d_theta, sum to one already.
    """
    half = spreading.half_range
    cells = np.minimum(theta + 0.5 * d_theta, half) - np.maximum(theta - 0.5 * d_theta, -half)
    column = np.asarray(omega, dtype=np.float64)[:, None]
    shares = spreading.density(column, theta, omega_p=omega_p, wind_speed=wind_speed) * cells
    return shares / shares.sum(axis=1, keepdims=True)
