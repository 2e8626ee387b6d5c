"""Daylight at receivers: parts of the background, irradiance under a moving sea, flashes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.checks import Shape
from meshtrace.errors import Described, Refused, require_finite, require_whole
from meshtrace.models import Floats
from meshtrace.results.tallies import error_of_groups
from meshtrace.stored import Stored, Variable

PARTS = ("sky", "glint", "water", "foam", "sun")
"""Parts of the background, in the order of `Background.part_radiance`.

In the air: sky mirrored by the sea or seen directly, sun mirrored, light out of the water, foam,
sun seen directly. Under water: "sky" and "sun" through the surface, scattered light included.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Background(Stored, kind="background", title="meshtrace background light"):
    """Background radiance averaged over the aperture and field of view of a receiver.

    Attributes
    ----------
    part_radiance, part_radiance_stderr : ndarray, shape (parts,)
        Mean radiance <L> = int L cos(theta) dOmega / (pi sin^2 psi) of each of `PARTS` over a field
        of view of half-angle psi about the axis of the receiver (theta = 0), and its standard
        error [W m-2 sr-1 nm-1].
    radiance, radiance_stderr : float
        Sum of the parts, and its standard error [W m-2 sr-1 nm-1].
    acceptance : float
        Etendue [m2 sr]: area of the aperture times projected solid angle pi sin^2 psi.
    wavelength_nm : float
        Wavelength [nm].
    pixel_radiance, pixel_radiance_stderr : ndarray, shape (pixels, pixels), or None
        What each pixel (i, j) of a receiver adds to `radiance`, sun, sky and light out of the water
        together, and its standard error; the power of a pixel is this times `acceptance`. The disk
        of the sun counts for the pixel of its centre.
    provenance : dict
        Link, sea, daylight, seeds and versions.
    """

    part_radiance: Annotated[Floats, Variable("part")]
    part_radiance_stderr: Annotated[Floats, Variable("part")]
    radiance: Annotated[float, Variable(name="background_radiance")]
    radiance_stderr: Annotated[float, Variable(name="background_radiance_stderr")]
    acceptance: Annotated[float, Variable()]
    wavelength_nm: Annotated[float, Variable()]
    provenance: dict[str, Any] = field(default_factory=dict)
    pixel_radiance: Annotated[Floats | None, Variable("pixel_x", "pixel_y")] = None
    pixel_radiance_stderr: Annotated[Floats | None, Variable("pixel_x", "pixel_y")] = None

    @classmethod
    def of_groups(
        cls, by_pixel: Annotated[Floats, Shape("n pixels parts")], acceptance: float,
        wavelength_nm: float,
    ) -> Self:  # fmt: skip
        """Average n independent samples (n, pixels, parts), with errors from their scatter.

        Raises
        ------
        Refused
            If the pixels are not those of a square.
        """
        side = math.isqrt(by_pixel.shape[1])
        if side**2 != by_pixel.shape[1] or side == 0:
            raise Refused("by_pixel", by_pixel.shape, "1, 4, 9, ... pixels along the second axis")
        # contiguous: sums over parts then have one order of additions, whatever the pixels
        parts = np.ascontiguousarray(by_pixel.sum(axis=1))
        total = parts.sum(axis=1)
        # the parts of a sample share its rays: their errors are correlated, and do not add in
        # quadrature to that of the sum
        radiance = float(total.mean()), float(error_of_groups(total))
        whole = cls(
            parts.mean(axis=0), error_of_groups(parts), *radiance, acceptance, wavelength_nm
        )
        if side == 1:
            return whole
        pixels = by_pixel.sum(axis=2).reshape(len(parts), side, side)
        return replace(
            whole, pixel_radiance=pixels.mean(axis=0), pixel_radiance_stderr=error_of_groups(pixels)
        )

    def of_pixel(self, i: int, j: int) -> Background:
        """Return the background of pixel (i, j), as a radiance over the whole field of view.

        Raises
        ------
        Refused
            If the receiver has no such pixel.
        """
        side = 1 if self.pixel_radiance is None else len(self.pixel_radiance)
        require_whole(i, 0, side - 1, "i")
        require_whole(j, 0, side - 1, "j")
        if self.pixel_radiance is None or self.pixel_radiance_stderr is None:
            return self
        value, error = self.pixel_radiance[i, j], self.pixel_radiance_stderr[i, j]
        # parts are not stored by pixel: each gets the share that the pixel has of their sum
        share = value / max(self.radiance, 1e-300)
        return replace(
            self, part_radiance=share * self.part_radiance, radiance=float(value),
            part_radiance_stderr=share * self.part_radiance_stderr, radiance_stderr=float(error),
            pixel_radiance=None, pixel_radiance_stderr=None,
        )  # fmt: skip

    @property
    def parts(self) -> dict[str, float]:
        """Mean radiance of each part [W m-2 sr-1 nm-1]."""
        return dict(zip(PARTS, self.part_radiance.tolist(), strict=True))

    @property
    def parts_stderr(self) -> dict[str, float]:
        """Standard error of each part [W m-2 sr-1 nm-1]."""
        return dict(zip(PARTS, self.part_radiance_stderr.tolist(), strict=True))

    @property
    def light_name(self) -> str:
        """Name of the daylight, such as "clear sky"."""
        return str(self.provenance["daylight"]["light"])

    def _check(self) -> None:
        # both properties pair the parts with `PARTS` by a strict zip, which raises ValueError if
        # their number is another
        dict(self.parts | self.parts_stderr)

    def _origin_lines(self) -> list[str]:
        return [self.light_name]

    @property
    def power_per_nm(self) -> float:
        """Power into the aperture within the field of view [W nm-1]."""
        return self.radiance * self.acceptance

    def count_rate(self, ook: Any) -> float:
        """Return the rate of primary background counts of a receiver [s-1], before saturation.

        r_b = PDE P_b / E_ph,  P_b = <L> dlambda T G,

        with the photon detection efficiency PDE, the photon energy E_ph, the width dlambda and
        transmission T of the filter, and the etendue G; or, where the LED, the filter or the
        efficiency of the detector has a spectrum, the integral of L T PDE / E_ph over wavelength
        and over angles that fill the field of view, with the spectrum of the light above the sea
        (`Daylight.spectrum`).

        Parameters
        ----------
        ook : OokLink
            Optics with the aperture and field of view of the background (`OokLink.of_link`),
            filter and SiPM.

        Notes
        -----
        G = min(A_lens n_med^2 pi sin^2 psi, pi A_det n_c^2) / n_med^2 with the areas of lens and
        detector, the half-angle psi of the field of view, and the refractive indices of the medium
        in front of the lens and of the concentrator. Behind an etendue-limited lens (the second
        term) a narrower field of view does not reduce the background. The product P_b takes the
        spectrum as flat over the filter: `Daylight.clear_sky(width_nm=...)` has the mean over
        a wide band.

        Raises
        ------
        Refused
            If the filter is wider than twice the wavelength, on which its band is centred: it would
            reach below 0 nm.
        """
        if not hasattr(ook, "background_count_rate"):  # `results` may not import `comms`
            raise Refused("ook", Described(type(ook).__name__), "an OokLink")
        widest, width = 2.0 * self.wavelength_nm, ook.optics.equivalent_width_nm
        if width > widest:
            raise Refused("optics.filter_width_nm", width, f"<= {widest:g}, twice the wavelength")
        return float(ook.background_count_rate(self))

    def _headline(self) -> str:
        return (
            f"{self.light_name}: {self.radiance:.4e} +- {self.radiance_stderr:.1e} W m-2 sr-1 nm-1 "
            f"at {self.wavelength_nm:g} nm"
        )

    def summary(self) -> str:
        """Return radiance, parts and power as text for a terminal."""
        lines = [self._headline()]
        lines += [
            f"  {name:<6} {self.parts[name]:.4e} +- {self.parts_stderr[name]:.1e}"
            for name in PARTS
            if self.parts[name] > 0.0
        ]
        return "\n".join([*lines, f"  power  {self.power_per_nm:.4e} W nm-1"])


