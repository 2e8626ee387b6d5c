"""Air bubbles below a windy sea: base, the Hall-Novarini population and its scattering."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, field_validator, model_validator

from meshtrace.checks import Infinite, Positive, RangedArray, check_call
from meshtrace.errors import Refused, is_number, require_between, require_range
from meshtrace.models import Family, Floats
from meshtrace.optics.mie import MieTable, cached_table, population_table
from meshtrace.optics.phase import HistogramPhase, PhaseFunction
from meshtrace.optics.power_laws import Segments
from meshtrace.quadrature import gauss_legendre

# Depth of the layer in e-folding depths: `BubblePopulation.profile` ends there (what is left out
# stands in its Notes).
LAYER = 12.0
_MOST_NODES = 10**7  # of a profile, and most radii: tuned to bound the memory, 80 MB an array
# Highest crest [m] to which a population is continued upwards with depth="mean_level".
HIGHEST = 20.0


class BubblePopulation(Family, frozen=True, default="hall-novarini"):
    """Base of the bubble populations: a subclass defines `b`, `e_folding` and `phase_function`.

    Parameters
    ----------
    depth : {"local", "clamped", "mean_level"}
        Depth under waves in the transport: the distance to the surface above the point,
        max(0, -z), or -z even in crests, where depths are negative.
    """

    depth: Literal["local", "clamped", "mean_level"] = "local"

    @property
    @abstractmethod
    def e_folding(self) -> float:
        """Depth scale of the layer [m]: b is tabulated in steps of 1/64 of it, down to 12."""

    @abstractmethod
    def b(self, depth: RangedArray) -> Floats:
        """Return the scattering coefficient [m-1] at depths [m]."""

    @abstractmethod
    def phase_function(self) -> PhaseFunction:
        """Return the phase function of the population, the same at all depths."""

    def _checked(self, depth: RangedArray) -> Floats:
        lowest = -HIGHEST if self.depth == "mean_level" else 0.0
        allowed = f"finite depth >= {lowest:g} m"
        return require_range(depth, lowest, math.inf, "depth", "[)", allowed)

    def optical_depth(self, depth1: RangedArray, depth2: RangedArray) -> Floats:
        """Return the vertical optical depth of the bubbles between two depths.

        tau = |integral of b(z) dz from depth1 to depth2|

        Parameters
        ----------
        depth1, depth2 : array_like
            Depths [m], in any order, broadcast.

        Returns
        -------
        ndarray
            Optical depth.

        Notes
        -----
        Gauss-Legendre quadrature with 128 nodes, good to 1e-12; all that lies 40 e-folding depths
        below the upper end is left out.
        """
        ends = np.broadcast_arrays(self._checked(depth1), self._checked(depth2))
        upper, lower = np.minimum(*ends), np.maximum(*ends)
        return integrate(self.b, upper, np.minimum(lower, upper + 40.0 * self.e_folding), 128)

    def profile(
        self,
        dz: Positive,
        max_depth: Annotated[float, Field(gt=0.0), Infinite()] = math.inf,
        crest: float = 0.0,
    ) -> tuple[Floats, Floats, Floats]:
        """Return b and its integral on a uniform grid of depths.

        Parameters
        ----------
        dz : float
            Spacing [m].
        max_depth : float
            Deepest depth needed [m].
        crest : float
            Height [m] above the mean level at which the grid begins; only with
            depth="mean_level", otherwise 0.

        Returns
        -------
        depth : ndarray, shape (n,)
            Nodes [m], -crest + i dz, to the first at or below `max_depth` or 12 L, whichever
            is higher.
        b : ndarray, shape (n,)
            Scattering coefficient [m-1].
        cumulative : ndarray, shape (n,)
            Optical depth from the first node, zero there.

        Raises
        ------
        Refused
            If `dz` or `max_depth` is not positive, or `crest` is not allowed.

        Notes
        -----
        At the nodes the cumulative is good to 1e-12 (1e-7 for dz = 5 L). Between nodes a cubic
        Hermite interpolant with slopes b errs by about (dz/L)^4/400 of the layer's optical depth,
        a straight line by (dz/L)^2/8. Below 12 L take b = 0: that leaves out 1.1e-5 (5 m/s),
        2.5e-5 (13 m/s) or 5.6e-5 (20 m/s) of the layer's optical depth.

        Examples
        --------
        >>> from meshtrace.optics.bubbles import HallNovarini
        >>> depth, b, cumulative = HallNovarini(wind_speed=13.0, q=2.0).profile(dz=0.01)
        >>> round(float(cumulative[1000]), 7)
        0.0989773
        """
        highest = HIGHEST if self.depth == "mean_level" else 0.0
        require_between(crest, 0.0, highest, "crest", "[]", f"0 <= crest <= {highest:g} m")
        most = min(max_depth, LAYER * self.e_folding) + crest
        if most / dz > _MOST_NODES:
            raise Refused("dz", dz, f"at most {_MOST_NODES} nodes over {most:g} m")
        cells = math.ceil(most / dz)
        depth = dz * np.arange(cells + 1, dtype=np.float64) - crest
        steps = integrate(self.b, depth[:-1], depth[1:], 16)
        return depth, self.b(depth), np.concatenate(([0.0], np.cumsum(steps)))


def integrate(
    function: Callable[[Floats], Floats], lower: Floats, upper: Floats, nodes: int
) -> Floats:
    """Return the integral of `function` from `lower` to `upper` by Gauss-Legendre quadrature."""
    node, weight = gauss_legendre(nodes)
    half = (upper - lower) / 2.0
    points = lower[..., None] + half[..., None] * (1.0 + node)
    # Not a matrix product: its order of summation, and so the last digits of an integral, may
    # depend on how many intervals are integrated at once.
    return half * (function(points) * weight).sum(axis=-1)


# Constants of the model as the paper prints them, lengths in m (errata: E9).
DENSITY = 1.6e10  # n at r_ref [m-4], at the surface for a wind of WIND
WIND = 13.0  # m s-1
R_REF, R_REF_SLOPE = 54.4e-6, 1.984e-6  # at the surface [m], growth per m of depth [m m-1]
KAPPA, KAPPA_DEPTH = 4.37, 2.55  # exponent at the surface, depth [m] at which it is 1 larger
# L up to E_FOLDING_WIND [m], its growth per wind speed above [m/(m s-1)], that wind [m s-1]
E_FOLDING, E_FOLDING_SLOPE, E_FOLDING_WIND = 0.4, 0.115, 7.5

# Numbers of radii and of angle sets of the phase table, see `compute_bubble_phase`. Tuned: they
# trade its accuracy for the time to compute it.
SIZES, ROTATIONS = 6144, 32


def _r_ref(depth: Floats) -> Floats:
    return R_REF + R_REF_SLOPE * depth


def _kappa(depth: Floats) -> Floats:
    return KAPPA + (depth / KAPPA_DEPTH) ** 2


class HallNovarini(BubblePopulation, frozen=True):
    """Hall-Novarini population of wind-made bubbles.

    n(r, z) = 1.6e10 G(r, z) (U/13)^3 exp(-z/L)   [m-4]

    G = (r_ref/r)^4 for r_min <= r <= r_ref(z), (r_ref/r)^kappa(z) for r_ref(z) < r <= r_max,
    r_ref = 54.4e-6 + 1.984e-6 z, kappa = 4.37 + (z/2.55)^2, z the depth in m,
    L = 0.4 for U <= 7.5, else 0.4 + 0.115 (U - 7.5)

    Parameters
    ----------
    wind_speed : float
        Wind speed U at 10 m [m s-1].
    r_min, r_max : float
        Smallest and largest radius [m].
    wavelength_nm : float
        Wavelength in vacuum [nm].
    n_water : float
        Refractive index of the water; that of the air in the bubbles is 1.
    psi : {"exact", "paper"}
        Integrals over size in closed form, or the published approximations:
        N_b = 1.6e10 r_ref^4/(3 r_min^3) (U/13)^3 exp(-z/L) and Psi = 3 pi r_min^2.
    q : "mie" or float
        Mean scattering efficiency: the Mie mean weighted by cross-section (2.0254 by default),
        or a number (the paper: 2.0).
    depth : {"local", "clamped", "mean_level"}
        Depth of the transport under waves: the distance to the surface above the
        point, max(0, -z), or -z even in crests. Only "mean_level" admits negative depths here.

    Raises
    ------
    Refused
        If a parameter is out of range or not finite, or r_min >= r_max; in the methods, if a depth
        is negative (unless depth="mean_level") or not finite.

    Notes
    -----
    Departures from the paper:

    - Its eq. r_ref adds 54.4 um to metres; here both terms are in m. The growth of r_ref with
      depth makes b fall more slowly than exp(-z/L): the optical depth of the layer is 15 %
      (13 m/s) or 6 % (5 m/s) above b(0) L.
    - Its eq. HN_S, Psi = 3 pi r_min^2, is 5.4 % too large at the surface and 12 % at 3 m
      (it counts r < r_ref up to infinity and omits r > r_ref); N_b is good to 0.2 %.
    - Its Q_sca = 2 is 1.3 % below the Mie mean.
    - With depth "mean_level", as published, exp(-z/L) exceeds 1 in crests: it is 1.87 at
      0.25 m (5 m/s) and 2.07 at 0.75 m (13 m/s).

    The constants are those the paper prints (5 and 13 m/s); U^3 at far higher winds is
    extrapolation. b vanishes with U: for a calm sea leave the bubbles out.

    References
    ----------
    Keiffer, Novarini and Norton (1995), J. Acoust. Soc. Am. 97.
    Ainslie (2005), J. Acoust. Soc. Am. 118, 3513, doi:10.1121/1.2114527.

    Examples
    --------
    >>> bubbles = HallNovarini(wind_speed=13.0, q=2.0)
    >>> round(float(bubbles.b(0.0)), 7)
    0.0834533
    >>> round(float(bubbles.optical_depth(0.0, 10.0)), 7)
    0.0989773
    """

    kind: Literal["hall-novarini"] = "hall-novarini"
    wind_speed: float = Field(gt=0.0, le=60.0, allow_inf_nan=False)
    r_min: float = Field(default=10e-6, ge=1e-7, le=1e-2, allow_inf_nan=False)
    r_max: float = Field(default=1e-3, ge=1e-7, le=1e-2, allow_inf_nan=False)
    wavelength_nm: float = Field(default=470.0, ge=200.0, le=2500.0, allow_inf_nan=False)
    n_water: float = Field(default=1.33, gt=1.0, le=2.0, allow_inf_nan=False)
    psi: Literal["exact", "paper"] = "exact"
    q: Literal["mie"] | float = "mie"

    @field_validator("q", mode="before")
    @classmethod
    def _known_q(cls, value: Any) -> Any:
        if value != "mie" and not (is_number(value) and 0.0 < value <= 10.0):
            raise Refused("q", value, '"mie" or 0 < q <= 10')
        return value

    @model_validator(mode="after")
    def _ordered_radii(self) -> HallNovarini:
        if self.r_min >= self.r_max:
            raise Refused("r_min", self.r_min, f"r_min < r_max = {self.r_max} m")
        return self

    @property
    def e_folding(self) -> float:
        """E-folding depth L [m]: 0.4 up to 7.5 m/s, then 0.115 m more per m/s."""
        return E_FOLDING + E_FOLDING_SLOPE * max(self.wind_speed - E_FOLDING_WIND, 0.0)

    @property
    def scattering_efficiency(self) -> float:
        """Mean scattering efficiency Q: the Mie mean weighted by cross-section, or the number."""
        return self._table().q_sca if self.q == "mie" else float(self.q)

    def r_ref(self, depth: RangedArray) -> Floats:
        """Return the reference radius [m], the kink of the size distribution, at a depth [m]."""
        return _r_ref(self._checked(depth))

    def kappa(self, depth: RangedArray) -> Floats:
        """Return the exponent of the size distribution above `r_ref` at a depth [m]."""
        return _kappa(self._checked(depth))

    def _density(self, depth: Floats) -> Floats:
        """Return n / G [m-4], the size distribution at r_ref."""
        return DENSITY * (self.wind_speed / WIND) ** 3 * np.exp(-depth / self.e_folding)

    def _moment(self, power: int, depth: Floats) -> Floats:
        """Return the integral of G r^power dr over all sizes [m^(power + 1)].

        r_ref^(p+1) [(r_min/r_ref)^(p-3) - 1]/(3-p) + r_ref^(p+1) [1 - (r_ref/r_max)^(kappa-p-1)]
        /(kappa-p-1). kappa grows without bound, so only ratios >= 1 are raised to -kappa.
        """
        r_ref, kappa = _r_ref(depth), _kappa(depth)
        # Integrals over x = r / r_ref of x^(p - 4) up to `split` and x^(p - kappa) above. r_ref may
        # lie outside of [r_min, r_max]: one of the two branches is then empty.
        split = np.clip(r_ref, self.r_min, self.r_max) / r_ref
        if power == 3:
            # the integral of 1 / x
            small = np.log(split * r_ref / self.r_min)
        else:
            small = ((self.r_min / r_ref) ** (power - 3) - split ** (power - 3)) / (3 - power)
        # kappa >= 4.37 keeps the exponent negative for all powers up to 3
        tail = power + 1.0 - kappa
        lower, upper = np.maximum(split, 1.0), np.maximum(self.r_max / r_ref, 1.0)
        large = (lower**tail - upper**tail) / -tail
        return r_ref ** (power + 1) * (small + large)

    def size_distribution(
        self, r: Annotated[ArrayLike, Field(gt=0.0)], depth: RangedArray
    ) -> Floats:
        """Return the number of bubbles per volume and radius.

        n(r, z) = 1.6e10 G(r, z) (U/13)^3 exp(-z/L)

        Parameters
        ----------
        r : array_like
            Radius [m].
        depth : array_like
            Depth [m], broadcast with `r`.

        Returns
        -------
        ndarray
            n [m-4], zero outside [r_min, r_max].

        Raises
        ------
        Refused
            If a depth is not allowed or a radius is not positive and finite.
        """
        z = self._checked(depth)
        radius = np.asarray(r)
        ratio = radius / _r_ref(z)
        present = (radius >= self.r_min) & (radius <= self.r_max)
        # `np.where` evaluates both branches: a small ratio to the power -kappa overflows at depth
        shape = np.where(ratio <= 1.0, ratio**-4.0, np.maximum(ratio, 1.0) ** -_kappa(z))
        return np.where(present, self._density(z) * shape, 0.0)[()]

    def number_density(self, depth: RangedArray) -> Floats:
        """Return the number of bubbles per volume.

        N_b(z) = integral of n(r, z) dr;  psi="paper": 1.6e10 r_ref^4/(3 r_min^3) (U/13)^3 exp(-z/L)

        Parameters
        ----------
        depth : array_like
            Depth [m].

        Returns
        -------
        ndarray
            N_b [m-3].
        """
        z = self._checked(depth)
        if self.psi == "paper":
            return self._density(z) * _r_ref(z) ** 4 / (3.0 * self.r_min**3)
        return self._density(z) * self._moment(0, z)

    def mean_cross_section(self, depth: RangedArray) -> Floats:
        """Return the mean geometric cross-section of a bubble.

        Psi(z) = integral of n pi r^2 dr / N_b;  psi="paper": 3 pi r_min^2

        Parameters
        ----------
        depth : array_like
            Depth [m].

        Returns
        -------
        ndarray
            Psi [m2].
        """
        z = self._checked(depth)
        if self.psi == "paper":
            return np.full(z.shape, 3.0 * np.pi * self.r_min**2)[()]
        return np.pi * self._moment(2, z) / self._moment(0, z)

    def b(self, depth: RangedArray) -> Floats:
        """Return the scattering coefficient of the bubbles.

        b(z) = N_b(z) Q Psi(z)

        Parameters
        ----------
        depth : array_like
            Depth [m].

        Returns
        -------
        ndarray
            b [m-1].
        """
        density = self.number_density(depth)
        return density * self.scattering_efficiency * self.mean_cross_section(depth)

    def void_fraction(self, depth: RangedArray) -> Floats:
        """Return the volume of air per volume of water and air.

        integral of n (4/3) pi r^3 dr (always exact)

        Parameters
        ----------
        depth : array_like
            Depth [m].

        Returns
        -------
        ndarray
            Void fraction.
        """
        z = self._checked(depth)
        return 4.0 / 3.0 * np.pi * self._density(z) * self._moment(3, z)

    def equal_area_radii(
        self, count: Annotated[int, Field(ge=1, le=_MOST_NODES)], depth: float = 0.0
    ) -> Floats:
        """Return radii that stand for equal parts of the geometric cross-section.

        The quantiles (k + 1/2)/count, k = 0 .. count - 1, of the weight G r^2.

        Parameters
        ----------
        count : int
            Number of radii.
        depth : float
            Depth [m].

        Returns
        -------
        ndarray, shape (count,)
            Radii [m], increasing.

        Raises
        ------
        Refused
            If `count` is below 1 or `depth` is not allowed.

        Examples
        --------
        >>> float(HallNovarini(wind_speed=5.0).equal_area_radii(1)[0].round(7))
        1.9e-05
        """
        z = self._checked(depth)
        # the weight G r^2 goes as r^-2, then as r^(2 - kappa); `Segments` (here of r in place of s)
        # holds exponents plus 1
        r_ref, p = float(_r_ref(z)), np.array([-1.0, 3.0 - float(_kappa(z))])
        edges = np.clip([self.r_min, r_ref, self.r_max], self.r_min, self.r_max)
        if edges[1] == self.r_max:
            # far below the surface no bubble is larger than r_ref: a single branch remains
            edges, p = edges[:-1], p[:1]
        area = Segments.from_densities(edges[:-1], edges[1:], p, (edges[1:] / r_ref) ** (p - 1.0))
        return area.quantile((np.arange(count) + 0.5) / count)

    def _table(self) -> MieTable:
        return _bubble_phase(self.n_water, self.wavelength_nm, self.r_min, self.r_max)

    def phase_table(self) -> tuple[Floats, Floats]:
        """Return the bin edges of the scattering angle [rad] and the CDF at them.

        See `phase_function`.
        """
        table = self._table()
        return table.theta_edges, table.cdf

    def phase_function(self) -> HistogramPhase:
        """Return the phase function of the population.

        beta(theta) = (1/b) integral of Q_b(r, theta) pi r^2 n(r, 0) dr

        Returns
        -------
        HistogramPhase
            2500 bins from 0 to pi.

        Notes
        -----
        It depends on radii, wavelength and index, not on the wind speed. The population of the
        surface serves for all depths: down to 1 m, 2 m, 3 m the CDF differs by at most 0.004,
        0.012, 0.019, all below 0.1 deg (0.003 beyond 1 deg), and averaged over the layer by
        0.001 (5 m/s) or 0.005 (13 m/s).

        The table for the default radii, 470 nm and 1.33 comes with the package; any other is
        computed once (some 10 s) and kept in MESHTRACE_CACHE_DIR or the user's cache folder.
        """
        return self._table().phase


@check_call
def compute_bubble_phase(
    n_water: float = 1.33,
    wavelength_nm: float = 470.0,
    r_min: float = 10e-6,
    r_max: float = 1e-3,
    *,
    depth: float = 0.0,
    sizes: int = SIZES,
    rotations: int = ROTATIONS,
) -> MieTable:
    """Compute the Mie phase table of the Hall-Novarini population at one depth.

    Parameters
    ----------
    n_water : float
        Refractive index of the water.
    wavelength_nm : float
        Wavelength in vacuum [nm].
    r_min, r_max : float
        Smallest and largest radius [m].
    depth : float
        Depth [m].
    sizes : int
        Number of radii, at the quantiles (k + 1/2)/sizes of the weight G r^2.
    rotations : int
        Number of node sets, see `meshtrace.optics.mie.population_table`.

    Returns
    -------
    MieTable

    Raises
    ------
    Refused
        If a parameter is out of the range that `HallNovarini` allows, or `sizes` or `rotations`
        is below 1.

    Notes
    -----
    This is the recipe of the shipped table: `compute_bubble_phase()`, miepython 3.3, written by
    `HallNovarini(wind_speed=5.0).phase_table()` with MESHTRACE_CACHE_DIR set to
    meshtrace/optics/data. Its CDF is good to 2e-5, with 1024 sizes to 1e-4.
    """
    bubbles = HallNovarini(
        wind_speed=WIND, n_water=n_water, wavelength_nm=wavelength_nm, r_min=r_min, r_max=r_max
    )
    radii = bubbles.equal_area_radii(sizes, depth)
    # size parameter, with the wavelength in the water; below, the index of air relative to water
    x = 2.0 * np.pi * radii * n_water / (wavelength_nm * 1e-9)
    return population_table(1.0 / n_water, x, rotations=rotations)


@lru_cache(maxsize=16)
def _bubble_phase(n_water: float, wavelength_nm: float, r_min: float, r_max: float) -> MieTable:
    # With the constants of the model at the surface, so that a table on disk that was made with
    # other constants is not read.
    inputs = {
        "n_water": n_water, "wavelength_nm": wavelength_nm, "r_min": r_min, "r_max": r_max,
        "r_ref": R_REF, "kappa": KAPPA, "sizes": SIZES, "rotations": ROTATIONS,
    }  # fmt: skip
    keys = n_water, wavelength_nm, r_min, r_max
    return cached_table("bubble_phase", inputs, lambda: compute_bubble_phase(*keys))
