"""Random seas: sums of waves whose amplitudes follow a spectrum or a table."""

from __future__ import annotations

import math
from abc import abstractmethod
from functools import cached_property
from typing import ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import model_validator

from meshtrace.errors import Refused
from meshtrace.mesh import UnresolvedSlopes

from .bound_waves import with_bound_waves
from .dispersion import wavenumber
from .parameters import (
    Alpha,
    Current,
    Depth,
    Fetch,
    Finite,
    Floats,
    Gamma,
    Mss,
    Positive,
    Seed,
    WindSpeed,
)
from .slope_spectrum import SlopeSpectrum
from .spectra import ALPHA_COEFFICIENT, AnySpectrum, Jonswap, Spectrum
from .spreading import AnySpreading, IttcSpreading, direction_grid, direction_weights
from .statistics import (
    meshed_slope_variance,
    real_slope_variance,
    unresolved_slope_variance,
)
from .wave_surface import WaveSurface
from .waves import WaveComponents


class Band(NamedTuple):
    """Frequencies and directions of a wave sum [rad s-1 and rad]."""

    omega_min: float
    omega_max: float
    d_omega: float
    d_theta: float


PAPER_FETCH = 30e3
PAPER_BANDS = {
    5.0: Band(1.2, 4.0, 0.2, math.pi / 5),
    13.0: Band(0.9, 3.0, 0.1, math.pi / 20),
}
"""The paper's table of bands, by wind speed [m s-1]; its fetch is 30 km."""