@dataclass(frozen=True, eq=False, repr=False)
class BackgroundSeries(
    Stored, kind="background-series", title="meshtrace background light over time"
):
    """Background of a receiver over a moving sea, with the same rays at all times.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Times [s].
    part_radiance, part_radiance_stderr : ndarray, shape (n, parts)
        Mean radiance of each of `PARTS`, and its standard error [W m-2 sr-1 nm-1].
    provenance : dict
        Link, sea, daylight, seeds and versions.
    """

    time: Annotated[Floats, Variable("time")]
    part_radiance: Annotated[Floats, Variable("time", "part")]
    part_radiance_stderr: Annotated[Floats, Variable("time", "part")]
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def radiance(self) -> Floats:
        """Sum of the parts at each time, shape (n,)."""
        return np.asarray(self.part_radiance.sum(axis=1))

    @property
    def parts(self) -> dict[str, Floats]:
        """Mean radiance of each part at each time."""
        return dict(zip(PARTS, self.part_radiance.T, strict=True))

    @property
    def scintillation_index(self) -> float:
        """Variance of the radiance over its squared mean, including the noise of the rays."""
        return float(self.radiance.var() / self.radiance.mean() ** 2)

    def _headline(self) -> str:
        return (
            f"{len(self.time)} times, mean {self.radiance.mean():.4e} W m-2 sr-1 nm-1, "
            f"scintillation index {self.scintillation_index:.3g}"
        )

    def summary(self) -> str:
        """Return mean, extremes and fluctuation as text for a terminal."""
        low, high = self.radiance.min(), self.radiance.max()
        return f"{self._headline()}\n  from {low:.4e} to {high:.4e}"


