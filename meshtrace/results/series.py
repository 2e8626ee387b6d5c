"""Gains of one link over many surfaces, places or wavelengths."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations
from statistics import NormalDist
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Generic,
    Literal,
    NamedTuple,
    ParamSpec,
    Protocol,
    TypeVar,
    cast,
    overload,
)

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import Described, Refused, require_finite, require_whole
from meshtrace.models import Floats
from meshtrace.results.gain import PER_LAMP, PER_PIXEL, GainResult
from meshtrace.results.provenance import water_of
from meshtrace.stored import Stacked, Stored, Variable

if TYPE_CHECKING:
    import xarray as xr

    from meshtrace.fading import FadingStatistics

_MOST_LISTED = 50  # gains that a summary lists where there are too few for statistics: tuned
_MOST_PAIRS = 10  # pairs of channels that a summary lists: tuned
_NOISE_REPORTED = 0.05  # share of the variance from which noise gets a note: tuned
_PER_STEP = Variable("step", "receiver")
_BY_LAMP = Variable("step", *PER_LAMP.dims)


class CorrelatedPair(NamedTuple):
    """Correlation of the fading of two channels, its standard error, and their distance [m].

    Channels are receivers, or pairs of lamp and receiver, whose distance is nan.
    """

    first: str
    second: str
    correlation: float
    stderr: float
    distance: float


@dataclass(frozen=True, eq=False, repr=False)
class GainSeries(Stored, kind="series", title="meshtrace gain series"):
    """Gains of one link over many surfaces, all with the same chains.

    Attributes
    ----------
    along : {"time", "realization"}
        What distinguishes the surfaces: the time, or the random phases of their waves.
    coordinate : ndarray, shape (n,)
        Times [s], or seeds of the realizations.
    gain, gain_stderr, gain_ballistic : ndarray, shape (n,) or (n, receivers)
        Gain, its standard error and its unscattered part.
    mean_stderr : float or ndarray, shape (receivers,)
        Monte Carlo standard error of the mean gain. All surfaces share their chains: it does not
        fall as it would for n independent gains.
    provenance : dict
        Versions, configuration and seeds.
    gain_by_lamp, gain_by_lamp_stderr : ndarray, shape (n, transmitters, receivers), or None
        Gain by lamp and receiver over the power of all lamps, and its standard error.
    gain_by_lamp_groups : ndarray, shape (transmitters, receivers, 32), or None
        Means of the same by independent group of samples, see `GainResult`.
    gain_by_pixel, gain_by_pixel_stderr : ndarray, shape (n, receivers, pixels, pixels), or None
        Gain of each pixel, and its standard error without that of the quadrature of unscattered
        light, see `GainResult`.
    """

    along: Literal["time", "realization"]
    coordinate: Annotated[NDArray[Any], Variable("step", name="step")]
    gain: Annotated[Floats, _PER_STEP]
    gain_stderr: Annotated[Floats, _PER_STEP]
    gain_ballistic: Annotated[Floats, _PER_STEP]
    mean_stderr: Any
    provenance: dict[str, Any] = field(default_factory=dict)
    gain_by_lamp: Annotated[Floats | None, _BY_LAMP] = None
    gain_by_lamp_stderr: Annotated[Floats | None, _BY_LAMP] = None
    gain_by_lamp_groups: Annotated[Floats | None, Variable(*PER_LAMP.dims, "group")] = None
    gain_by_pixel: Annotated[Floats | None, Variable("step", *PER_PIXEL.dims)] = None
    gain_by_pixel_stderr: Annotated[Floats | None, Variable("step", *PER_PIXEL.dims)] = None

    _step_name: ClassVar[str] = "along"

    @property
    def gains(self) -> Floats:
        """Gains as an array, shape (n, receivers) also for a single receiver."""
        return self.gain.reshape(len(self.coordinate), -1)

    @property
    def best_pixel(self) -> NDArray[np.int64]:
        """Pixel (i, j) with the most light over each surface, shape (n, receivers, 2)."""
        if self.gain_by_pixel is None:
            raise Refused("receiver.pixels", 1, "2 or more, for a property of pixels")
        n, receivers, side, _ = self.gain_by_pixel.shape
        best = self.gain_by_pixel.reshape(n, receivers, -1).argmax(axis=-1)
        return np.stack(np.unravel_index(best, (side, side)), axis=-1)

    @property
    def mean_stderrs(self) -> Floats:
        """Standard error of the mean gain of each receiver, shape (receivers,)."""
        return np.atleast_1d(self.mean_stderr)

    @property
    def time(self) -> Floats:
        """Times [s] of a moving sea."""
        if self.along != "time":
            raise Refused("along", self.along, "time, for a property of time series")
        return self.coordinate

    def _channels(self) -> tuple[list[str], Floats]:
        """Return the names and the gains of the channels, as `correlation` defines them."""
        n, receivers = self.gains.shape
        if self.gain_by_lamp is None or self.gain_by_lamp.shape[1] == 1:
            return [f"receiver {r}" for r in range(receivers)], self.gains
        lamps, pairs = self.gain_by_lamp.shape[1], self.gain_by_lamp.reshape(n, -1)
        return [f"lamp {k}, receiver {r}" for k in range(lamps) for r in range(receivers)], pairs

    @property
    def correlation(self) -> Floats:
        """Pearson's correlation of the gains, shape (channels, channels); nan without fading.

        Channels are the receivers or, of several lamps with gains by lamp, the pairs of lamp and
        receiver, lamp after lamp. The Monte Carlo noise of the gains is a part of their fading.
        """
        gains = self._channels()[1]
        with np.errstate(divide="ignore", invalid="ignore"):
            # without fading, as of a single surface, 0 / 0 is nan
            scaled = (gains - gains.mean(axis=0)) / gains.std(axis=0)
            return np.asarray(scaled.T @ scaled / len(scaled))

    @property
    def correlation_stderr(self) -> Floats:
        r"""Standard error of `correlation`, of the same shape.

        .. math:: \sigma_\rho = (1 - \rho^2) / (n_\mathrm{eff} - 1)^{1/2},

        that of Gaussian samples, n_eff of them: the least number of a channel in a time series.
        """
        from meshtrace.fading import effective_samples

        gains, rho, n = self._channels()[1], self.correlation, float(len(self.coordinate))
        if self.along == "time" and np.isfinite(rho).all():
            n = min(effective_samples(of_channel) for of_channel in gains.T)
        return np.asarray((1.0 - rho**2) / np.sqrt(max(n - 1.0, 1.0)))

    def correlated_pairs(self) -> list[CorrelatedPair]:
        """Return the correlation of fading of every pair of channels, see `correlation`."""
        names, rho, stderr = self._channels()[0], self.correlation, self.correlation_stderr
        ends = self.provenance.get("link", {}).get("receiver", [])
        places = [end.get("position") for end in ends] if isinstance(ends, list) else []
        pairs = []
        for i, j in combinations(range(len(names)), 2):
            apart = math.nan
            # two pairs of lamp and receiver have no single distance
            if len(places) == len(names) and None not in (places[i], places[j]):
                apart = math.dist(places[i], places[j])
            value, error = float(rho[i, j]), float(stderr[i, j])
            pairs.append(CorrelatedPair(names[i], names[j], value, error, apart))
        return pairs

    def _correlation_lines(self) -> list[str]:
        """Describe the correlation of fading of each pair of channels in a line."""
        pairs = self.correlated_pairs()
        if not pairs or not np.isfinite(self.correlation).all():
            return []
        lines = ["correlation of the fading"]
        for first, second, value, error, apart in pairs[:_MOST_PAIRS]:
            where = "" if math.isnan(apart) else f", {apart:g} m apart"
            lines.append(f"  {f'{first} and {second}':<42}{value:>7.3f} +- {error:.3f}{where}")
        more = len(pairs) - _MOST_PAIRS
        return lines + [f"  {more} more pairs"] * (more > 0)

    def fading(self, receiver: int = 0, **options: Any) -> FadingStatistics:
        r"""Return the fading statistics of one receiver, see `fading.fading_statistics`.

        .. math:: \sigma_\mathrm{own}^2 = (\overline{s_i^2} - s_{\bar h}^2) \, n / (n - 1)

        is the contribution of the Monte Carlo errors s_i of the n gains to their variance, without
        the error s_hbar of their mean, which shifts all gains alike. It is removed from an
        ensemble. On a moving sea it varies as smoothly as the gain, and the correlation cannot
        separate the two: it stays, and is reported in a note unless negligible.

        Parameters
        ----------
        receiver : int
            Index of the receiver.
        options
            Of `fading.fading_statistics`.

        Raises
        ------
        ValueError
            If there is no such receiver, or fewer than two gains.
        """
        from meshtrace.fading import fading_statistics

        n, n_receivers = self.gains.shape
        require_whole(receiver, 0, n_receivers - 1, "receiver")
        gain, mean_stderr = self.gains[:, receiver], float(self.mean_stderrs[receiver])
        stderr = self.gain_stderr.reshape(n, -1)[:, receiver]
        noise = float(np.mean(stderr**2))
        # sigma_own^2 of the docstring
        own_noise = max(noise - mean_stderr**2, 0.0) * n / max(n - 1, 1)
        if self.along == "realization":
            # scaled so that their mean square is own_noise: `fading_statistics` subtracts it
            options["gain_stderr"] = (np.sqrt(own_noise / noise) if noise > 0.0 else 0.0) * stderr
        else:
            options["time"] = self.time
        statistics = fading_statistics(gain, common_stderr=mean_stderr, **options)
        # of gains without any spread, such as 0 everywhere, the share is 0 or 1, not 0 / 0
        variance = max(float(gain.var(ddof=1)), own_noise, 1e-300)
        notes, share = statistics.notes, own_noise / variance
        if self.along == "time" and share >= _NOISE_REPORTED:
            note = f"Monte Carlo noise is {100.0 * share:.0f} % of the variance: increase photons"
            notes = (*notes, note)
        return replace(statistics, provenance=self.provenance, notes=notes)

    def _headline(self) -> str:
        # a line of a terminal has room for four receivers
        means = self.gains.mean(axis=0)
        pairs = zip(means[:4], self.mean_stderrs, strict=False)
        shown = ", ".join(f"mean {mean:.4e} +- {stderr:.1e}" for mean, stderr in pairs)
        return f"{len(self.coordinate)} gains over {self.along}, {shown}"

    def summary(self) -> str:
        """Return the fading of each receiver, and the quantiles of an ensemble, as text."""
        lines = []
        for receiver, (gain, stderr) in enumerate(
            zip(self.gains.T, self.mean_stderrs, strict=True)
        ):
            if self.gain.ndim == 2:
                lines.append(f"receiver {receiver}")
            if self.along == "realization":
                levels = (1, 5, 25, 50, 75, 95, 99)
                lines.append("".join(f"{f'{level} %':>12}" for level in levels))
                lines.append("".join(f"{value:>12.4e}" for value in np.percentile(gain, levels)))
                lines.append("")
            lines.append(self._statistics(receiver))
            lines += self._origin_lines()
            if gain.any():
                percent = 100.0 * stderr / gain.mean()
                lines.append(f"  Monte Carlo error    {percent:.2g} % of the mean gain")
        return "\n".join(lines + self._correlation_lines())

    def _check(self) -> None:
        # `mean_stderr` is an attribute: the check of `Stored` covers the sizes of variables alone
        stderrs = self.mean_stderrs
        # "biuf": a number, be it a bool, whole or floating point, and no text
        if stderrs.dtype.kind not in "biuf" or stderrs.shape != self.gains.shape[1:]:
            raise ValueError(f"mean_stderr of {stderrs.dtype}, shape {stderrs.shape}")

    def _origin_lines(self) -> list[str]:
        """Return the scintillation index of unscattered light, by the gains and in closed form."""
        # there is a closed form for links with one receiver only
        closed, ballistic = self.provenance.get("closed_form"), self.gain_ballistic
        if not closed or not ballistic.any():
            return []
        measured = ballistic.var(ddof=1) / ballistic.mean() ** 2
        return [
            f"  unscattered light    scintillation index {measured:.3g}, closed form "
            f"{closed['index_of_band']:.3g} up to {closed['omega_max']:.3g} rad/s, "
            f"{closed['index_of_all']:.3g} with all waves"
        ]

    def _statistics(self, receiver: int) -> str:
        """Return the fading of a receiver; the first gains and the reason where there is none."""
        try:
            return self.fading(receiver).summary()
        except ValueError as error:
            lines = []
            if self.along == "time":
                frames = zip(self.time[:_MOST_LISTED], self.gains[:, receiver], strict=False)
                lines = [f"  {t:>12g} s {g:.4e}" for t, g in frames]
            return "\n".join([*lines, f"no fading statistics: {error}"])


LIT = 0.01
"""Share of the highest gain of a map that errors of darker cells are relative to."""


@dataclass(frozen=True, eq=False, repr=False)
class CoverageMap(Stored, kind="coverage", title="meshtrace coverage map"):
    """Map of the gain over places of the receiver in its horizontal plane.

    Attributes
    ----------
    x, y : ndarray, shape (nx,), (ny,)
        Centres of the cells [m].
    gain, gain_stderr : ndarray, shape (nx, ny)
        Gain of the link's receiver if it were there, averaged over the cell, and its standard
        error.
    provenance : dict
        Versions and configuration.
    gain_bound : ndarray, shape (nx, ny), or None
        Upper bound of the gain at 95 % confidence in cells without received light, nan
        elsewhere; None if all cells received light, or if no tolerance `rtol` was asked for.
    """

    x: Annotated[Floats, Variable("x")]
    y: Annotated[Floats, Variable("y")]
    gain: Annotated[Floats, Variable("x", "y")]
    gain_stderr: Annotated[Floats, Variable("x", "y")]
    provenance: dict[str, Any] = field(default_factory=dict)
    gain_bound: Annotated[Floats | None, Variable("x", "y")] = None

    def _headline(self) -> str:
        shape = " x ".join(map(str, self.gain.shape))
        return f"{shape} places, gains up to {self.gain.max():.4e}"

    def summary(self) -> str:
        """Return size, extremes and errors of the map as text for a terminal."""
        header = (
            f"gain at {self.gain.size} places, x {self.x[0]:g} to {self.x[-1]:g} m, "
            f"y {self.y[0]:g} to {self.y[-1]:g} m"
        )
        received = self.gain > 0.0
        if not received.any():
            return f"{header}\n  no light received"
        highest = self.gain == self.gain.max()
        cell = place_of_highest(self.gain, self.gain_stderr)
        place = f"place not resolved: {as_high(self.gain, self.gain_stderr).sum()} within errors"
        if cell is not None:
            place = f"at ({self.x[cell[0]]:g}, {self.y[cell[1]]:g}) m"
        error = np.median(self.gain_stderr[received] / self.gain[received])
        lines = [
            header,
            f"  highest              {self.gain.max():.4e} +- "
            f"{self.gain_stderr[highest].max():.1e} {place}",
            f"  mean                 {self.gain.mean():.4e}",
            f"  dark places          {int((~received).sum())}",
            f"  median error         {100.0 * error:.2g} %",
        ]
        if self.gain_bound is not None:
            lines.append(f"  bound where dark     {np.nanmax(self.gain_bound):.1e}")
        return "\n".join([*lines, *self._origin_lines()])

    def _check(self) -> None:
        # a coverage map has a highest place, and nan has none
        if not (np.isfinite(self.gain).all() and np.isfinite(self.gain_stderr).all()):
            raise ValueError("a gain that is not finite")

    def _origin_lines(self) -> list[str]:
        """Return the water of the link."""
        if "link" not in self.provenance:
            return []
        return [f"  water                {water_of(self.provenance)}"]


def relative_errors(gain: Floats, stderr: Floats) -> Floats:
    """Return the errors of cells relative to their gains, or to 1 % of the highest gain if larger.

    Infinite for a map without received light.
    """
    highest = float(gain.max())
    if highest == 0.0:
        return np.full(gain.shape, np.inf)
    return np.asarray(stderr / np.maximum(gain, LIT * highest))


def as_high(gain: Floats, stderr: Floats) -> NDArray[np.bool_]:
    """Return a mask of the cells (nx, ny) whose gain may equal the highest, within errors.

    Which of many noisy cells is the highest is partly chance. These differ from it by no more than
    the error of the difference, at 95 % confidence for all cells together, as if gains were
    independent.
    """
    # Bonferroni's correction: the probability that any of `size` comparisons errs is at most 5 %
    z = -NormalDist().inv_cdf(0.05 / gain.size)
    best = np.unravel_index(int(gain.argmax()), gain.shape)
    within: NDArray[np.bool_] = gain + z * np.hypot(stderr, stderr[best]) >= gain[best]
    return within


def place_of_highest(gain: Floats, stderr: Floats) -> tuple[int, int] | None:
    """Return the indices of the highest cell of a map (nx, ny), None if noise hides its place.

    The place is resolved if all cells that are `as_high` are the highest one or its neighbours,
    which belong to the same peak.
    """
    best = np.array(np.unravel_index(int(gain.argmax()), gain.shape))
    offsets = np.abs(np.argwhere(as_high(gain, stderr)) - best)  # (cells, 2), in cells
    return (int(best[0]), int(best[1])) if (offsets <= 1).all() else None


Result = TypeVar("Result", bound=Stored)
Options = ParamSpec("Options")


@dataclass(frozen=True, eq=False, repr=False)
class ByWavelength(
    Stacked, Generic[Result], kind="wavelengths", title="meshtrace results by wavelength"
):
    """Results of one link at several wavelengths, from common paths where possible.

    The noise of wavelengths with common paths is correlated: it largely cancels in ratios.

    Attributes
    ----------
    wavelength_nm : ndarray, shape (n,)
        Wavelengths in vacuum [nm], rising.
    results : tuple
        Result at each wavelength, of one kind.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> link = mt.Link(water=mt.Water.from_type("jerlov-II"))
    >>> spectrum = mt.simulate(link, FlatSea(), photons=1024, wavelengths_nm=[450, 500, 550])
    >>> spectrum["gain"].dims, spectrum.brightest
    (('wavelength', 'receiver'), 500.0)
    """

    wavelength_nm: Floats
    results: tuple[Result, ...]

    _along: ClassVar[tuple[str, str]] = ("wavelength", "wavelength_nm")

    def _stack(self) -> tuple[Floats, tuple[Result, ...]]:
        return self.wavelength_nm, self.results

    def at_wavelength(self, wavelength_nm: float) -> Result:
        """Return the result at a wavelength [nm].

        Raises
        ------
        Refused
            If the result has no such wavelength.
        """
        if wavelength_nm not in self.wavelength_nm:
            allowed = ", ".join(f"{nm:g}" for nm in self.wavelength_nm)
            raise Refused("wavelength_nm", wavelength_nm, allowed)
        return dict(self)[wavelength_nm]

    def __iter__(self) -> Iterator[tuple[float, Result]]:
        """Yield wavelengths [nm] and results."""
        return zip(self.wavelength_nm.tolist(), self.results, strict=True)

    def __len__(self) -> int:
        return len(self.results)

    def __getitem__(self, name: str) -> xr.DataArray:
        """Return a variable of the dataset, such as "gain", with the dimension `wavelength`."""
        data = self._content()
        if name not in data:
            raise Refused("name", name, ", ".join(map(str, data.data_vars)))
        return data[name]

    @property
    def brightest(self) -> float:
        """Wavelength of the highest mean gain of the first receiver [nm]."""
        # a series has its surfaces as a further dimension, a map its places: means over these
        gain = self["gain"]
        if "receiver" in gain.dims:
            gain = gain.isel(receiver=0)
        means = gain.mean([name for name in gain.dims if name != "wavelength"])
        return float(self.wavelength_nm[int(means.values.argmax())])

    def _headline(self) -> str:
        low, high = self.wavelength_nm[[0, -1]]
        return f"{len(self)} wavelengths, {low:g} to {high:g} nm, of kind {self.results[0].kind}"

    def summary(self) -> str:
        """Return a line for each wavelength as text for a terminal."""
        first = self.results[0]
        if not isinstance(first, GainResult):
            return "\n".join(f"{nm:>8g} nm  {result._headline()}" for nm, result in self)
        lines = [f"{'nm':>8}{'gain':>13}{'standard error':>16}{'effective samples':>19}  water"]
        for nm, result in self:
            assert isinstance(result, GainResult)
            water = result.provenance.get("link", {}).get("water", {})
            # absorption a and scattering b [m-1], refractive index n
            optics = [f"{key} {water[key]:.4g}" for key in ("a", "b", "n") if key in water]
            for r, (gain, stderr) in enumerate(zip(result.gains, result.stderrs, strict=True)):
                samples = f"{result.scattered[r].effective:,.0f}" if result.scattered else "-"
                # receivers are named where there are several
                remarks = ", ".join([f"receiver {r}"] * (len(result.gains) > 1) + optics)
                lines.append(f"{nm:>8g}{gain:>13.4e}{stderr:>16.1e}{samples:>19}  {remarks}")
        return "\n".join(lines)


class Spectral(Protocol[Options, Result]):
    """Function that returns a result, or `ByWavelength` if it is called with `wavelengths_nm`."""

    @overload
    def __call__(
        self, *args: Any, wavelengths_nm: ArrayLike, **options: Any
    ) -> ByWavelength[Result]: ...

    @overload
    def __call__(self, *args: Options.args, **options: Options.kwargs) -> Result: ...


def spectral(
    function: Callable[Options, Result | ByWavelength[Result]],
) -> Spectral[Options, Result]:
    """Return a function unchanged, typed as `Spectral`: the result depends on its options."""
    return cast(Spectral[Options, Result], function)


def by_wavelength(data: xr.Dataset) -> xr.Dataset:
    """Replace the dimension `wavelength` of a dataset, if any, by `wavelength_nm`."""
    return data.swap_dims(wavelength="wavelength_nm") if "wavelength" in data.dims else data


def checked_wavelengths(wavelengths_nm: Any) -> list[float]:
    """Return wavelengths [nm] in ascending order.

    Raises
    ------
    Refused
        If there is none, one occurs twice, or one is not a finite number.
    """
    allowed = "one or more wavelengths [nm]"
    values = np.atleast_1d(require_finite(wavelengths_nm, "wavelengths_nm", allowed))
    rising = np.unique(values)
    if len(rising) < len(values):
        raise Refused("wavelengths_nm", Described("one given twice"), "different wavelengths [nm]")
    return [float(nm) for nm in rising]