_ORDER_OMEGA_MAX = 3.0  # highest frequency of waves that make bound waves, over the peak's


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
    Cox and Munk: raise `omega_max` to
    resolve shorter waves, or see `statistics.unresolved_slope_variance`.
    """
    return Band(0.6 * omega_p, 2.1 * omega_p, 0.075 * omega_p, math.pi / 20)


class RandomSea(WaveSurface, frozen=True):
    """A sum of waves with random phases, one realization per seed.

    Parameters
    ----------
    seed : int
        Seed of the random phases.
    choppy : bool
        First order in Lagrangian coordinates, with sharper crests; see `WaveSurface`.
    order : {1, 2}
        2 adds the bound waves of second order at fixed points, see `with_bound_waves`: crests
        are higher and troughs flatter, and the elevation is skewed. For deep water.
    order_omega_max : float, optional
        Highest frequency of waves that make bound waves [rad s-1], by default 3 times that of the
        peak. The second order diverges for short waves on long ones: waves beyond it are
        superposed linearly.

    Raises
    ------
    Refused
        If `order` is 2 for a choppy sea or in water of finite depth.

    Notes
    -----
    Phases are 2 pi `numpy.random.default_rng(seed).random((n_omega, n_theta))`, frequencies
    along the first axis. A subclass defines `free_waves`.
    """

    seed: Seed = 0
    order: Literal[1, 2] = 1
    order_omega_max: Positive | None = None

    most_components: ClassVar[int] = 1_000_000

    @property
    @abstractmethod
    def free_waves(self) -> WaveComponents:
        """The plane waves of first order."""

    @cached_property
    def components(self) -> WaveComponents:
        """The plane waves as plain arrays: the free ones and, with `order` 2, the bound ones.

        Bound waves are sums and differences of two waves: they do not follow the dispersion.
        """
        free = self.free_waves
        if self.order == 1:
            return free
        limit = self.order_omega_max or _ORDER_OMEGA_MAX * self._peak_frequency()
        return with_bound_waves(free, limit, self.most_components)

    def _peak_frequency(self) -> float:
        """Return the frequency of the largest wave [rad s-1]."""
        waves = self.free_waves
        return float(waves.omega[np.argmax(waves.amplitude)])

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.order == 1:
            if self.order_omega_max is not None:
                raise Refused("order_omega_max", self.order_omega_max, "only with order = 2")
            return self
        if self.choppy:
            raise Refused("order", 2, "1 with choppy = true: both sharpen the same crests")
        if self._water_depth() is not None:
            raise Refused("order", 2, "1 with depth: bound waves are those of deep water")
        return self

    def with_seed(self, seed: int) -> Self:
        """Return another realization of the same sea, which shares the grid factors.

        Parameters
        ----------
        seed : int
            Seed of the new phases, >= 0.

        Returns
        -------
        RandomSea
            The same parameters with the new seed. Its meshes on a grid that this sea has used
            cost a matrix product only, unless `jitter` draws new frequencies.

        Examples
        --------
        >>> sea = JonswapSea(wind_speed=13.0, seed=7)
        >>> sea.with_seed(8) == JonswapSea(wind_speed=13.0, seed=8)
        True
        """
        other = self.model_copy(update={"seed": seed})
        if not getattr(self, "jitter", False):  # which draws new wave vectors
            other._factors.share(self._factors)
        return other

    @property
    def slope_variance(self) -> tuple[float, float] | None:
        """Slope variances of the real sea along and across the wind; None if not known."""
        return None

    @property
    def _slopes_along_deg(self) -> float:
        """Direction of the first of the slope variances."""
        return getattr(self, "wind_direction_deg", 0.0)

    def unresolved_slopes(self, spacing: float) -> UnresolvedSlopes | None:
        """Return the slope variances that a mesh of this spacing [m] leaves out of `mss`.

        The slopes of a choppy mesh are taken as those of its labels, off by O(mss).
        """
        if self.slope_variance is None:
            return None
        wind = self._slopes_along_deg
        vertex, facet = (
            unresolved_slope_variance(self.slope_variance, resolved)
            for resolved in meshed_slope_variance(self.components, spacing, wind)
        )
        return UnresolvedSlopes(vertex, facet, wind)


class _BandedSea(RandomSea, frozen=True):
    """Random sea whose waves sample a spectrum and a spreading within a band."""

    omega_min: Positive | None = None
    omega_max: Positive | None = None
    d_omega: Positive | None = None
    d_theta: Positive | None = None
    spreading: AnySpreading = IttcSpreading()
    wind_direction_deg: Finite = 0.0
    depth: Depth | None = None
    capillary: bool = False
    jitter: bool = False
    current: Current | None = None
    mss: Mss = "cox-munk"

    @abstractmethod
    def _sampled_spectrum(self) -> Spectrum:
        """Return the spectrum S(omega) of the sea."""

    def _default_band(self) -> Band:
        return scaled_band(self._sampled_spectrum().omega_p)

    def _peak_frequency(self) -> float:
        return self._sampled_spectrum().omega_p

    @property
    def band_limits(self) -> Band:
        """Frequencies and directions in use: given values and defaults."""
        given = self.omega_min, self.omega_max, self.d_omega, self.d_theta
        return Band(
            *(d if g is None else g for g, d in zip(given, self._default_band(), strict=True))
        )

    @model_validator(mode="after")
    def _check_band(self) -> Self:
        band = self.band_limits
        if band.omega_min >= band.omega_max:
            raise Refused("omega_min", band.omega_min, f"< omega_max = {band.omega_max:g} rad/s")
        if self.jitter and band.d_omega > 2.0 * band.omega_min:
            allowed = f"<= 2 omega_min = {2 * band.omega_min:g} rad/s with jitter"
            raise Refused("d_omega", band.d_omega, allowed)
        directions = len(direction_grid(self.spreading.half_range, band.d_theta))
        count = _frequency_count(band) * directions
        if count > self.most_components:
            allowed = f"a band of at most {self.most_components} waves, not {count}"
            raise Refused("d_omega", band.d_omega, allowed)
        return self

    @cached_property
    def free_waves(self) -> WaveComponents:
        """The waves of first order, direction by direction at each frequency."""
        band, spectrum = self.band_limits, self._sampled_spectrum()
        centers = band.omega_min + band.d_omega * np.arange(_frequency_count(band))
        theta = direction_grid(self.spreading.half_range, band.d_theta)
        shares = direction_weights(
            self.spreading,
            centers,
            theta,
            band.d_theta,
            omega_p=spectrum.omega_p,
            wind_speed=spectrum.wind_speed,
        )
        rng = np.random.default_rng(self.seed)
        phase = 2.0 * math.pi * rng.random(shares.shape)
        omega = np.broadcast_to(centers[:, None], shares.shape)
        if self.jitter:
            omega = omega + band.d_omega * (rng.random(shares.shape) - 0.5)
        amplitude = np.sqrt(2.0 * spectrum(omega) * band.d_omega * shares)
        k = wavenumber(omega, self._water_depth(), self.capillary)
        heading = theta + math.radians(self.wind_direction_deg)
        return flat_components(amplitude, omega, k, heading, phase, self.current)

    def slope_spectrum(self, omega_max: float | None = None) -> SlopeSpectrum:
        """Return the slopes of all waves of the spectrum, or of those up to a frequency [rad/s]."""
        depth, spectrum = self._water_depth(), self._sampled_spectrum()
        return SlopeSpectrum.of(spectrum, self.spreading, omega_max, depth, self.capillary)

    @property
    def slope_variance(self) -> tuple[float, float] | None:
        """Slope variances along and across the wind of the real sea, by `mss`."""
        spectrum = self._sampled_spectrum()
        return real_slope_variance(self.mss, spectrum.wind_speed, getattr(spectrum, "fetch", None))

    def slopes_beyond(self, omega_max: float) -> tuple[float, float]:
        """Return the slope variances along and across the wind beyond a frequency [rad/s]."""
        if self.slope_variance is None:
            return 0.0, 0.0
        resolved = self.slope_spectrum(omega_max).along_and_across
        return unresolved_slope_variance(self.slope_variance, resolved)


class JonswapSea(_BandedSea, frozen=True):
    """Fetch-limited wind sea with the JONSWAP spectrum.

    z = sum_ij a_ij cos(omega_i t - k_i (x cos theta_j + y sin theta_j) + eps_ij),
    a_ij = sqrt(2 S(omega_i) D(theta_j) d_omega d_theta)

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1], 0 < U <= 60 (the spectrum was fitted up to some 20).
    fetch : float
        Fetch [m].
    seed : int
        Seed of the random phases (and frequencies, with `jitter`).
    band : "paper", "scaled" or None
        The paper's table (5 and 13 m/s only) or `scaled_band`. None is the paper's table
        at its own sea states, 5 and 13 m/s with 30 km of fetch, and "scaled" otherwise.
    omega_min, omega_max, d_omega : float, optional
        First and last frequency and their distance [rad s-1]; each replaces its value of the
        band.
    d_theta : float, optional
        Distance of directions [rad]; replaces its value of the band.
    spreading : Spreading
        Directional spreading; or a kind such as "ittc" or "cos2s".
    wind_direction_deg : float
        Direction the wind blows to, counter-clockwise from +x [deg].
    depth : float, optional
        Water depth [m] in the dispersion; None is deep water. The spectrum keeps its deep-water
        form: for the finite-depth one see `SpectralSea` with `Tma`.
    capillary : bool
        Add the surface tension to the dispersion, for bands beyond some 30 rad/s.
    jitter : bool
        Draw every wave's frequency uniformly within its bin. Equally spaced frequencies make
        the sea repeat after 2 pi / d_omega (31 s in the paper's band at 5 m/s); drawn ones do not.
    current : (float, float), optional
        Uniform current (U_x, U_y) [m s-1] that carries the waves: omega = sigma(k) + k.U. The
        spectrum is that of an observer who drifts with the current, so wavenumbers stay.
    gamma : float
        Peak enhancement.
    hs, tp : float, optional
        Significant wave height [m] and peak period [s], which replace those of the fetch law.
    alpha_coefficient : float
        Factor of the fetch law for alpha, 0.075 in the paper, 0.076 in the literature.
    choppy, order, order_omega_max
        Nonlinear seas, see `RandomSea`.
    mss : {"cox-munk", "elfouhaily", "band"}
        Slope variance of the real sea: measured, or of a spectrum down to the capillaries. The
        tracer tilts normals at random by the rest that a mesh lacks (`Physics.unresolved`). "band":
        there are no waves beyond the band.

    Raises
    ------
    pydantic.ValidationError
        If a parameter is out of range, or band="paper" at another wind speed.

    Notes
    -----
    The paper's bands stop at 4 rad/s for 5 m/s and at 3 rad/s for 13 m/s, that is, at about
    2.1 omega_p. They carry 96 % of the elevation variance but 22 % and 14 % of the mean square
    slope of Cox and Munk (1954): the short waves that are left out bend light as much as the
    long ones. A larger `omega_max` resolves more of them.

    With `jitter` the amplitudes follow S at the drawn frequency, so variances hold on
    average over seeds rather than for each.

    References
    ----------
    Hasselmann et al. (1973), Dtsch. Hydrogr. Z. A8(12).

    Examples
    --------
    >>> sea = JonswapSea(wind_speed=13.0, fetch=30e3, seed=7)
    >>> sea.band_limits.omega_max, len(sea.components.amplitude)
    (3.0, 462)
    >>> sea.mesh(extent=2.0, spacing=0.5).vertices.shape
    (81, 3)
    """

    kind: Literal["jonswap"] = "jonswap"
    wind_speed: WindSpeed = 5.0
    fetch: Fetch = PAPER_FETCH
    gamma: Gamma = 3.3
    alpha_coefficient: Alpha = ALPHA_COEFFICIENT
    hs: Positive | None = None
    tp: Positive | None = None
    band: Literal["paper", "scaled"] | None = None

    @property
    def spectrum(self) -> Jonswap:
        """The JONSWAP spectrum of this sea."""
        return Jonswap(
            wind_speed=self.wind_speed,
            fetch=self.fetch,
            gamma=self.gamma,
            alpha_coefficient=self.alpha_coefficient,
            hs=self.hs,
            tp=self.tp,
        )

    def _sampled_spectrum(self) -> Spectrum:
        return self.spectrum

    def _default_band(self) -> Band:
        tabulated = PAPER_BANDS.get(self.wind_speed)
        if self.band == "paper" and tabulated is None:
            raise Refused("band", "paper", "at 5 and 13 m/s only; 'scaled' takes any wind")
        usual = self.band is None and self.fetch == PAPER_FETCH and self.tp is None
        chosen = self.band == "paper" or usual
        return tabulated if tabulated and chosen else super()._default_band()


class SpectralSea(_BandedSea, frozen=True):
    """Random sea with any of the spectra of `meshtrace.surfaces.spectra`.

    Parameters
    ----------
    spectrum : Spectrum
        `Jonswap`, `Tma`, `PiersonMoskowitz`, `Elfouhaily` or a `Spectrum` of your own, as an
        object or as plain data.
    spreading : Spreading
        `IttcSpreading`, `Cos2sSpreading`, `MitsuyasuSpreading`, `ElfouhailySpreading` or a
        `Spreading` of your own.
    seed, omega_min, omega_max, d_omega, d_theta, wind_direction_deg, jitter, current, mss
        See `JonswapSea`; the default band is `scaled_band`.
    choppy, order, order_omega_max
        See `RandomSea`.
    depth : float, optional
        Water depth [m]; None is the depth of the spectrum (`Tma`), or else deep water.
    capillary : bool
        Surface tension in the dispersion, on by default.

    Raises
    ------
    pydantic.ValidationError
        If a parameter is out of range, or `depth` contradicts the spectrum.

    Examples
    --------
    >>> from meshtrace.surfaces import Elfouhaily
    >>> sea = SpectralSea(spectrum=Elfouhaily(wind_speed=8.0), spreading="elfouhaily", seed=1)
    >>> sea.elevation(0.0, 0.0).shape
    ()
    """

    kind: Literal["spectral"] = "spectral"
    spectrum: AnySpectrum
    capillary: bool = True

    @model_validator(mode="after")
    def _check_depth(self) -> Self:
        own = getattr(self.spectrum, "depth", None)
        if None not in (own, self.depth) and own != self.depth:
            raise Refused("depth", self.depth, f"{own:g} m, the depth of the spectrum")
        return self

    def _sampled_spectrum(self) -> Spectrum:
        return self.spectrum

    def _water_depth(self) -> float | None:
        return getattr(self.spectrum, "depth", self.depth)


def _frequency_count(band: Band) -> int:
    # The tolerance keeps 1.2, 1.4, ..., 4.0 at 15 whatever the last bit of the quotient.
    return math.floor((band.omega_max - band.omega_min) / band.d_omega + 1e-9) + 1


def flat_components(
    amplitude: Floats,
    omega: Floats,
    k: Floats,
    heading: Floats,
    phase: Floats,
    current: tuple[float, float] | None = None,
) -> WaveComponents:
    """Return tables over frequency and direction as plain arrays.

    Parameters
    ----------
    omega : ndarray
        Frequencies seen by an observer who moves with the current [rad s-1].
    """
    kx, ky = k * np.cos(heading), k * np.sin(heading)
    if current is not None:
        omega = omega + kx * current[0] + ky * current[1]
    return WaveComponents(*(np.ravel(a).copy() for a in (amplitude, omega, kx, ky, phase)))
