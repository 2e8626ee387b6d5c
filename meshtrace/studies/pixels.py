"""Pixels of a receiver: signal and background of each, and error rates of their combinations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from meshtrace.checks import Seed, check_call
from meshtrace.comms.background import with_background
from meshtrace.comms.combining import Combining, combined_ber
from meshtrace.comms.ook import OokLink, Preset
from meshtrace.daylight.light import Daylight
from meshtrace.engine.backward.background import background
from meshtrace.engine.setup.options import Meshing, StudyOptions
from meshtrace.engine.simulate import simulate
from meshtrace.errors import Described, Refused
from meshtrace.link import Link
from meshtrace.link.receivers import Aperture, Camera
from meshtrace.mesh import MeshSource
from meshtrace.models import Floats
from meshtrace.results.daylight import Background
from meshtrace.results.gain import GainResult
from meshtrace.scenario import Scenario
from meshtrace.stored import SHIFTS, Stored, Variable
from meshtrace.studies.background import electronics_of, light_of, mean_sea
from meshtrace.studies.campaign import campaign_of
from meshtrace.tables import text_table

WAYS: tuple[Combining, ...] = ("selection", "equal", "maximal")
"""Combining of pixels: the best one, the sum of all, and the maximal-ratio sum."""

_IMAGE = "pixel_x", "pixel_y"


@dataclass(frozen=True, eq=False, repr=False)
class PixelSignals(Stored, kind="pixels", title="meshtrace pixels of a receiver"):
    """Signal and background of each pixel (i, j) of a receiver.

    Attributes
    ----------
    edge : ndarray, shape (pixels + 1,)
        Tangents to the line of sight at the edges of the pixels, along both axes of the image.
    gain, gain_stderr : ndarray, shape (pixels, pixels)
        Channel gain of each pixel, and its standard error.
    signal_rate : ndarray, shape (pixels, pixels)
        Counts of a long one over those of a long zero [s-1].
    background_rate, background_rate_stderr : ndarray, shape (pixels, pixels)
        Primary counts of the background light [s-1], and their standard error.
    snr : ndarray, shape (pixels, pixels)
        Squared distance of zero and one over the mean variance of the sample; the sum over the
        pixels is that of the maximal-ratio sum.
    bit_rate : float
        R_b [bit s-1].
    ber_whole, ber_whole_stderr : float
        Bit error rate of one detector behind the whole field of view, at the mean gain.
    ber, ber_stderr : ndarray, shape (3,)
        The same of the best pixel, of the sum of all and of their maximal-ratio sum (`WAYS`).
    provenance : dict
        Link, sea, daylight, seeds and versions.
    """

    edge: Annotated[Floats, Variable("pixel_edge", name="pixel_edge")]
    gain: Annotated[Floats, Variable(*_IMAGE, name="pixel_gain")]
    gain_stderr: Annotated[Floats, Variable(*_IMAGE, name="pixel_gain_stderr")]
    signal_rate: Annotated[Floats, Variable(*_IMAGE, name="pixel_signal_rate")]
    background_rate: Annotated[Floats, Variable(*_IMAGE, name="pixel_background_rate")]
    background_rate_stderr: Annotated[
        Floats, Variable(*_IMAGE, name="pixel_background_rate_stderr")
    ]
    snr: Annotated[Floats, Variable(*_IMAGE, name="pixel_snr")]
    bit_rate: float
    ber_whole: float
    ber_whole_stderr: float
    ber: Annotated[Floats, Variable("combining", name="pixel_ber")]
    ber_stderr: Annotated[Floats, Variable("combining", name="pixel_ber_stderr")]
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def best_pixel(self) -> tuple[int, int]:
        """Pixel (i, j) of the highest signal-to-noise ratio."""
        i, j = np.unravel_index(int(self.snr.argmax()), self.snr.shape)
        return int(i), int(j)

    def _headline(self) -> str:
        side = len(self.snr)
        return f"{side} x {side} pixels, best (%d, %d)" % self.best_pixel

    def summary(self) -> str:
        """Return signal, background and error rates as text for a terminal."""
        best = self.best_pixel
        lines = [
            ("one detector", self.signal_rate.sum(), self.background_rate.sum(),
             self.ber_whole, self.ber_whole_stderr),
            (f"best pixel {best}", self.signal_rate[best], self.background_rate[best],
             self.ber[0], self.ber_stderr[0]),
            ("sum of pixels", self.signal_rate.sum(), self.background_rate.sum(),
             self.ber[1], self.ber_stderr[1]),
            ("maximal ratio", math.nan, math.nan, self.ber[2], self.ber_stderr[2]),
        ]  # fmt: skip
        heads = f"at {self.bit_rate:g} bit/s", "signal [1/s]", "background [1/s]", "ber"
        cells = [
            (name, *("" if math.isnan(rate) else f"{rate:.3g}" for rate in rates),
             f"{ber:.2g} +- {error:.1g}")
            for name, *rates, ber, error in lines
        ]  # fmt: skip
        return text_table(cells, heads)


@check_call
def pixel_signals(
    link: Link | Scenario,
    surface: MeshSource | None = None,
    daylight: Daylight | None = None,
    *,
    ook: OokLink | Preset = "physical",
    bit_rate: float | None = None,
    photons: Annotated[int, Field(ge=SHIFTS, le=10_000_000)] = 16_384,
    rays: Annotated[int, Field(ge=SHIFTS, le=10_000_000)] = 16_384,
    seed: Seed = 1,
    mesh: Meshing | None = None,
    threads: int | None = None,
) -> PixelSignals:
    r"""Return signal and background of each pixel of a receiver, and its bit error rates.

    Parameters
    ----------
    link : Link or Scenario
        The link, with one receiver that has pixels (`Receiver.pixels`).
    surface : MeshSource, optional
        The sea, as in `simulate`; of a random sea all waves but the longest are random slopes, so
        that gains and background are means.
    daylight : Daylight, optional
        Light above the sea, by default that of a scenario; none: dark.
    ook : OokLink or preset
        Transmission, by default that of the scenario. Each pixel has its detector.
    bit_rate : float, optional
        Bit rate R_b [bit s-1], by default that of the transmission.
    photons, rays : int
        Chains of the gain and rays of the background, 32 ... 10 000 000.
    seed : int
        Key of the random numbers.
    mesh : Meshing, optional
        Time and resolution of the surface.
    threads : int, optional
        Threads, all cores by default; the result does not depend on them.

    Returns
    -------
    PixelSignals

    Raises
    ------
    Refused
        If the link has several receivers, or one without pixels.

    Notes
    -----
    The signal-to-noise ratio of a pixel with mean counts m and variances v over the patterns of
    bits is

    .. math:: \mathrm{SNR} = (m_1 - m_0)^2 / \bar v,

    with m_1 of ones alone and m_0 of zeros alone. Standard errors of the error rates are by those
    of the gain and of the background of the whole field of view.

    Examples
    --------
    >>> import meshtrace as mt
    >>> link = mt.Link(receiver=mt.Receiver(pixels=3))
    >>> seen = mt.studies.pixel_signals(link, mt.surfaces.FlatSea(), photons=64)
    >>> seen.best_pixel
    (1, 1)
    """
    run: StudyOptions = {"photons": photons, "seed": seed, "mesh": mesh, "threads": threads}
    campaign = campaign_of(link, surface, "pixel_signals", run, several=False)
    link = campaign.link
    if len(link.receivers) != 1 or link.pixels == 1:
        text = f"{len(link.receivers)} receivers, {link.pixels} pixels along a side"
        raise Refused("receiver", Described(text), "one receiver with pixels = 2 or more")
    sea, meshing = mean_sea(link, campaign.surface), campaign.meshing.replace(waves=None)
    result = simulate(link, sea, photons=photons, seed=seed, threads=threads, mesh=meshing)
    day = light_of(campaign, daylight)
    ambient: Background | None = None
    if day is not None:
        ambient = background(link, sea, day, photons=rays, seed=seed, mesh=meshing, threads=threads)
    dark = electronics_of(campaign, ook, bit_rate)
    assert dark is not None
    return _signals(result, ambient, dark, link.receivers[0])


def _signals(
    result: GainResult, ambient: Background | None, dark: OokLink, receiver: Aperture
) -> PixelSignals:
    """Return signal and background of the pixels of a receiver from its gains and background."""
    assert isinstance(receiver, Camera)
    assert result.gain_by_pixel is not None
    assert result.gain_by_pixel_stderr is not None
    gain, shape = result.gain_by_pixel[0], (receiver.pixels, receiver.pixels)
    lights = [None if ambient is None else ambient.of_pixel(i, j) for i, j in np.ndindex(*shape)]
    counts = np.array([(0.0, 0.0) if b is None else _counts(dark, b) for b in lights])
    pairs = list(zip(_exposed(dark, lights), dark.received_power(gain.ravel()), strict=True))
    moments = [transmission.moments(power) for transmission, power in pairs]
    levels = [transmission.levels(power) for transmission, power in pairs]
    # central differences over one standard error of the gain, and of the background
    errors_of = [float(result.stderrs[0]) / max(float(result.gains[0]), 1e-300), 0.0]
    if ambient is not None:
        errors_of[1] = ambient.radiance_stderr / max(ambient.radiance, 1e-300)
    steps = (0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)
    factors = np.maximum(1.0 + np.array(steps) * errors_of, 0.0).tolist()
    rates = np.array([_error_rates(dark, gain, [ambient, *lights], *pair) for pair in factors])
    errors = np.hypot(0.5 * (rates[1] - rates[2]), 0.5 * (rates[3] - rates[4]))
    origin = {} if ambient is None else {"daylight": ambient.provenance["daylight"]}
    return PixelSignals(
        edge=receiver.pixel_edges,
        gain=gain,
        gain_stderr=result.gain_by_pixel_stderr[0],
        signal_rate=np.reshape([high - low for low, high in levels], shape),
        background_rate=counts[:, 0].reshape(shape),
        background_rate_stderr=counts[:, 1].reshape(shape),
        snr=np.reshape([np.ptp(mean) ** 2 / noise.mean() for mean, noise in moments], shape),
        bit_rate=dark.bit_rate,
        ber_whole=float(rates[0, 0]),
        ber_whole_stderr=float(errors[0]),
        ber=rates[0, 1:],
        ber_stderr=errors[1:],
        provenance=result.provenance | origin,
    )


def _counts(ook: OokLink, ambient: Background) -> tuple[float, float]:
    """Return the counts of a background [s-1] and their standard error."""
    rate = ambient.count_rate(ook)
    return rate, rate * ambient.radiance_stderr / max(ambient.radiance, 1e-300)


def _exposed(dark: OokLink, lights: list[Background | None], scale: float = 1.0) -> list[OokLink]:
    """Return the transmission under each of several backgrounds, times a scale."""
    return [dark if b is None else with_background(dark, b, scale) for b in lights]


def _error_rates(
    dark: OokLink, gain: Floats, lights: list[Background | None], of_gain: float, of_light: float
) -> list[float]:
    """Return the error rates of a single detector, and of each way of combining pixels.

    `lights` are that of the whole and those of the pixels, of which all gains and backgrounds are
    taken times a factor.
    """
    whole, *links = _exposed(dark, lights, of_light)
    at = of_gain * gain.ravel()
    combined = [float(combined_ber(links, at, way)) for way in WAYS]
    return [float(whole.ber(whole.received_power(at.sum()))), *combined]
