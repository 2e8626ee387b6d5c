"""Random seas: waves whose amplitudes follow a spectrum, sums of seas, and seas from data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny, model_validator

from meshtrace.checks import check_call
from meshtrace.errors import MISSING, Described, Refused
from meshtrace.mesh import Cumulants
from meshtrace.models import FamilyField, InheritedFamilyField, NonNegative, converted

from .bands import PAPER_FETCH, Band, OwnWaves, direction_grid, drawn_places, named_band
from .gram_charlier import SlopeLaw, require_random
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
from .sequence import MeshSequence
from .spectra import ALPHA_COEFFICIENT, Elfouhaily, Jonswap, PiersonMoskowitz, Spectrum, Tma
from .spreadings import ElfouhailySpreading, IttcSpreading, Spreading
from .statistics import SlopeSpectrum, unresolved_slope_variance
from .surface import FlatSea, Surface
from .waves import WaveComponents, flat_components, wavenumber, wavenumber_in_current

# Largest width of a cell of drawn waves [rad]. Tuned: narrower cells make more crossing waves, so
# that the sea repeats less, and cost more of them.
_WIDEST_CELL = math.radians(5.0)


# Fields that `short_waves` takes over from the sea that it replaces.
_TAKEN = "wind_direction_deg", "current", "seed", "choppy", "order", "order_omega_max", "slope_law"


class _BandedSea(RandomSea, frozen=True):
    """Random sea whose waves sample a spectrum and a spreading.

    Parameters
    ----------
    omega_max : float, optional
        Highest frequency of the waves of the sum [rad s-1].
    waves : str or Band, optional
        Waves of the sum.
    spreading : Spreading
        Distribution of the energy over directions from the wind.
    wind_direction_deg : float
        Direction the wind blows to, counter-clockwise from +x [deg].
    depth : float, optional
        Water depth in the dispersion [m]; None is deep water.
    capillary : bool
        Surface tension in the dispersion.
    current : (float, float), optional
        Uniform current (U_x, U_y) [m s-1] that carries the waves.
    mss : {"cox-munk", "elfouhaily", "band"}
        Slope variance of the real sea.
    slope_law : str or GramCharlier
        Density of the random slopes.
    """

    omega_max: Positive | None = None
    waves: OwnWaves = None  # the band "mean" of `named_band`
    spreading: InheritedFamilyField[Spreading] = converted(default=IttcSpreading())
    wind_direction_deg: Finite = 0.0
    depth: Depth | None = None
    capillary: bool = False
    current: Current | None = None
    mss: Mss = "cox-munk"  # "band": no waves beyond those of the sum
    slope_law: SlopeLaw = "gaussian"

    # for type checkers only: `spectrum` is a property of some subclasses and a field of others
    if TYPE_CHECKING:

        @property
        def spectrum(self) -> Spectrum:
            """The spectrum S(omega) of the sea."""

    def _peak_frequency(self) -> float:
        return self.spectrum.omega_p

    @cached_property
    def band(self) -> Band:
        """Band of the waves of the sum: `waves`, cut at `omega_max`."""
        band = self.waves or "mean"
        if isinstance(band, str):
            band = named_band(band, self.spectrum, self.spreading.half_range, self.order)
        return band if self.omega_max is None else band.replace(omega_max=self.omega_max)

    @model_validator(mode="after")
    def _check_band(self) -> Self:
        directions = len(direction_grid(self.spreading.half_range, self.band.d_theta))
        if self.band.bins * directions > self.most_components:
            count = Described(f"{self.band.bins * directions} waves")
            raise Refused("waves", count, f"a band of at most {self.most_components}")
        require_random(self.slope_law, self.mss)
        return self

    @cached_property
    def free_waves(self) -> WaveComponents:
        """The waves of first order, with the directions of a frequency next to each other."""
        # the seeds of a sea differ in the phases only
        if "waves" not in self._seedless:
            variance, omega, theta = self.band.waves(self.spectrum, self.spreading)
            k = wavenumber(omega, self._water_depth(), self.capillary)
            heading = theta + math.radians(self.wind_direction_deg)
            # a wave a cos(phi) has the variance a^2 / 2
            amplitude, no_phase = np.sqrt(2.0 * variance), np.zeros_like(heading)
            self._seedless["waves"] = flat_components(
                amplitude, omega, k, heading, no_phase, self.current
            )
        waves: WaveComponents = self._seedless["waves"]
        # flat, with directions fastest: the numbers of random((n_omega, n_theta))
        phase = np.random.default_rng(self.seed).random(len(waves.omega))
        return waves._replace(phase=2.0 * math.pi * phase)

    def slope_spectrum(self, omega_max: float | None = None) -> SlopeSpectrum:
        """Return the slopes of all waves of the spectrum, or of waves up to a frequency [rad/s]."""
        depth = self._water_depth()
        return SlopeSpectrum.from_spectrum(
            self.spectrum, self.spreading, omega_max, depth, self.capillary
        )

    @property
    def _wind(self) -> tuple[float, float | None]:
        return self.spectrum.wind_speed, getattr(self.spectrum, "fetch", None)

    @property
    def short_waves(self) -> _BandedSea:
        """The sea, with an omega^-5 spectrum replaced by Elfouhaily's.

        Such a tail, fitted up to some 3 omega_p, is no model of short waves: its slope variance
        grows without limit. Wind, fetch, depth, current, seed and nonlinearity are kept.
        """
        if not isinstance(self.spectrum, Jonswap | PiersonMoskowitz):
            return self
        fields = {name: getattr(self, name) for name in _TAKEN} | {"depth": self._water_depth()}
        return resolved_sea(*self._wind).model_copy(update=fields)

    @property
    def for_fading(self) -> _BandedSea | None:
        """The sea with the short waves that cause fading; None to keep this sea.

        It stays if its waves are chosen, by `omega_max`, by `waves`, or by `mss` = "band" (no waves
        beyond them). A spectrum with an omega^-5 tail gives way to `short_waves` if wind and fetch
        alone set it; with a height, a peak, a finite depth (`Tma`) or a spreading that was chosen,
        it stays. That of Elfouhaily takes the slopes of its law and, in place of the default
        spreading, the directions of its law. Any other spectrum is returned unchanged.
        """
        if (self.omega_max, self.waves) != (None, None) or self.mss == "band":
            return None
        # the default spreading was not chosen, so that it may give way
        standard = self.spreading == IttcSpreading()
        if isinstance(self.spectrum, Elfouhaily):
            # waves of a band have slopes of their spectrum: its law alone tells what they leave out
            spreading = ElfouhailySpreading() if standard else self.spreading
            return self.model_copy(update={"spreading": spreading, "mss": "elfouhaily"})
        if not isinstance(self.spectrum, Jonswap | PiersonMoskowitz):
            return self
        wind_and_fetch = self.spectrum.model_dump(include={"wind_speed", "fetch"})
        model = type(self.spectrum)
        # heights, peaks, depths and spreadings that were chosen say more than the wind does
        if model is Tma or not standard or self.spectrum != model.model_validate(wind_and_fetch):
            return None
        return self.short_waves

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
        Seed of the random phases.
    omega_max : float, optional
        Cut of the spectrum: highest frequency of the waves of the sum [rad s-1]; the slopes of
        shorter waves are random (`mss`). By default that of `waves`.
    waves : {"mean", "paper", "scaled"} or Band, optional
        Waves of the sum where the mesh of a study does not choose them (`Meshing.waves`); see
        `bands.named_band`. "mean", the default: 0.6 to 2.1 omega_p in bins of a sixteenth of an
        octave and 36 directions, with one wave at a random place of each cell. "paper": the
        paper's table, for 5 and 13 m/s, equally spaced. "scaled": like it, for any wind.
    spreading : Spreading
        Directional spreading; or a kind such as "ittc" or "cos2s".
    wind_direction_deg : float
        Direction the wind blows to, counter-clockwise from +x [deg].
    depth : float, optional
        Water depth [m] in the dispersion; None is deep water. The spectrum keeps its deep-water
        form: for the finite-depth one see `SpectralSea` with `Tma`.
    capillary : bool
        Add the surface tension to the dispersion, for bands beyond some 30 rad/s.
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
    slope_law : {"gaussian", "cox-munk", "breon-henriot"} or GramCharlier
        Density of the random slopes: Gaussian, or with the skewness and peakedness that were
        measured; see Notes.

    Raises
    ------
    Refused
        If a parameter is out of range, waves="paper" at another wind speed, or a `slope_law`
        without random slopes.

    Notes
    -----
    A sum has a finite number of waves, of which every one carries the variance of its bin of the
    spectrum. All named bands end at about 2.1 omega_p: they hold 96 % of the variance of the
    elevation, but at 5 and 13 m/s only 22 % and 14 % of the mean square slope of Cox and Munk
    (1954). The waves beyond tilt the surface at random (`mss`): the mean gain is that of the whole
    sea, but tilts blur light and add no fading. Studies of fading, and `Meshing(waves="fading")`,
    choose the shorter waves that fading needs for their link.

    Skewness and peakedness belong to all slopes. The waves of a sum have Gaussian slopes, whose
    third and fourth cumulants are 0, so that the random ones have those of the whole sea: over
    their own deviations, which are smaller, the coefficients of `slope_law` are larger. Meshes
    that leave too few slopes to chance for that are refused. The axis is `wind_direction_deg`, also
    for waves that come from both sides.

    References
    ----------
    Hasselmann et al. (1973), Dtsch. Hydrogr. Z. A8(12).

    Examples
    --------
    >>> sea = JonswapSea(wind_speed=13.0, fetch=30e3, seed=7)
    >>> round(sea.band.omega_max, 2), len(sea.components.amplitude)
    (2.97, 1073)
    >>> JonswapSea(wind_speed=13.0, waves="paper").band.omega_max
    3.0
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

    @cached_property
    def spectrum(self) -> Jonswap:
        """The JONSWAP spectrum of this sea."""
        shared = Jonswap.model_fields.keys() & JonswapSea.model_fields.keys() - {"kind"}
        return Jonswap.model_validate(self.model_dump(include=shared))


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
    seed, omega_max, waves, wind_direction_deg, current, mss, slope_law
        See `JonswapSea`.
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
    spectrum: FamilyField[Spectrum]
    capillary: bool = True

    @model_validator(mode="after")
    def _check_depth(self) -> Self:
        water_depth = getattr(self.spectrum, "depth", None)
        if None not in (water_depth, self.depth) and water_depth != self.depth:
            raise Refused("depth", self.depth, f"{water_depth:g} m, the depth of the spectrum")
        return self

    def _water_depth(self) -> float | None:
        return getattr(self.spectrum, "depth", self.depth)


class MeasuredSea(RandomSea, frozen=True):
    """Random sea from a table of variance over frequency and direction.

    Parameters
    ----------
    omega : sequence of float, length m
        Angular frequencies at a fixed point [rad s-1].
    theta : sequence of float, length n
        Directions the waves travel to, counter-clockwise from +x [rad].
    variance : sequence of sequences of float, m by n
        Elevation variance of each bin [m2].
    seed : int
        Seed of the random phases.
    waves : {"table", "drawn"}
        "table" has one wave for each value, a sea of few crossing trains that may repeat. "drawn"
        has one at a random place of each cell: bins meet half-way between their frequencies, and
        directions, which have to go round the circle in equal steps, are split into cells of at
        most 5 degrees, with a density that is linear between them. The variance of each bin is
        kept.
    depth : float, optional
        Water depth [m]; None is deep water.
    capillary : bool
        Surface tension in the dispersion.
    current : (float, float), optional
        Uniform current [m s-1]. The table holds frequencies at a fixed point, so that the current
        changes wavenumbers: sigma(k) + k.U = omega.
    choppy, order, order_omega_max
        Nonlinear seas, see `RandomSea`.
    mss : {"cox-munk", "elfouhaily", "band"}
        Slope variance of the real sea, see `JonswapSea`; "band", the default, has no waves beyond
        the table.
    slope_law : {"gaussian", "cox-munk", "breon-henriot"} or GramCharlier
        Density of the random slopes, see `JonswapSea`.
    wind_speed : float, optional
        Wind speed at 10 m [m s-1] of `mss` and `slope_law`.
    wind_direction_deg : float
        Direction the wind blows to, counter-clockwise from +x [deg], for `mss`.
    record : str, optional
        Origin of the table, such as station and time. Phases belong to t = 0 of the sea.

    Raises
    ------
    Refused
        If a parameter is out of range, the table has not m by n values, or a current stops a wave.

    Examples
    --------
    >>> sea = MeasuredSea(omega=[1.0, 2.0], theta=[0.0], variance=[[0.02], [0.005]])
    >>> sea.components.amplitude.round(12)
    array([0.2, 0.1])
    """

    kind: Literal["measured"] = "measured"
    omega: tuple[Positive, ...] = Field(min_length=1)
    theta: tuple[Finite, ...] = Field(min_length=1)
    variance: tuple[tuple[NonNegative, ...], ...]
    waves: Literal["table", "drawn"] = "table"
    depth: Depth | None = None
    capillary: bool = True
    current: Current | None = None
    mss: Mss = "band"
    slope_law: SlopeLaw = "gaussian"
    wind_speed: WindSpeed | None = None
    wind_direction_deg: Finite = 0.0
    record: str | None = None

    @model_validator(mode="after")
    def _check_table(self) -> Self:
        lengths = sorted({len(row) for row in self.variance})
        if len(self.variance) != len(self.omega) or lengths != [len(self.theta)]:
            shape = f"{len(self.variance)} rows of {lengths} values"
            allowed = f"{len(self.omega)} rows (omega) of {len(self.theta)} (theta)"
            raise Refused("variance", shape, allowed)
        if self.mss != "band" and self.wind_speed is None:
            raise Refused("wind_speed", None, f'a wind speed for mss = "{self.mss}"')
        require_random(self.slope_law, self.mss)
        if self.waves == "drawn":
            if len(self.omega) < 2 or (np.diff(self.omega) <= 0.0).any():
                raise Refused("waves", "drawn", "with two or more increasing frequencies only")
            # n - 1 steps of 2 pi / n leave the same step from the last direction to the first
            steps = np.diff(np.sort(np.mod(self.theta, 2.0 * math.pi)))
            if len(self.theta) < 3 or not np.allclose(steps, 2.0 * math.pi / len(self.theta)):
                allowed = "only with three or more directions in equal steps round the circle"
                raise Refused("waves", "drawn", allowed)
        if self.current is not None:
            _ = self.free_waves  # refuses a current that stops a wave
        return self

    @property
    def _wind(self) -> tuple[float, float | None]:
        # without a wind speed mss is "band" (`_check_table`), and nothing reads the default
        return self.wind_speed or 5.0, None

    @cached_property
    def free_waves(self) -> WaveComponents:
        """The waves of first order, direction by direction at each frequency."""
        omega, theta, variance = (np.array(a) for a in (self.omega, self.theta, self.variance))
        if self.waves == "drawn":
            low, width, variance = _cells(theta, variance)
            omega, theta = drawn_places(bin_edges(omega), low, width)
        else:
            omega = np.broadcast_to(omega[:, None], variance.shape)
        phase = 2.0 * math.pi * np.random.default_rng(self.seed).random(variance.shape)
        k = wavenumber_in_current(omega, theta, self.current, self.depth, self.capillary)
        return flat_components(np.sqrt(2.0 * variance), omega, k, theta, phase)


def _cells(theta: Floats, variance: Floats) -> tuple[Floats, float, Floats]:
    """Split the bins of a table over direction into cells of at most `_WIDEST_CELL`.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        Directions in equal steps round the circle, in any order [rad].
    variance : ndarray, shape (m, n)
        Elevation variance of each bin over frequency and direction [m2].

    Returns
    -------
    low : ndarray, shape (n parts,)
        Lowest direction of each cell [rad].
    width : float
        Width of a cell [rad].
    fine : ndarray, shape (m, n parts)
        Elevation variance of each cell [m2].
    """
    width = 2.0 * math.pi / len(theta)
    order = np.argsort(np.mod(theta, 2.0 * math.pi))
    theta, variance = np.mod(theta, 2.0 * math.pi)[order], variance[:, order]
    # the tolerance leaves a width of 5 degrees in one part whatever the last bit of the quotient
    parts = math.ceil(width / _WIDEST_CELL - 1e-9)
    # middles of the parts, from the middle of the bin, over its width: -1/2 to 1/2
    offset = (np.arange(parts) + 0.5) / parts - 0.5
    # linear between the middles of a bin and of its neighbour: before it [0], or after it [1]
    neighbours = np.stack([np.roll(variance, 1, axis=1), np.roll(variance, -1, axis=1)])
    towards = neighbours[(offset > 0.0).astype(int)]  # (parts, m, n)
    share = np.abs(offset)[:, None, None]
    fine = np.moveaxis((1.0 - share) * variance + share * towards, 0, -1)
    total = fine.sum(axis=-1, keepdims=True)
    # the slope to both sides changes the sum of the parts: scale it back to that of the bin
    fine *= np.divide(variance[..., None], total, out=np.zeros_like(total), where=total > 0)
    low = theta[:, None] + width * (offset - 0.5 / parts)
    return low.ravel(), width / parts, fine.reshape(len(variance), -1)


def bin_edges(omega: Floats) -> Floats:
    """Return the edges [rad s-1] of n frequency bins: the midpoints, and one beyond either end.

    Shape (n + 1,). The first bin does not go below half of its frequency, so that it stays > 0.
    """
    middle = 0.5 * (omega[1:] + omega[:-1])
    first = max(1.5 * omega[0] - 0.5 * omega[1], 0.5 * omega[0])
    return np.concatenate([[first], middle, [1.5 * omega[-1] - 0.5 * omega[-2]]])


def _part(value: Any) -> RandomSea:
    """Read a part of a `SumSea`; refuse a nonlinear one."""
    sea = Surface.read(value)
    if not isinstance(sea, RandomSea):
        raise Refused("parts", getattr(sea, "kind", value), "random seas only")
    if sea.choppy or sea.order != 1:
        raise Refused("parts", sea.kind, "choppy and order of the sum, not of its parts")
    return sea


class SumSea(RandomSea, frozen=True):
    """Sum of independent random seas.

    z = sum_i z_i, with the phases of part i from the seed `SeedSequence([seed, i])`

    Parameters
    ----------
    parts : sequence of RandomSea
        Seas, or their plain data; their own seeds do not matter.
    seed : int
        Seed of all phases.
    choppy, order, order_omega_max
        Nonlinear seas, see `RandomSea`: the waves of all parts interact.

    Raises
    ------
    Refused
        If a part is no random sea, or choppy or of second order itself.

    Notes
    -----
    Slopes add. Those beyond the mesh are of the part with the largest slope variance of the real
    sea, in the direction of its wind; the slopes of all parts count as resolved.

    Examples
    --------
    >>> from meshtrace.surfaces import JonswapSea, Jonswap, SpectralSea
    >>> swell = SpectralSea(spectrum=Jonswap(hs=1.0, tp=12.0, gamma=6.0), mss="band")
    >>> sea = SumSea(parts=[JonswapSea(wind_speed=5.0), swell], seed=3)
    >>> len(sea.components.omega) == sum(len(part.components.omega) for part in sea.parts)
    True
    """

    kind: Literal["sum"] = "sum"
    parts: Annotated[
        tuple[Annotated[SerializeAsAny[RandomSea], BeforeValidator(_part)], ...],
        Field(min_length=1),
    ]

    @property
    def windiest(self) -> RandomSea:
        """The part with the largest slope variance of the real sea."""
        # variances of real seas do not add up: each holds all short waves of its wind
        return max(self.parts, key=lambda part: sum(part.slope_variance or (0.0, 0.0)))

    @property
    def slope_variance(self) -> Variances | None:
        """Slope variances along and across the wind of the part with the largest ones."""
        return self.windiest.slope_variance

    @property
    def slope_cumulants(self) -> Cumulants:
        """Third and fourth cumulants of the slopes of the part with the largest variances."""
        return self.windiest.slope_cumulants

    @property
    def _slopes_along_deg(self) -> float:
        return self.windiest._slopes_along_deg

    def _water_depth(self) -> float | None:
        # the shallowest: any finite depth rules out order 2, and a choppy sheet takes one for all
        depths = [part._water_depth() for part in self.parts]
        return min((depth for depth in depths if depth is not None), default=None)

    @cached_property
    def free_waves(self) -> WaveComponents:
        """The waves of first order of all parts."""
        # independent phases for every part, for equal parts as well
        seeds = (np.random.SeedSequence([self.seed, i]) for i in range(len(self.parts)))
        waves = [
            part.with_seed(int(seed.generate_state(1)[0])).free_waves
            for part, seed in zip(self.parts, seeds, strict=True)
        ]
        return WaveComponents(*(np.concatenate(parts) for parts in zip(*waves, strict=True)))


@check_call
def sea_from_config(config: Mapping[str, Any]) -> Surface | MeshSequence:
    """Return a sea from the plain data of `to_config`.

    Parameters
    ----------
    config : mapping
        Plain data with the key "kind" (or an import path "module:Class" under it) and the
        parameters of that kind.

    Returns
    -------
    Surface or MeshSequence
        An equal sea, with bitwise the same meshes.

    Raises
    ------
    Refused
        If the kind is unknown or a parameter is out of range.

    Examples
    --------
    >>> sea_from_config({"kind": "flat", "height": 0.1})
    FlatSea(height=0.1)
    """
    if not isinstance(config, Mapping) or "kind" not in config:
        raise Refused("kind", MISSING, ", ".join(Surface.registered))
    if config["kind"] == "meshes":
        return MeshSequence.model_validate(config)
    return Surface.read(config)


@check_call
def resolved_sea(wind_speed: float, fetch: float | None = None, seed: int = 0) -> SpectralSea:
    """Return the sea of a wind with a spectrum of the short waves that cause fading.

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1], 0 < U <= 60.
    fetch : float, optional
        Fetch [m]; None is the fully developed sea.
    seed : int
        Seed of the random phases.

    Returns
    -------
    SpectralSea
        Spectrum, spreading and mss of Elfouhaily et al., a model of short waves, too. Studies of
        fading, and `Meshing(waves="fading")`, resolve them to some 13 to 32 rad/s.

    Raises
    ------
    Refused
        If an argument is out of range.

    Examples
    --------
    >>> resolved_sea(5.0, fetch=30e3).mss
    'elfouhaily'
    """
    return SpectralSea(
        spectrum=Elfouhaily(wind_speed=wind_speed, fetch=fetch),
        spreading=ElfouhailySpreading(),
        mss="elfouhaily",
        seed=seed,
    )


@check_call
def sea_in_wind(wind_speed: Annotated[float, Field(ge=0.0, le=60.0)], seed: int = 0) -> Surface:
    """Return the default sea of a wind: a JONSWAP sea, or a flat one without wind.

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1], 0 to 60.
    seed : int
        Seed of the random phases.

    Raises
    ------
    Refused
        If an argument is out of range.

    Examples
    --------
    >>> sea_in_wind(0.0), sea_in_wind(8.0) == JonswapSea(wind_speed=8.0)
    (FlatSea(), True)
    """
    if wind_speed == 0.0:
        return FlatSea()
    return JonswapSea(wind_speed=wind_speed, seed=seed)