THRESHOLDS = (1.25, 1.5, 2.0, 2.5, 3.0, 5.0)
"""Default thresholds of flashes, in units of the mean irradiance."""


class Flashes(NamedTuple):
    """Rates and durations of flashes above thresholds at each depth.

    Parameters
    ----------
    threshold : ndarray, shape (thresholds,)
        Thresholds in units of the mean irradiance.
    per_minute : ndarray, shape (depths, thresholds)
        Flashes that begin, per minute.
    duration : ndarray, shape (depths, thresholds)
        Mean duration [s], nan without flashes.
    """

    threshold: Floats
    per_minute: Floats
    duration: Floats


@dataclass(frozen=True, eq=False, repr=False)
class IrradianceSeries(Stored, kind="irradiance-series", title="meshtrace irradiance over time"):
    """Downward irradiance at depths under a moving sea.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Times [s].
    depth : ndarray, shape (depths,)
        Depths below still water [m].
    irradiance : ndarray, shape (n, depths)
        Downward irradiance, averaged over the collector [W m-2 nm-1].
    unscattered : ndarray, shape (n, depths)
        Part by sunlight that was not scattered [W m-2 nm-1].
    sky : ndarray, shape (depths,)
        Part by light of the sky, constant in time [W m-2 nm-1].
    still : ndarray, shape (depths,)
        Irradiance of unscattered sunlight under still water [W m-2 nm-1].
    provenance : dict
        Sea, daylight, water, collector, grids, seeds, versions and costs.
    x, y : ndarray, or None
        Centres of the cells of the patch [m].
    pattern : ndarray, shape (n, depths, nx, ny), or None
        Irradiance that the collector would have at each cell of the patch [W m-2 nm-1].
    """

    time: Annotated[Floats, Variable("time")]
    depth: Annotated[Floats, Variable("depth")]
    irradiance: Annotated[Floats, Variable("time", "depth", name="spectral_irradiance")]
    unscattered: Annotated[Floats, Variable("time", "depth", name="unscattered_irradiance")]
    sky: Annotated[Floats, Variable("depth", name="sky_irradiance")]
    still: Annotated[Floats, Variable("depth", name="still_irradiance")]
    provenance: dict[str, Any] = field(default_factory=dict)
    x: Annotated[Floats | None, Variable("x")] = None
    y: Annotated[Floats | None, Variable("y")] = None
    pattern: Annotated[
        Floats | None, Variable("time", "depth", "x", "y", name="irradiance_pattern")
    ] = None

    @property
    def mean(self) -> Floats:
        """Mean irradiance at each depth [W m-2 nm-1]."""
        return np.asarray(self.irradiance.mean(axis=0))

    @property
    def cv(self) -> Floats:
        """Coefficient of variation at each depth: standard deviation over mean."""
        return np.asarray(self.irradiance.std(axis=0) / self.mean)

    def pdf(self, edges: ArrayLike) -> Floats:
        """Return the probability density of E / mean in bins between edges, shape (depths, bins).

        E is the irradiance, mean its mean over time at a depth. The density
        integrates to 1 over the bins, and is 0 at a depth without values in them.
        """
        edges = require_finite(edges, "edges", "increasing numbers, two or more")
        width = np.diff(edges)
        if not width.size or not (width > 0.0).all():
            raise Refused("edges", edges, "increasing numbers, two or more")
        # over the number of values in the bins, and not of all; 1 in place of 0 where there is none
        counts = [np.histogram(ratio, edges)[0] for ratio in (self.irradiance / self.mean).T]
        return np.stack([n / width / max(n.sum(), 1) for n in counts])

    def flashes(self, thresholds: ArrayLike = THRESHOLDS) -> Flashes:
        """Return the rate and mean duration of flashes, for equally spaced times.

        A flash is an interval in which the irradiance E exceeds k times its mean over time.

        Parameters
        ----------
        thresholds : array_like
            Thresholds k in units of the mean irradiance, > 0.

        Raises
        ------
        Refused
            If times are not equally spaced, or a threshold is not positive.

        Notes
        -----
        A flash is counted where it begins, in one of the n - 1 steps. The duration is the share of
        the n times above the threshold, over the rate.
        """
        step = self._step()
        k = require_finite(thresholds, "thresholds", "numbers > 0")
        if (k <= 0.0).any():
            raise Refused("thresholds", thresholds, "numbers > 0")
        above = (self.irradiance / self.mean)[:, :, None] > k
        # (times, depths, thresholds); a flash begins between a time below and the next one above
        begun = np.count_nonzero(above[1:] & ~above[:-1], axis=0)
        rate = begun / (step * (len(self.time) - 1))
        # one that has begun before the first time counts with its duration, but as no flash
        share = np.count_nonzero(above, axis=0) / len(self.time)
        duration = np.divide(share, rate, out=np.full(begun.shape, np.nan), where=begun > 0)
        return Flashes(k, 60.0 * rate, duration)

    def spectrum(self) -> tuple[Floats, Floats]:
        """Return frequencies (n,) [Hz] and the one-sided power density of E / mean [Hz-1].

        E is the irradiance, mean its mean over time at a depth. The density has
        the shape (depths, n). Welch's method with seven segments, for equally spaced times.
        """
        from scipy.signal import welch

        relative = (self.irradiance / self.mean - 1.0).T
        # segments of a quarter of the series that overlap by half, scipy's default: 2 * 4 - 1 = 7
        rate, length = 1.0 / self._step(), max(len(self.time) // 4, 2)
        frequency, density = welch(relative, rate, nperseg=length, axis=-1)
        return frequency, density

    def wavelengths(self) -> tuple[Floats, Floats]:
        """Return wavenumbers (n,) [rad m-1] and the power density of the pattern along x.

        One-sided density [m rad-1] of the pattern over its mean at a depth, shape (depths, n),
        averaged over all y and times.

        Raises
        ------
        Refused
            If the series has no pattern.
        """
        if self.pattern is None or self.x is None:
            raise Refused("pattern", None, "a series made with patch")
        from scipy.signal import periodogram

        step = float(self.x[1] - self.x[0])
        # the window of Hann: a patch is not periodic, and its edges would add power to all waves
        relative = self.pattern / self.pattern.mean(axis=(0, 2, 3), keepdims=True) - 1.0
        cycles, density = periodogram(relative, 1.0 / step, "hann", axis=2)
        # from cycles to radians: S(k) dk = S(1 / lambda) d(1 / lambda) with k = 2 pi / lambda
        return 2.0 * np.pi * cycles, density.mean(axis=(0, 3)) / (2.0 * np.pi)

    def _step(self) -> float:
        """Return the step of equally spaced times [s]; refuse others."""
        steps = np.diff(self.time)
        # 1e-6: steps of decimal numbers differ by rounding
        if len(steps) < 2 or np.ptp(steps) > 1e-6 * steps.mean():
            raise Refused("times", Described(f"{len(self.time)} times"), "equally spaced times")
        return float(steps.mean())

    def _headline(self) -> str:
        each = (f"{d:g} m {cv:.3g}" for d, cv in zip(self.depth, self.cv, strict=True))
        return f"irradiance at {len(self.time)} times, coefficient of variation {', '.join(each)}"

    def summary(self) -> str:
        """Return mean, coefficient of variation, and flashes at each depth as text."""
        lines = [
            f"downward irradiance at {len(self.time)} times, "
            f"{self.time[0]:g} to {self.time[-1]:g} s",
            "   depth  W m-2 nm-1  unscattered       CV   highest  flashes > 1.5 mean",
        ]
        try:
            _, rates, durations = self.flashes([1.5])
            flashes = [
                f"{rate:.0f} per min, {1e3 * duration:.3g} ms" if rate else "none"
                for rate, duration in zip(rates[:, 0], durations[:, 0], strict=True)
            ]
        except Refused:  # times that are not equally spaced
            flashes = [""] * len(self.depth)
        share = self.unscattered.mean(axis=0) / self.mean
        highest = self.irradiance.max(axis=0) / self.mean
        for row in zip(self.depth, self.mean, share, self.cv, highest, flashes, strict=True):
            lines.append("{:6g} m  {:10.4g}  {:10.1%}  {:8.3g}  {:8.3g}  {}".format(*row))
        return "\n".join(lines)
