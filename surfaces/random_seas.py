"""Random seas: sums of waves whose amplitudes follow a spectrum or a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import PlainValidator, model_validator

from meshtrace.errors import Refused, is_number
from meshtrace.mesh import FADING

from . import bands
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
    Variances,
    WindSpeed,
)
from .random_sea import RandomSea
from .slope_spectrum import SlopeSpectrum
from .spectra import (
    ALPHA_COEFFICIENT,
    AnySpectrum,
    Elfouhaily,
    Jonswap,
    PiersonMoskowitz,
    Spectrum,
    Tma,
)
from .spreading import AnySpreading, ElfouhailySpreading, IttcSpreading, direction_grid
from .statistics import real_slope_variance, unresolved_slope_variance
from .waves import WaveComponents, flat_components

_KEPT = (
    "wind_direction_deg", "current", "d_theta", "seed", "choppy", "order", "order_omega_max"
)  # fmt: skip


def _band_limit(value: Any) -> float | str | None:
    if value is None or value == FADING:
        return value
    if is_number(value) and math.isfinite(value) and value > 0.0:
        return float(value)
    raise Refused("omega_max", value, f'> 0 rad/s, or "{FADING}"')


class _BandedSea(RandomSea, frozen=True):
    """Random sea whose waves sample a spectrum and a spreading within a band.

    Parameters
    ----------
    band : str
        Waves of the sum.
    omega_min, omega_max : float, optional
        First and last frequency [rad s-1].
    d_omega : float, optional
        Distance of frequencies [rad s-1], for equal spacing.
    d_theta : float, optional
        Distance of directions [rad].
    spacing_law : "log" or "linear", optional
        Bins of a sixteenth of an octave, or of `d_omega`.
    wind_direction_deg : float
        Direction the wind blows to, counter-clockwise from +x [deg].
    jitter : bool
        Draw frequencies uniformly within the bins of equally spaced ones.
    current : (float, float), optional
        Uniform current (U_x, U_y) [m s-1] that carries the waves.
    mss : {"cox-munk", "elfouhaily", "band"}
        Slope variance of the real sea.
    """

    band: Literal["natural", "scaled"] = "natural"
    omega_min: Positive | None = None
    omega_max: Annotated[float | Literal["fading"] | None, PlainValidator(_band_limit)] = None
    d_omega: Positive | None = None
    d_theta: Positive | None = None
    spacing_law: Literal["log", "linear"] | None = None
    spreading: AnySpreading = IttcSpreading()
    wind_direction_deg: Finite = 0.0
    depth: Depth | None = None
    capillary: bool = False
    jitter: bool = False
    current: Current | None = None
    mss: Mss = "cox-munk"

    @classmethod
    def equally_spaced_band(cls, config: Mapping[str, Any]) -> str:
        """Return the equally spaced band for the parameters of a sea."""
        return "scaled"

    if TYPE_CHECKING:

        @property
        def spectrum(self) -> Spectrum:
            """The spectrum S(omega) of the sea."""

    def _default_band(self) -> bands.Band:
        omega_p = self.spectrum.omega_p
        if self.band == "scaled":
            return bands.scaled_band(omega_p)
        natural = bands.natural_band if self.order == 1 else bands.sparse_band
        return natural(omega_p, self.spreading.half_range)

    def _peak_frequency(self) -> float:
        return self.spectrum.omega_p

    @property
    def band_limits(self) -> bands.Band:
        """Frequencies and directions in use: given values and defaults."""
        if isinstance(self.omega_max, str):
            allowed = "a frequency > 0 rad/s before a link is known; see fading.resolve_band"
            raise Refused("omega_max", FADING, allowed)
        given = self.omega_min, self.omega_max, self.d_omega, self.d_theta
        band = bands.Band(
            *(d if g is None else g for g, d in zip(given, self._default_band(), strict=True))
        )
        if not self._log_spaced:
            return band
        edges = band.omega_min, band.omega_min * 2.0 ** (1.0 / bands.PER_OCTAVE)
        return band._replace(d_omega=edges[1] - edges[0])

    @property
    def _log_spaced(self) -> bool:
        if self.spacing_law is None:
            return self.band == "natural" and self.d_omega is None and self.order == 1
        return self.spacing_law == "log"

    @property
    def _drawn(self) -> bool:
        """Whether waves lie at random places of their bins, the same for every seed."""
        return self.band == "natural" or self._log_spaced

    @model_validator(mode="after")
    def _check_band(self) -> Self:
        if self._log_spaced and self.d_omega is not None:
            raise Refused("d_omega", self.d_omega, 'only with spacing_law = "linear"')
        if self._drawn and self.jitter:
            raise Refused("jitter", self.jitter, "only with equally spaced bands; others draw")
        if self.omega_max == FADING:
            if self.mss == "band":
                raise Refused("omega_max", FADING, 'a frequency > 0 rad/s with mss = "band"')
            self.model_copy(update={"omega_max": None})  # checks the rest
            return self
        band = self.band_limits
        if band.omega_min >= band.omega_max:
            raise Refused("omega_min", band.omega_min, f"< omega_max = {band.omega_max:g} rad/s")
        if self.jitter and band.d_omega > 2.0 * band.omega_min:
            allowed = f"<= 2 omega_min = {2 * band.omega_min:g} rad/s with jitter"
            raise Refused("d_omega", band.d_omega, allowed)
        directions = len(direction_grid(self.spreading.half_range, band.d_theta))
        bins = (
            bands.bin_count(band, self._log_spaced) if self._drawn else bands.frequency_count(band)
        )
        if bins * directions > self.most_components:
            allowed = f"a band of at most {self.most_components} waves, not {bins * directions}"
            raise Refused("d_omega", band.d_omega, allowed)
        return self

    @cached_property
    def free_waves(self) -> WaveComponents:
        """The waves of first order, direction by direction at each frequency."""
        rng = np.random.default_rng(self.seed)
        if self.jitter:
            band = self.band_limits
            directions = len(direction_grid(self.spreading.half_range, band.d_theta))
            phase, offsets = rng.random((2, bands.frequency_count(band), directions))
            return self._waves(offsets - 0.5)._replace(phase=2.0 * math.pi * phase.ravel())
        if "waves" not in self._common:
            self._common["waves"] = self._waves()
        waves: WaveComponents = self._common["waves"]
        return waves._replace(phase=2.0 * math.pi * rng.random(len(waves.omega)))

    def _waves(self, offsets: Floats | None = None) -> WaveComponents:
        """Return the waves with the phase 0; with `jitter` their frequencies are displaced."""
        band = self.band_limits
        if self._drawn:
            edges = bands.frequency_edges(band, self._log_spaced)
            waves = bands.drawn_waves(edges, band.d_theta, self.spectrum, self.spreading)
        else:
            waves = bands.lattice(band, self.spectrum, self.spreading, offsets)
        k = wavenumber(waves.omega, self._water_depth(), self.capillary)
        heading = waves.theta + math.radians(self.wind_direction_deg)
        amplitude, still = np.sqrt(2.0 * waves.variance), np.zeros_like(heading)
        return flat_components(amplitude, waves.omega, k, heading, still, self.current)

    def slope_spectrum(self, omega_max: float | None = None) -> SlopeSpectrum:
        """Return the slopes of all waves of the spectrum, or of those up to a frequency [rad/s]."""
        depth = self._water_depth()
        return SlopeSpectrum.of(self.spectrum, self.spreading, omega_max, depth, self.capillary)

    @property
    def slope_variance(self) -> Variances | None:
        """Slope variances along and across the wind of the real sea, by `mss`."""
        fetch = getattr(self.spectrum, "fetch", None)
        return real_slope_variance(self.mss, self.spectrum.wind_speed, fetch)

    @property
    def short_waves(self) -> _BandedSea:
        """The sea, or that of Elfouhaily's spectrum if its own has an omega^-5 tail.

        Such a tail, fitted up to some 3 omega_p, is no model of short waves: its slope variance
        grows without limit. Wind, fetch, depth, current, seed and nonlinearity are kept.
        """
        if not isinstance(self.spectrum, Jonswap | PiersonMoskowitz | Tma):
            return self
        fetch = getattr(self.spectrum, "fetch", None)
        return SpectralSea(
            spectrum=Elfouhaily(wind_speed=self.spectrum.wind_speed, fetch=fetch),
            spreading=ElfouhailySpreading(),
            mss="elfouhaily",
            depth=self._water_depth(),
            **{name: getattr(self, name) for name in _KEPT},
        )

    @property
    def for_fading(self) -> _BandedSea:
        """The sea with `omega_max="fading"` if its band was left open, or else the sea itself.

        A band is open without limits, spacing and kind of its own, and with waves beyond it
        (`mss`). A spectrum with an omega^-5 tail gives way to `short_waves` if it is that of a
        wind and a fetch; with a height, a peak or a spreading of its own it stays. Elfouhaily's
        takes its own slopes and, for the default spreading, its own directions.
        """
        chosen = self.omega_min, self.d_omega, self.spacing_law
        if self.omega_max not in (None, FADING) or chosen != (None, None, None):
            return self
        if self.band != "natural" or self.mss == "band":
            return self
        standard = self.spreading == IttcSpreading()
        if isinstance(self.spectrum, Elfouhaily) and self.omega_max is None:
            # no band follows the slopes of another law
            spreading = ElfouhailySpreading() if standard else self.spreading
            changes = {"omega_max": FADING, "spreading": spreading, "mss": "elfouhaily"}
            return self.model_copy(update=changes)
        if not isinstance(self.spectrum, Jonswap | PiersonMoskowitz):
            return self.model_copy(update={"omega_max": FADING})
        of_wind = {"wind_speed": self.spectrum.wind_speed}
        if isinstance(self.spectrum, Jonswap):
            of_wind["fetch"] = self.spectrum.fetch
        law = type(self.spectrum)
        if law is Tma or not standard or self.spectrum != law(**of_wind):
            return self
        return self.short_waves.model_copy(update={"omega_max": FADING})

    def slopes_beyond(self, omega_max: float) -> Variances:
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
    band : {"natural", "paper", "scaled"}
        Waves of the sum. "natural": 0.6 to 2.1 omega_p in bins of a sixteenth of an octave and
        36 directions, with one wave at a random place of each cell (`bands.drawn_waves`); fewer
        cells with `order` 2 (`bands.sparse_band`). "paper": the paper's table, for 5 and 13 m/s,
        equally spaced. "scaled": `bands.scaled_band`, equally spaced.
    omega_min, omega_max : float, optional
        First and last frequency [rad s-1]; each replaces its value of the band. omega_max
        "fading" is the band with the fading of all waves: `simulate` and the studies
        replace it by the number for their link, see `fading.resolve_band`.
    d_omega : float, optional
        Distance of frequencies [rad s-1], for equal spacing.
    d_theta : float, optional
        Distance of directions [rad]; replaces its value of the band.
    spacing_law : "log" or "linear", optional
        Bins of a sixteenth of an octave, or of `d_omega`. By default the law of the band, and
        "linear" with `d_omega`.
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
        For "paper" and "scaled": draw every wave's frequency uniformly within its bin, for
        each seed. Equally spaced frequencies make the sea repeat after 2 pi / d_omega (31 s in
        the paper's band at 5 m/s). The natural band never repeats.
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
        Slope variance of the real sea: measured, or of a spectrum down to the capillaries. Its
        part beyond the mesh tilts normals at random (`Physics.unresolved`). "band": no waves
        beyond the band.

    Raises
    ------
    Refused
        If a parameter is out of range, or band="paper" at another wind speed.

    Notes
    -----
    The variance of each bin of the natural band is that of the spectrum. All bands end at about
    2.1 omega_p unless given: they hold 96 % of the variance of the elevation, but at 5 and
    13 m/s only 22 % and 14 % of the mean square slope of Cox and Munk (1954). The waves beyond
    tilt the surface at random (`mss`): the mean gain is that of the whole sea, but tilts blur
    light and add no fading, which needs `omega_max="fading"`.

    With `jitter` the amplitudes follow S at the drawn frequency, so variances hold on
    average over seeds rather than for each.

    References
    ----------
    Hasselmann et al. (1973), Dtsch. Hydrogr. Z. A8(12).

    Examples
    --------
    >>> sea = JonswapSea(wind_speed=13.0, fetch=30e3, seed=7)
    >>> round(sea.band_limits.omega_max, 2), len(sea.components.amplitude)
    (2.97, 1073)
    >>> JonswapSea(wind_speed=13.0, band="paper").band_limits.omega_max
    3.0
    >>> sea.mesh(extent=2.0, spacing=0.5).vertices.shape
    (81, 3)
    """

    kind: Literal["jonswap"] = "jonswap"
    wind_speed: WindSpeed = 5.0
    fetch: Fetch = bands.PAPER_FETCH
    gamma: Gamma = 3.3
    alpha_coefficient: Alpha = ALPHA_COEFFICIENT
    hs: Positive | None = None
    tp: Positive | None = None
    band: Literal["natural", "paper", "scaled"] = "natural"  # type: ignore[assignment]

    @classmethod
    def equally_spaced_band(cls, config: Mapping[str, Any]) -> str:
        """Return "paper" for the sea states of the paper, or else "scaled"."""
        return bands.paper_band(
            config.get("wind_speed", 5.0), config.get("fetch", bands.PAPER_FETCH)
        )

    @cached_property
    def spectrum(self) -> Jonswap:
        """The JONSWAP spectrum of this sea."""
        shared = Jonswap.model_fields.keys() & JonswapSea.model_fields.keys() - {"kind"}
        return Jonswap(**self.model_dump(include=shared))

    def _default_band(self) -> bands.Band:
        if self.band != "paper":
            return super()._default_band()
        tabulated = bands.PAPER_BANDS.get(self.wind_speed)
        if tabulated is None:
            raise Refused("band", "paper", "at 5 and 13 m/s only; 'scaled' takes any wind")
        return tabulated


class SpectralSea(_BandedSea, frozen=True):
    """Random sea with any of the spectra of `meshtrace.surfaces.spectra`.

    Parameters
    ----------
    spectrum : Spectrum
        `Jonswap`, `Tma`, `PiersonMoskowitz`, `Elfouhaily` or a user-defined `Spectrum`, as an
        object or as plain data.
    spreading : Spreading
        `IttcSpreading`, `Cos2sSpreading`, `MitsuyasuSpreading`, `ElfouhailySpreading` or a
        user-defined `Spreading`.
    band, seed, omega_min, omega_max, d_omega, d_theta, spacing_law, wind_direction_deg, jitter,
    current, mss
        See `JonswapSea`, without the band "paper".
    choppy, order, order_omega_max
        See `RandomSea`.
    depth : float, optional
        Water depth [m]; None is the depth of the spectrum (`Tma`), or else deep water.
    capillary : bool
        Surface tension in the dispersion, on by default.

    Raises
    ------
    Refused
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

    def _water_depth(self) -> float | None:
        return getattr(self.spectrum, "depth", self.depth)
