"""From a link to its performance: gains over many seas, tilt of the receiver, bits.

`link_performance` joins the channel gain (`ensemble`, forced detection) with the receiver
(`detector`, `budget`) and the UAV (`uav`); `depth_sweep` gives the curves of the bit error rate
over depth. `coupled_series` lets the flight tilt the receiver itself: aperture and field of view
of every photon.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from os import cpu_count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.budget import (
    Capacity,
    _ber_of_gains,
    capacity,
    depth_at,
    link_budget,
    outage,
    required_gain,
)
from meshtrace.detector import OokLink
from meshtrace.fading import Estimate, effective_samples
from meshtrace.link import Link, Receiver, WaterSource, Whitecaps
from meshtrace.mesh import SurfaceModel
from meshtrace.optics.bubbles import HallNovarini
from meshtrace.pulses import Eye
from meshtrace.result import FORMAT_VERSION
from meshtrace.series import GainSeries, RandomSea, ensemble, time_series
from meshtrace.simulate import mesh_for, provenance
from meshtrace.sipm import photon_energy
from meshtrace.tilt import h_alpha
from meshtrace.transport.forced import SHIFTS, ForcedDetection, Parts, crossing_reach
from meshtrace.uav import Flight, Uav
from meshtrace.wind import Dryden

if TYPE_CHECKING:
    import xarray as xr

FloatArray = NDArray[np.float64]
Preset = Literal["physical", "paper", "paper-ranges"]

SWEEP_DEPTHS = tuple(float(d) for d in range(20, 95, 5))
"""Depths of `depth_sweep` [m]."""

_TILTS = 50  # drawn for each realization of the sea
_RESAMPLES = 1000
_QUANTILES = 500  # that stand for the law of the gain in the capacity


# --- the parts of a link, made to agree ----------------------------------------------------


def ook_link(
    link: Link, ook: OokLink | Preset = "physical", bit_rate: float | None = None
) -> OokLink:
    """Return the transmission that belongs to a link.

    Parameters
    ----------
    link : Link
        Its power and wavelength, aperture radius and field of view are taken over.
    ook : OokLink or preset
        Everything else.
    bit_rate : float, optional
        R_b [bit s-1]; by default that of `ook`.

    Returns
    -------
    OokLink

    Raises
    ------
    ValueError
        If the preset is unknown or the link has not one receiver in the air.

    Examples
    --------
    >>> from meshtrace.link import Led
    >>> ook_link(Link(transmitter=Led(power_mw=50.0)), bit_rate=5e6).led.power
    0.05
    """
    receiver, first = _receiver(link), link.transmitters[0]
    base = ook if isinstance(ook, OokLink) else OokLink.preset(ook)
    led = {
        "power": 1e-3 * sum(t.power_mw for t in link.transmitters),
        "wavelength": 1e-9 * first.wavelength_nm,
    }
    optics = {"radius": receiver.radius, "fov_deg": receiver.fov_deg}
    return OokLink.model_validate(
        {
            **dict(base),
            "bit_rate": base.bit_rate if bit_rate is None else bit_rate,
            "led": base.led.model_copy(update=led),
            "optics": base.optics.model_copy(update=optics),
        }
    )


def channel_link(link: Link, ook: OokLink) -> Link:
    """Return the link under which a calibration wants its gains: the water's a times a factor.

    Parameters
    ----------
    link : Link
        The link.
    ook : OokLink
        Its `absorption_factor` is 2 in the empirical calibration "paper-ranges", else 1.
    """
    factor, water = ook.absorption_factor, link.water
    if factor == 1.0:
        return link
    changes: dict[str, Any] = {"a": factor * water.a}
    if water.layers is not None:
        changes["layers"] = tuple((z, factor * a, b) for z, a, b in water.layers)
    return link.model_copy(update={"water": water.model_copy(update=changes)})


def in_wind(link: Link, wind_speed: float) -> Link:
    """Return a link with the whitecaps and bubbles of a wind.

    Parameters
    ----------
    link : Link
        The link; bubbles and whitecaps of its own are replaced.
    wind_speed : float
        Wind at 10 m [m s-1]; 0 for neither whitecaps nor bubbles.

    Examples
    --------
    >>> round(in_wind(Link(), 13.0).whitecaps.transmittance, 4)
    0.8899
    """
    if wind_speed == 0.0:
        return link.model_copy(update={"whitecaps": None, "bubbles": None})
    wavelength = link.transmitters[0].wavelength_nm
    bubbles = HallNovarini(wind_speed=wind_speed, n_water=link.water.n, wavelength_nm=wavelength)
    caps = Whitecaps(wind_speed=wind_speed)
    return link.model_copy(update={"whitecaps": caps, "bubbles": bubbles})


def _receiver(link: Link) -> Receiver:
    if not isinstance(link.receiver, Receiver):
        raise ValueError("receiver: none or several, allowed one receiver in the air")
    return link.receiver


def _at_depth(link: Link, depth: float) -> Link:
    source = link.transmitter
    if not isinstance(source, WaterSource):
        raise ValueError("transmitter: allowed one source in the water, whose depth varies")
    moved = type(source).model_validate({**dict(source), "depth": depth})
    return Link.model_validate({**dict(link), "transmitter": moved})


# --- the tilt inside of the transport ------------------------------------------------------


class CoupledSeries(NamedTuple):
    """Gains with the tilt in them, and the flight that caused it."""

    series: GainSeries
    flight: Flight


def coupled_series(
    link: Link,
    sea: SurfaceModel,
    times: ArrayLike,
    uav: Uav,
    wind: Dryden,
    seed: int = 1,
    *,
    photons: int = 2048,
    normals: Literal["vertex", "facet"] = "vertex",
    extent: float | None = None,
    spacing: float | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> CoupledSeries:
    """Return the gain over a moving sea under a receiver that a flight tilts.

    At each time the receiver takes the tilt and azimuth of the simulated flight, and the sea its
    mesh: the tilt acts in the cosine of the aperture and in the field of view of every photon.

    Parameters
    ----------
    link : Link
        The link, with one receiver that looks straight down.
    sea : SurfaceModel
        The sea; time moves its waves.
    times : array_like, shape (n,)
        Evenly spaced times [s], n >= 2.
    uav : Uav
        The airframe.
    wind : Dryden
        Wind at the UAV.
    seed : int
        Seed of the chains and of the gusts.
    photons : int
        Chains, drawn with the same numbers at all times.
    normals, extent, spacing, threads
        As in `simulate`; the result does not depend on the threads.
    progress : callable, optional
        Called with 1 after each time.

    Returns
    -------
    CoupledSeries
        Series of the gain, and flight.

    Raises
    ------
    ValueError
        If the receiver is tilted already, or the times are not evenly spaced.

    Notes
    -----
    Departs from the paper, where a separate factor h_alpha = cos(alpha) [alpha <= fov / 2]
    multiplies the gain. That factor is right for light that arrives straight from below. Scattered
    light fills a cone: the gain falls below the factor where a part of the cone leaves the field
    of view, and does not vanish at once beyond its edge. An aperture that is off the axis of the
    light also gains or loses by the azimuth of the tilt, which the factor does not know.

    Examples
    --------
    >>> from meshtrace.surfaces import FlatSea
    >>> calm = Dryden(wind_speed=0.0)
    >>> coupled = coupled_series(Link(), FlatSea(), [0.0, 1.0], Uav(), calm, photons=256)
    >>> coupled.flight.tilt.angle.tolist()
    [0.0, 0.0]
    """
    receiver = _receiver(link)
    if receiver.tilt_deg != 0.0:
        raise ValueError(f"receiver.tilt_deg: {receiver.tilt_deg}, allowed 0: the flight tilts it")
    flight = uav.simulate_flight(wind, times, seed)
    still = mesh_for(link, sea, float(flight.times[0]), extent, spacing, crossing_reach(link))[0]
    crest = 1.5 * float(still.bounds[1, 2])

    def frame(i: int) -> Parts:
        tilted = _tilted(link, float(flight.tilt.angle[i]), float(flight.tilt.azimuth[i]))
        reach, time = crossing_reach(tilted), float(flight.times[i])
        mesh = mesh_for(tilted, sea, time, extent, spacing, reach)[0]
        return ForcedDetection(tilted, photons, seed, normals, crest=crest).evaluate(mesh)

    parts = []
    with ThreadPoolExecutor(threads or cpu_count() or 1) as pool:
        for part in pool.map(frame, range(len(flight.times))):
            parts.append(part)
            if progress is not None:
                progress(1)
    run = {
        "estimator": "forced",
        "photons": photons,
        "seed": seed,
        "normals": normals,
        "extent": extent,
        "spacing": spacing,
    }
    origin = {
        **provenance(link, sea.to_config(), run),
        "uav": uav.model_dump(mode="json"),
        "wind": wind.model_dump(mode="json"),
    }
    return CoupledSeries(_series_of(parts, flight.times, origin), flight)


def _tilted(link: Link, angle: float, azimuth: float) -> Link:
    tilt = {"tilt_deg": math.degrees(angle), "tilt_azimuth_deg": math.degrees(azimuth)}
    return link.model_copy(update={"receiver": _receiver(link).model_copy(update=tilt)})


def _series_of(parts: Sequence[Parts], times: FloatArray, origin: dict[str, Any]) -> GainSeries:
    shifts = np.mean([part.scattered[0] for part in parts], axis=0)
    return GainSeries(
        along="time",
        coordinate=times,
        gain=np.array([part.gain[0] for part in parts]),
        gain_stderr=np.array([part.stderr[0] for part in parts]),
        gain_ballistic=np.array([part.ballistic[0] for part in parts]),
        mean_stderr=float(shifts.std(ddof=1) / math.sqrt(SHIFTS)),
        provenance=origin,
    )


# --- fading of one link --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Fades:
    """Gains of one link with the factors by which the tilt multiplies each.

    Attributes
    ----------
    series : GainSeries
        Gains over n seas.
    h_alpha : ndarray, shape (n, m)
        Tilt factors, m for each sea; ones without a UAV and where the gains contain the tilt.
    n_effective : float
        Number of independent samples.
    """

    series: GainSeries
    h_alpha: FloatArray
    n_effective: float

    @property
    def samples(self) -> FloatArray:
        """Gains times tilt factors (n, m)."""
        return self.series.gain[:, None] * self.h_alpha

    @property
    def chain_error(self) -> float:
        """Relative Monte Carlo error that all gains have in common."""
        return float(self.series.mean_stderr) / max(float(self.series.gain.mean()), 1e-300)

    def mean_gain(self, quantile: float) -> Estimate:
        """Mean gain with an interval of `quantile` standard errors of seas, tilts and chains."""
        gains = _independent(self.samples)
        mean = float(gains.mean())
        spread = float(gains.std()) / math.sqrt(max(self.n_effective - 1.0, 1.0))
        reach = quantile * math.hypot(spread, mean * self.chain_error)
        return Estimate(mean, max(mean - reach, 0.0), mean + reach)


def _independent(samples: FloatArray) -> FloatArray:
    """Return the mean over the tilts of each sea, or over one sea every tilt by itself."""
    return samples.mean(axis=1) if len(samples) > 1 else samples[0]


class _Recipe(NamedTuple):
    """How the seas and the tilts of a link are drawn."""

    sea: SurfaceModel
    realizations: int
    flown: tuple[Uav, Dryden] | None
    coupled: bool
    time_step: float
    seed: int
    options: dict[str, Any]

    def fades(self, link: Link) -> Fades:
        if self.coupled and self.flown is not None:
            return self._coupled(link, *self.flown)
        n = self.realizations
        if isinstance(self.sea, RandomSea):
            series = ensemble(link, n, self.sea, seed=self.seed, **self.options)
        else:
            series = time_series(link, self.sea, [0.0], seed=self.seed, **self.options)
        seas = len(series.gain)
        if self.flown is None:
            return Fades(series, np.ones((seas, 1)), float(seas))
        uav, wind = self.flown
        tilts = _TILTS if seas > 1 else _TILTS * n
        winds = wind.sample_wind(seas * tilts, self.seed)
        fov = math.radians(_receiver(link).fov_deg)
        factors = h_alpha(uav.tilt(winds).angle, fov).reshape(seas, tilts)
        return Fades(series, factors, float(seas if seas > 1 else tilts))

    def _coupled(self, link: Link, uav: Uav, wind: Dryden) -> Fades:
        times = self.time_step * np.arange(self.realizations)
        series = coupled_series(link, self.sea, times, uav, wind, self.seed, **self.options).series
        n = float(self.realizations)
        n = effective_samples(series.gain) if np.ptp(series.gain) > 0.0 else n
        return Fades(series, np.ones((len(times), 1)), n)


# --- performance ---------------------------------------------------------------------------


class Figures(NamedTuple):
    """Performance at one depth and bit rate; estimates carry their confidence intervals.

    Attributes
    ----------
    depth : float
        Depth of the transmitter [m].
    bit_rate : float
        R_b [bit s-1].
    gain : Estimate
        Mean channel gain, tilt included [1].
    received_power : Estimate
        Mean optical power on the SiPM [W], in the sense of `LedDriver.power`.
    required_power : float
        Power for the limit of the bit error rate without fading [W].
    photons_per_bit : Estimate
        Mean photons on the SiPM in a bit, ones and zeros alike [1].
    margin_optical_db, margin_electrical_db : Estimate
        Mean received over required power: 10 log10 of the optical powers, and twice that.
    ber : Estimate
        Bit error rate, averaged over the fading.
    outage : Estimate
        Probability that the bit error rate of a realization misses the limit.
    capacity : Capacity
        Hard and soft ergodic rates, hard-decision rate of all but 1 % of the fades [bit s-1].
    """

    depth: float
    bit_rate: float
    gain: Estimate
    received_power: Estimate
    required_power: float
    photons_per_bit: Estimate
    margin_optical_db: Estimate
    margin_electrical_db: Estimate
    ber: Estimate
    outage: Estimate
    capacity: Capacity


@dataclass(frozen=True, eq=False)
class LinkPerformance:
    """Performance of a link at one or several depths and bit rates.

    Attributes
    ----------
    depths : tuple of float
        Depths of the transmitter [m].
    ooks : tuple of OokLink
        Transmission at each bit rate.
    figures : tuple of Figures
        Depth by depth, the bit rates of each together.
    fades : tuple of Fades
        Gains and tilt factors at each depth.
    limit : float
        Bit error rate before decoding that counts as success.
    confidence : float
        Level of all intervals.
    status : str
        What the calibration is worth; to be shown with every figure.
    provenance : dict
        Link, sea, receiver, seeds and versions.
    """

    depths: tuple[float, ...]
    ooks: tuple[OokLink, ...]
    figures: tuple[Figures, ...]
    fades: tuple[Fades, ...]
    limit: float
    confidence: float
    status: str
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def bit_rates(self) -> tuple[float, ...]:
        """Bit rates [bit s-1]."""
        return tuple(ook.bit_rate for ook in self.ooks)

    def at(self, depth: float | None = None, bit_rate: float | None = None) -> Figures:
        """Return the figures of a depth [m] and bit rate [bit s-1], by default the first.

        Raises
        ------
        ValueError
            If the performance was not computed there.
        """
        row = _index("depth", self.depths, depth)
        column = _index("bit_rate", self.bit_rates, bit_rate)
        return self.figures[row * len(self.ooks) + column]

    def estimates(self, name: str) -> FloatArray:
        """Return a figure with its limits as an array.

        Parameters
        ----------
        name : str
            An estimate of `Figures`, such as "ber".

        Returns
        -------
        ndarray, shape (depths, bit_rates, 3)
            Value, lower and upper limit.
        """
        flat = np.array([getattr(f, name) for f in self.figures])
        return flat.reshape(len(self.depths), len(self.ooks), 3)

    def range_at_ber(self, ber: float | None = None) -> tuple[Estimate, ...]:
        """Return the depth down to which each bit rate reaches an average bit error rate.

        Parameters
        ----------
        ber : float, optional
            Bit error rate, `limit` by default; see `budget.FEC_LIMITS`.

        Returns
        -------
        tuple of Estimate
            Depths [m]; nan where the curve, or that of a limit, does not cross `ber` between the
            depths computed.

        Notes
        -----
        The argument q of BER = Q(q) is interpolated over depth (PCHIP of ln q): it follows the
        gain and is far smoother than the error rate.
        """
        target = self.limit if ber is None else ber
        if not 0.0 < target < 0.5:
            raise ValueError(f"ber: {ber}, allowed 0 < ber < 0.5")
        curves = self.estimates("ber")
        ranges = []
        for i in range(len(self.ooks)):
            value, more, less = (_range(self.depths, curves[:, i, j], target) for j in range(3))
            ranges.append(Estimate(value, less, more))
        return tuple(ranges)

    def eye(self, depth: float | None = None, bit_rate: float | None = None) -> Eye:
        """Return the eye diagram at the mean received power of a depth and bit rate."""
        figures = self.at(depth, bit_rate)
        return self.ooks[self.bit_rates.index(figures.bit_rate)].eye(figures.received_power.value)

    def summary(self) -> str:
        """Return the performance as a text for the terminal."""
        percent = f"{100.0 * self.confidence:g} %"
        lines = [
            f"{'depth':>7}{'Mbit/s':>8}{'P_rx dBm':>10}{'margin dB optical':>19}"
            f"{'electrical':>12}{'average BER':>13}{percent + ' interval':>22}{'outage':>9}"
            f"{'photons/bit':>13}{'capacity Mbit/s':>17}"
        ]
        lines += [_figures_line(figures) for figures in self.figures]
        if len(self.depths) > 1:
            lines += ["", f"range at BER {self.limit:g} ({percent} interval)"]
            for rate, found in zip(self.bit_rates, self.range_at_ber(), strict=True):
                lines.append(f"{rate / 1e6:>7g} Mbit/s  {_range_text(found)}")
        return "\n".join([*lines, "", self.status])

    def to_dataset(self) -> xr.Dataset:
        """Return the figures as an xarray Dataset over depth and bit rate, with units."""
        import xarray as xr

        dims, shape = ("depth", "bit_rate"), (len(self.depths), len(self.ooks))
        variables: dict[str, Any] = {}
        for name in _ESTIMATES:
            for i, suffix in enumerate(("", "_low", "_high")):
                variables[name + suffix] = (dims, self.estimates(name)[..., i], _attrs(name))
        for name in Capacity._fields:
            values = [getattr(f.capacity, name) for f in self.figures]
            key = f"capacity_{name}"
            variables[key] = (dims, np.reshape(values, shape), _attrs(key))
        needed = [f.required_power for f in self.figures[: len(self.ooks)]]
        variables["required_power"] = (("bit_rate",), needed, _attrs("required_power"))
        if len(self.depths) > 1:
            ranges = np.array(self.range_at_ber())
            for i, suffix in enumerate(("", "_low", "_high")):
                variables["range" + suffix] = (("bit_rate",), ranges[:, i], _attrs("range"))
        coordinates = {
            "depth": ("depth", list(self.depths), _attrs("depth")),
            "bit_rate": ("bit_rate", list(self.bit_rates), _attrs("bit_rate")),
        }
        about = {
            "title": "meshtrace link performance",
            "format_version": FORMAT_VERSION,
            "kind": "performance",
            "ber_limit": self.limit,
            "confidence": self.confidence,
            "status": self.status,
            "provenance": json.dumps(self.provenance),
        }
        return xr.Dataset(variables, coordinates, about)

    def save(self, path: str | Path) -> None:
        """Write the figures as netCDF."""
        self.to_dataset().to_netcdf(path, engine="h5netcdf")


_ESTIMATES = (
    "gain",
    "received_power",
    "photons_per_bit",
    "margin_optical_db",
    "margin_electrical_db",
    "ber",
    "outage",
)

_OWN_FIELDS = {
    "required_power": ("W", "optical power required for the limit of the bit error ratio"),
    "photons_per_bit": ("1", "photons on the detector in a bit"),
    "margin_optical_db": ("dB", "link margin, ratio of optical powers"),
    "margin_electrical_db": ("dB", "link margin, ratio of squared photocurrents"),
    "capacity_hard": ("s-1", "ergodic capacity in bits after hard decisions"),
    "capacity_soft": ("s-1", "ergodic capacity in bits from full counts"),
    "capacity_hard_outage": ("s-1", "hard-decision rate of all but 1 percent of the fades"),
    "range": ("m", "depth down to which the limit of the bit error ratio is reached"),
}


def _attrs(name: str) -> dict[str, str]:
    from meshtrace.fields import attrs

    if name in _OWN_FIELDS:
        return dict(zip(("units", "long_name"), _OWN_FIELDS[name], strict=True))
    return attrs("gain_mean" if name == "gain" else name)


def _index(name: str, values: tuple[float, ...], wanted: float | None) -> int:
    if wanted is None:
        return 0
    if wanted not in values:
        raise ValueError(f"{name}: {wanted:g}, allowed {', '.join(f'{v:g}' for v in values)}")
    return values.index(wanted)


def _figures_line(f: Figures) -> str:
    power = 10.0 * math.log10(max(f.received_power.value, 1e-300) / 1e-3)
    interval = f"{f.ber.low:.2e}..{f.ber.high:.2e}"
    return (
        f"{f.depth:>5g} m{f.bit_rate / 1e6:>8g}{power:>10.2f}{f.margin_optical_db.value:>19.2f}"
        f"{f.margin_electrical_db.value:>12.2f}{f.ber.value:>13.3e}{interval:>22}"
        f"{f.outage.value:>9.2g}{f.photons_per_bit.value:>13.4g}{f.capacity.hard / 1e6:>17.4g}"
    )


def _range_text(found: Estimate) -> str:
    if math.isnan(found.value):
        return "not between the depths computed"
    return f"{found.value:.1f} m  ({found.low:.1f}..{found.high:.1f})"


def _range(depths: tuple[float, ...], ber: FloatArray, target: float) -> float:
    from scipy.special import ndtri

    quality = -ndtri(np.clip(ber, 1e-300, 0.5 - 1e-12))
    try:
        return depth_at(depths, quality, -float(ndtri(target)))
    except ValueError:  # no crossing, or a single depth
        return math.nan


def link_performance(
    link: Link,
    sea: SurfaceModel | None = None,
    *,
    wind_speed: float | None = None,
    bit_rate: float | Sequence[float] | None = None,
    ook: OokLink | Preset = "physical",
    limit: float = 1e-3,
    realizations: int = 200,
    photons: int = 2048,
    depths: Sequence[float] | None = None,
    uav: Uav | None = None,
    wind: Dryden | None = None,
    coupled: bool = False,
    time_step: float = 0.5,
    seed: int = 1,
    confidence: float = 0.95,
    spacing: float | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> LinkPerformance:
    """Return error rate, outage, margin and capacity of a link over a random sea.

    BER = E[BER(P h h_alpha)],  h from forced detection over independent seas

    Parameters
    ----------
    link : Link
        The link, with one receiver in the air. Bubbles and whitecaps are its own, see `in_wind`.
    sea : SurfaceModel, optional
        The sea; by default the JONSWAP sea of `wind_speed`, flat where that is 0. A sea without
        random phases is taken once, at time 0.
    wind_speed : float, optional
        Wind at 10 m [m s-1] for the default sea (5 if not given) and the default `wind`.
    bit_rate : float or sequence of float, optional
        R_b [bit s-1], by default that of `ook`.
    ook : OokLink or {"physical", "paper", "paper-ranges"}
        Transmitter electronics and receiver. "physical" is model W behind etendue-limited optics.
        "paper-ranges" is an empirical calibration (`LinkPerformance.status`): water.a is doubled.
    limit : float
        Bit error rate before decoding that counts as success, see `budget.FEC_LIMITS`.
    realizations : int
        Independent seas, or times of a coupled series, >= 2.
    photons : int
        Chains, common to all seas.
    depths : sequence of float, optional
        Depths of the transmitter [m], rising; by default that of the link.
    uav : Uav, optional
        Airframe that carries the receiver; none for a receiver at rest.
    wind : Dryden, optional
        Wind at the UAV, by default of `wind_speed` at the height of the receiver.
    coupled : bool
        Whether the tilt acts on every photon (`coupled_series`) rather than as factor h_alpha.
    time_step : float
        Time between the realizations of a coupled series [s].
    seed : int
        Seed of chains, phases, gusts and bootstrap.
    confidence : float
        Level of the intervals.
    spacing, threads
        As in `simulate`.
    progress : callable, optional
        Called with 1 after each sea.

    Returns
    -------
    LinkPerformance

    Raises
    ------
    ValueError
        If an option is out of range or does not fit the others.

    Notes
    -----
    Intervals hold the spread of the seas (bootstrap for the error rate, Wilson for the outage) and
    the Monte Carlo error that all seas have in common, by evaluating the figures at gains shifted
    by that error; the two are added in quadrature. With a UAV, 50 tilts are drawn for each sea.
    Of a coupled series as many times count as its gains are worth (`fading.effective_samples`).

    All depths use the same phases and random numbers, so that curves are smooth.

    Examples
    --------
    >>> from meshtrace.surfaces import FlatSea
    >>> performance = link_performance(Link(), FlatSea(), photons=1024)
    >>> f"{performance.at().margin_optical_db.value:.0f} dB optical"
    '35 dB optical'
    """
    _check(limit, realizations, confidence, coupled, uav)
    sea, speed = _sea(sea, wind_speed, uav is not None and wind is None)
    height = _receiver(link).height
    rates = (None,) if bit_rate is None else [float(r) for r in np.atleast_1d(bit_rate)]
    ooks = tuple(ook_link(link, ook, rate) for rate in rates)
    wind = wind or Dryden(wind_speed=speed, height=height)
    flown = None if uav is None else (uav, wind)
    options = {"photons": photons, "spacing": spacing, "threads": threads, "progress": progress}
    recipe = _Recipe(sea, realizations, flown, coupled, time_step, seed, options)
    links = _links(channel_link(link, ooks[0]), depths)
    fades = {depth: recipe.fades(at) for depth, at in links.items()}
    figures = [
        _figures(one, depth, faded, limit, confidence, seed)
        for depth, faded in fades.items()
        for one in ooks
    ]
    origin = {
        **next(iter(fades.values())).series.provenance,
        "ook": [one.model_dump(mode="json") for one in ooks],
        "uav": uav.model_dump(mode="json") if uav else None,
        "wind": wind.model_dump(mode="json") if uav else None,
        "coupled": coupled,
        "realizations": realizations,
    }
    return LinkPerformance(
        depths=tuple(fades),
        ooks=ooks,
        figures=tuple(figures),
        fades=tuple(fades.values()),
        limit=limit,
        confidence=confidence,
        status=ooks[0].status,
        provenance=origin,
    )


def _check(
    limit: float, realizations: int, confidence: float, coupled: bool, uav: Uav | None
) -> None:
    if not 0.0 < limit < 0.5:
        raise ValueError(f"limit: {limit}, allowed 0 < limit < 0.5")
    if not 2 <= realizations <= 10_000_000:
        raise ValueError(f"realizations: {realizations}, allowed 2 <= realizations <= 10000000")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: {confidence}, allowed 0 < confidence < 1")
    if coupled and uav is None:
        raise ValueError("coupled: True without uav, allowed with a Uav that tilts the receiver")


def _sea(
    sea: SurfaceModel | None, wind_speed: float | None, needed: bool
) -> tuple[SurfaceModel, float]:
    """Return the sea, and the wind speed that gusts follow."""
    if sea is not None:
        if needed and wind_speed is None:
            raise ValueError("wind_speed: None, allowed with sea and uav: a speed, or a wind")
        return sea, wind_speed or 0.0
    from meshtrace.scenario import Scenario

    speed = 5.0 if wind_speed is None else wind_speed
    return Scenario.from_config({"wind_speed": speed}).surface, speed


def _links(link: Link, depths: Sequence[float] | None) -> dict[float, Link]:
    """Return the link at each depth."""
    if depths is None:
        return {float(getattr(link.transmitters[0], "depth", math.nan)): link}
    values = [float(d) for d in depths]
    if not values or not all(a < b for a, b in pairwise(values)):
        raise ValueError(f"depths: {depths}, allowed at least one depth, strictly rising [m]")
    return {d: _at_depth(link, d) for d in values}


def _figures(
    ook: OokLink, depth: float, fades: Fades, limit: float, confidence: float, seed: int
) -> Figures:
    """Return all figures of one bit rate at one depth."""
    from scipy.special import ndtri

    quantile = float(ndtri(0.5 + 0.5 * confidence))
    gain = fades.mean_gain(quantile)
    power = Estimate(*ook.received_power(gain).tolist())
    budget = link_budget(ook, gain, limit)
    low, high = ook.led.levels(power)
    photons = 0.5 * (low + high) / (ook.bit_rate * photon_energy(ook.led.wavelength))
    return Figures(
        depth=depth,
        bit_rate=ook.bit_rate,
        gain=gain,
        received_power=power,
        required_power=ook.required_power(limit),
        photons_per_bit=Estimate(*photons.tolist()),
        margin_optical_db=Estimate(*budget.margin_optical_db.tolist()),
        margin_electrical_db=Estimate(*budget.margin_electrical_db.tolist()),
        ber=_average_ber(ook, fades, quantile, confidence, seed),
        outage=_outage(ook, fades, limit, quantile, confidence),
        capacity=_capacity(ook, fades.samples),
    )


def _average_ber(
    ook: OokLink, fades: Fades, quantile: float, confidence: float, seed: int
) -> Estimate:
    """Return the error rate, its intervals joined in the logarithm.

    The interval of the seas is a percentile bootstrap, stretched for correlated times.
    """
    bers = [
        _independent(_ber_of_gains(ook, fades.samples * math.exp(step * fades.chain_error)))
        for step in (0.0, quantile, -quantile)
    ]
    rows, (mean, brighter, darker) = bers[0], (float(ber.mean()) for ber in bers)
    if mean == 0.0:
        return Estimate(mean, mean, mean)
    rng = np.random.default_rng(seed)
    means = [rows[rng.integers(0, rows.size, rows.size)].mean() for _ in range(_RESAMPLES)]
    limits = np.quantile(means, [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence])
    low, high = mean * (limits / mean) ** math.sqrt(rows.size / fades.n_effective)
    values = (mean, min(low, mean), max(high, mean), brighter, darker)
    logs = _joined(*(math.log(max(value, 1e-300)) for value in values))
    return Estimate(*(math.exp(value) for value in logs))


def _outage(
    ook: OokLink, fades: Fades, limit: float, quantile: float, confidence: float
) -> Estimate:
    """Return the outage; its Wilson interval counts what tilts and seas are worth together."""
    samples, needed = fades.samples, required_gain(ook, limit)
    missed = [
        samples * math.exp(step * fades.chain_error) < needed for step in (0.0, quantile, -quantile)
    ]
    share, brighter, darker = (float(m.mean()) for m in missed)
    over_seas = Estimate(share, share, share)
    if samples.size > 1 and samples.any():
        n, rows = fades.n_effective, _independent(missed[0].astype(float))
        if 0.0 < share < 1.0 and rows.var() > 0.0:
            n *= max(share * (1.0 - share) / float(rows.var()), 1.0)
        n = min(n, float(samples.size))
        over_seas = outage(ook, samples, limit, n_effective=n, confidence=confidence)
    value, low, high = _joined(*over_seas, brighter, darker)
    return Estimate(value, max(low, 0.0), min(high, 1.0))


def _joined(value: float, low: float, high: float, brighter: float, darker: float) -> Estimate:
    """Return an interval with that of an independent error added in quadrature."""
    return Estimate(
        value,
        value - math.hypot(value - low, value - brighter),
        value + math.hypot(high - value, darker - value),
    )


def _capacity(ook: OokLink, gain: FloatArray) -> Capacity:
    """Return the capacity; of very many gains, from the quantiles of their law."""
    if gain.size > _QUANTILES:
        gain = np.quantile(gain, (np.arange(_QUANTILES) + 0.5) / _QUANTILES)
    return capacity(ook, gain)


# --- curves over depth ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DepthSweep:
    """Performance over depth, for several winds.

    Attributes
    ----------
    wind_speeds : tuple of float
        Winds at 10 m [m s-1].
    performances : tuple of LinkPerformance
        One for each wind.
    """

    wind_speeds: tuple[float, ...]
    performances: tuple[LinkPerformance, ...]

    def range_at_ber(self, ber: float | None = None) -> FloatArray:
        """Return ranges with their limits [m].

        Parameters
        ----------
        ber : float, optional
            See `LinkPerformance.range_at_ber`.

        Returns
        -------
        ndarray, shape (winds, bit_rates, 3)
        """
        return np.array([p.range_at_ber(ber) for p in self.performances])

    def summary(self) -> str:
        """Return the ranges of all winds and bit rates as a text for the terminal."""
        first = self.performances[0]
        percent = f"{100.0 * first.confidence:g} %"
        lines = [f"range at BER {first.limit:g} ({percent} interval)"]
        for speed, performance in zip(self.wind_speeds, self.performances, strict=True):
            found = zip(performance.bit_rates, performance.range_at_ber(), strict=True)
            for rate, value in found:
                lines.append(f"{speed:>5g} m/s{rate / 1e6:>7g} Mbit/s  {_range_text(value)}")
        return "\n".join([*lines, "", first.status])

    def to_dataset(self) -> xr.Dataset:
        """Return all figures as an xarray Dataset over wind, depth and bit rate."""
        import xarray as xr

        from meshtrace.fields import attrs

        parts = [p.to_dataset() for p in self.performances]
        winds = xr.Variable("wind_speed", list(self.wind_speeds), attrs("wind_speed"))
        whole = xr.concat(parts, winds, data_vars="all", join="exact", combine_attrs="override")
        origins = [p.provenance for p in self.performances]
        return whole.assign_attrs(kind="depth-sweep", provenance=json.dumps(origins))

    def save(self, path: str | Path) -> None:
        """Write all figures as netCDF."""
        self.to_dataset().to_netcdf(path, engine="h5netcdf")


def depth_sweep(
    link: Link,
    depths: Sequence[float] = SWEEP_DEPTHS,
    *,
    bit_rate: float | Sequence[float] = (1e6, 5e6, 1e7),
    wind_speeds: Sequence[float] = (0.0, 5.0, 13.0),
    realizations: int = 50,
    **options: Any,
) -> DepthSweep:
    """Return the curves of the bit error rate over depth, each with its confidence band.

    Parameters
    ----------
    link : Link
        The link; sea, bubbles and whitecaps follow each wind (`in_wind`).
    depths : sequence of float
        Depths of the transmitter [m], rising.
    bit_rate : float or sequence of float
        R_b [bit s-1].
    wind_speeds : sequence of float
        Winds at 10 m [m s-1]; 0 is a flat sea.
    realizations : int
        Seas at each depth.
    **options
        As in `link_performance`: `ook`, `limit`, `photons`, `uav`, `coupled`, `seed`, ...

    Returns
    -------
    DepthSweep

    Examples
    --------
    >>> sweep = depth_sweep(Link(), [50.0, 55.0, 60.0], bit_rate=1e6, wind_speeds=[0.0])
    >>> f"{sweep.range_at_ber()[0, 0, 0]:.0f} m"
    '55 m'
    """
    performances = [
        link_performance(
            in_wind(link, speed),
            wind_speed=speed,
            bit_rate=bit_rate,
            depths=depths,
            realizations=realizations,
            **options,
        )
        for speed in wind_speeds
    ]
    return DepthSweep(tuple(float(u) for u in wind_speeds), tuple(performances))
