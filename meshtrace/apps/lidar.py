"""Lidar through waves: the waveform of the returning light, and depths read from it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks, peak_widths

from meshtrace import (
    Arrivals,
    FewSamplesWarning,
    GainResult,
    Link,
    MeshSource,
    TriangleMesh,
    simulate,
)
from meshtrace.checks import Positive, check_call
from meshtrace.engine.setup.options import Case
from meshtrace.errors import Described, Refused
from meshtrace.link.link import spot_radius
from meshtrace.mesh import SeededSurface
from meshtrace.models import Floats
from meshtrace.parallel import paced
from meshtrace.results.tallies import (
    ONE_SIDE_PARTS,
    SPEED_OF_LIGHT,
    ArrivalTally,
    error_of_groups,
    sums_by_group,
)
from meshtrace.scenario import Scenario
from meshtrace.stored import Stored, Variable
from meshtrace.studies.campaign import case_of, realization_seed
from meshtrace.surfaces.waves import angular_frequency

ECHOES = {"surface": "mirrored", "column": "scattered", "bottom": "bottom"}
"""Names of the echoes, and of the parts of the light that they consist of."""

Reading = Literal["peak", "centroid"]

_PER_WIDTH = 16  # samples per full width of the pulse; tuned: a parabola refines the peak
_BLANK = 1.5  # pulse widths after the surface in which no bottom is looked for; tuned: light there
_MOST_SAMPLES = 10**6  # of one sea, bounds memory: light that comes later is left out
_MARGIN = 6.0  # pulse widths before the surface and after the bottom; a Gaussian has ended there


@dataclass(frozen=True, eq=False, repr=False)
class LidarResult(Stored, kind="lidar", title="meshtrace lidar waveform"):
    """Waveform of the light that returns to the air, and depths read from it.

    Attributes
    ----------
    delay_edges : ndarray, shape (n + 1,)
        Edges of the bins of the delay after the echo of still water [s].
    echo, echo_stderr : ndarray, shape (3, n)
        Received share of the emitted energy in each bin, mean over the seas, of the echoes in the
        order of `ECHOES`; and its standard error: from the scatter between seas, or for a single
        sea between independent groups of photons.
    energy, energy_stderr : ndarray, shape (3,)
        The same of each whole echo, with light before and after the bins.
    depth : float
        Depth of the bottom [m].
    depth_by_peak, depth_by_centroid : ndarray, shape (seas,)
        Depth read from the waveform of each sea [m], nan where no echo stands out.
    pulse_width : float
        Full width at half maximum of the laser pulse [s].
    provenance : dict
        Versions, configuration and seeds of the first sea.
    """

    delay_edges: Annotated[Floats, Variable("bin_edge", name="delay_edges")]
    echo: Annotated[Floats, Variable("echo_of", "bin")]
    echo_stderr: Annotated[Floats, Variable("echo_of", "bin")]
    energy: Annotated[Floats, Variable("echo_of", name="echo_energy")]
    energy_stderr: Annotated[Floats, Variable("echo_of", name="echo_energy_stderr")]
    depth: Annotated[float, Variable(name="bottom_depth")]
    depth_by_peak: Annotated[Floats, Variable("sea")]
    depth_by_centroid: Annotated[Floats, Variable("sea")]
    pulse_width: Annotated[float, Variable()]
    provenance: dict[str, Any] = field(default_factory=dict)

    def bias(self, reading: Reading = "peak") -> tuple[float, float]:
        """Return the mean error of a depth over the seas, and its standard error [m].

        Parameters
        ----------
        reading : {"peak", "centroid"}
            Reading of the depth.

        Raises
        ------
        Refused
            If there is no such reading.
        """
        errors = self._errors(reading)
        stderr = float(error_of_groups(errors)) if len(errors) > 1 else math.nan
        return float(errors.mean()) if len(errors) else math.nan, stderr

    def scatter(self, reading: Reading = "peak") -> float:
        """Return the standard deviation of a depth from sea to sea [m]; nan for a single sea."""
        errors = self._errors(reading)
        return float(errors.std(ddof=1)) if len(errors) > 1 else math.nan

    def _errors(self, reading: Reading) -> Floats:
        depths = self.depth_by_peak if reading == "peak" else self.depth_by_centroid
        return depths[np.isfinite(depths)] - self.depth

    def _headline(self) -> str:
        return f"echo of the bottom {self.energy[2]:.3e} from {self.depth:g} m"

    def summary(self) -> str:
        """Return echoes and depths as text for a terminal."""
        seas = len(self.depth_by_peak)
        lines = []
        for name, energy, stderr in zip(ECHOES, self.energy, self.energy_stderr, strict=True):
            text = f"{energy:.4e} +- {stderr:.1e}" if energy else "none"
            lines.append(f"{'echo of the ' + name:<24}{text}")
        for reading in get_args(Reading):
            bias, error = self.bias(reading)
            text = "no echo" if math.isnan(bias) else f"error {bias:+.3f} m"
            if math.isfinite(error):
                text = f"bias {bias:+.3f} +- {error:.3f} m, scatter {self.scatter(reading):.3f} m"
            lines.append(f"{'depth by ' + reading:<24}{text}")
        lost = seas - len(self._errors("peak"))
        note = f", {lost} without an echo of the bottom" if lost else ""
        lines.append(f"{'seas':<24}{seas}{note}; bottom at {self.depth:g} m")
        return "\n".join(lines)


def _with_waves_of(sea: Any, spot: float) -> Any:
    """Return a sea with all waves longer than a spot [m], unless the user chose its waves.

    Such waves tilt the whole spot and shift its echo. The default band of a sea is that of mean
    gains: it leaves some of them to random slopes, which are drawn for each photon and average out.
    """
    # random seas alone have a band, whose end is open unless one of these is given
    if not hasattr(type(sea), "band") or sea.omega_max is not None or sea.waves is not None:
        return sea
    omega = float(angular_frequency(2.0 * math.pi / spot))  # 0 for the infinite spot of a lamp
    return sea.model_copy(update={"omega_max": omega}) if omega > sea.band.omega_max else sea


def _times_on_axis(link: Link) -> tuple[float, float]:
    """Return the time [s] to still water and back, and the further delay per metre of depth.

    The way leads along the axis of the lamp to the surface and from there to the receiver.
    """
    lamp, receiver = link.transmitters[0], link.receivers[0]
    start, axis = np.array(lamp.center), np.array(lamp.axis)
    if axis[2] >= 0.0:
        raise Refused("transmitter", Described("an axis that leads up"), "a lamp that looks down")
    down = start[2] / -axis[2]
    up = float(np.linalg.norm(start + down * axis - np.array(receiver.center)))
    n = link.water.n / link.n_air
    # angle of refraction of the axis by Snell's law; of a telescope beside the lamp both ways
    # in the water are the same: twice the depth over this cosine
    cos_water = math.sqrt(1.0 - (1.0 - axis[2] ** 2) / n**2)
    per_depth = 2.0 * link.water.n / (SPEED_OF_LIGHT * cos_water)
    return link.n_air * (down + up) / SPEED_OF_LIGHT, per_depth


def _echo_of_sea(case: Case, sea: Any, i: int, several: bool) -> GainResult:
    """Return the run over the i-th sea, with its arrivals."""
    # the first sea is the one that the user gave; each has photons of its own
    seed = realization_seed(case.run.seed, i)
    with warnings.catch_warnings():
        # the effective number is that of the whole gain, most of it glint; the result has the
        # error of each echo
        warnings.simplefilter("ignore", FewSamplesWarning)
        if several:  # errors of meshes, which the glint has, are far below its scatter
            warnings.filterwarnings("ignore", ".*the mesh causes an error")
        return simulate(
            case.link, sea.with_seed(seed) if i else sea, photons=case.run.photons, seed=seed,
            threads=case.run.threads, mesh=case.meshing, record=[Arrivals()],
        )  # fmt: skip


def _waveform(arrivals: ArrivalTally, delay: Floats, edges: Floats) -> Floats:
    """Return the energy (echoes, bins + 1, groups) by independent group of photons.

    Each group alone estimates the echo. The last bin holds all light outside of the edges, so that
    bins add up to the whole echo.
    """
    bins = np.floor((delay - edges[0]) / (edges[1] - edges[0]))
    bins = np.where((bins >= 0) & (bins < len(edges) - 1), bins, len(edges) - 1).astype(int)
    echoes = []
    for part in ECHOES.values():
        chosen = arrivals.part == ONE_SIDE_PARTS[part]
        group, weight = arrivals.group[chosen], arrivals.weight[chosen]
        echoes.append(sums_by_group(group, weight, bins[chosen], len(edges)).T)
    return np.stack(echoes)


def _bottom_delays(
    arrivals: ArrivalTally, delay: Floats, pulse_width: float
) -> tuple[float, float]:
    """Return the delays of the peak and of the centroid of the echo of the bottom [s], or nan.

    They are read as from a record, in which the echo of the surface alone is known as such.
    """
    step, mirrored = pulse_width / _PER_WIDTH, arrivals.part == ONE_SIDE_PARTS["mirrored"]
    # a crest or trough shifts the echo of the surface, and with it the start of that of the column
    surface = (
        np.average(delay[mirrored], weights=arrivals.weight[mirrored]) if mirrored.any() else 0.0
    )
    # without the echo of the surface, by far the brightest
    below = ~mirrored & (delay > 0.0)
    if not below.any():
        return math.nan, math.nan
    n = min(math.ceil((float(delay[below].max()) + _MARGIN * pulse_width) / step), _MOST_SAMPLES)
    samples = np.bincount((delay[below] / step).astype(int), arrivals.weight[below], n)[:n]
    # standard deviation of a Gaussian of this full width at half maximum
    sigma = pulse_width / math.sqrt(8.0 * math.log(2.0))
    received = gaussian_filter1d(samples, sigma / step, mode="constant")
    times = step * (np.arange(n) + 0.5)
    peaks, properties = find_peaks(received, prominence=0.0)
    after = times[peaks] > surface + _BLANK * pulse_width
    if not after.any():
        return math.nan, math.nan
    # by prominence: the column is brighter below the surface, but it has no end there
    top = int(peaks[after][properties["prominences"][after].argmax()])
    _, _, left, right = peak_widths(received, [top], rel_height=0.5)
    echo = slice(math.floor(left[0]), math.ceil(right[0]) + 1)
    centroid = float(np.average(times[echo], weights=received[echo]))
    # parabola through the logarithms of the highest sample and its neighbours: exact for a Gaussian
    a, b, c = np.log(received[top - 1 : top + 2])
    return float(times[top] + 0.5 * step * (a - c) / (a - 2.0 * b + c)), centroid


@check_call
def lidar(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    *,
    seas: Annotated[int, Field(ge=1, le=100_000)] = 16,
    bin_width: Positive = 1e-9,
    pulse_width: Positive = 1.5e-9,
    photons: int | None = None,
    seed: int | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> LidarResult:
    r"""Compute the waveform of a lidar over many seas, and read depths from it.

    Parameters
    ----------
    link : Link or Scenario
        A lamp and a receiver in the air over water with a bottom.
    surface : MeshSource or TriangleMesh, optional
        A sea; by default the JONSWAP sea of the link's wind.
    seas : int
        Seas of independent phases, 1 <= seas <= 100 000; one for a surface without random phases.
    bin_width : float
        Width of the bins of the waveform [s], > 0.
    pulse_width : float
        Full width at half maximum of the Gaussian laser pulse [s], > 0, of the depths.
    photons, seed, threads : int, optional
        As in `simulate`.
    progress : callable, optional
        Called with the number of seas done since its last call.

    Returns
    -------
    LidarResult

    Raises
    ------
    Refused
        If lamp or receiver are not in the air, there are several of them, or no bottom.

    Notes
    -----
    Waves as short as the spot of the beam are resolved, unless the sea names its waves; shorter
    ones are random slopes, drawn anew at each crossing. The delay :math:`\tau` counts from the echo
    of still water on the axis of the lamp. The echo of the surface is taken off, as by a channel in
    the infrared. The rest is convolved with the pulse; its most prominent peak more than 1.5 pulse
    widths after the surface is that of the bottom, and the centroid that of the peak above half of
    its prominence. For a lamp and a receiver beside each other the depth is

    .. math:: D = \frac{c_0 \tau \cos\theta_w}{2 n}

    with the angle of refraction of the axis :math:`\theta_w`. The phase velocity is used both ways.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> link = mt.Link(
    ...     water=mt.Water(a=0.114, b=0.037, bottom_depth=10.0, bottom_albedo=0.15),
    ...     transmitter=mt.AirTopHatBeam(height=300.0, divergence_deg=0.0286),
    ...     receiver=mt.Receiver(height=300.0, radius=0.1, fov_deg=0.286),
    ... )
    >>> result = mt.lidar(link, FlatSea(), photons=512)
    >>> bool(abs(result.bias("centroid")[0]) < 0.02)
    True
    """
    case = case_of(link, surface, {"photons": photons, "seed": seed, "threads": threads})
    link = case.link
    if link.direction != "over" or len(link.transmitters) * len(link.receivers) != 1:
        ends = ", ".join(item.kind for _, item in link.items())
        raise Refused("link", Described(ends), "one lamp and one receiver in the air")
    bottom = link.water.bottom_depth
    if bottom is None:
        raise Refused("water.bottom_depth", None, "a depth: the echo of a bottom is looked for")
    sea = _with_waves_of(case.surface, spot_radius(link.transmitters[0]))
    surface_time, per_depth = _times_on_axis(link)
    # from before the echo of still water, as crests are higher, to some pulses after the bottom
    before = math.ceil(_MARGIN * pulse_width / bin_width)
    after = math.ceil((per_depth * bottom + _MARGIN * pulse_width) / bin_width)
    edges: Floats = bin_width * np.arange(-before, after + 1, dtype=float)
    waveforms, depths = list[Floats](), list[list[float]]()
    # a surface without random phases is the same every time
    n_seas = seas if isinstance(sea, SeededSurface) else 1
    runs = (_echo_of_sea(case, sea, i, n_seas > 1) for i in range(n_seas))
    for result in paced(runs, n_seas, f"{n_seas:,} seas"):
        if not waveforms:
            first = result
        arrivals = result.arrivals
        assert arrivals is not None  # recorded
        delay = arrivals.time - surface_time
        waveforms.append(_waveform(arrivals, delay, edges))
        depths.append([t / per_depth for t in _bottom_delays(arrivals, delay, pulse_width)])
        if progress is not None:
            progress(1)
    # (independent estimates, echoes, bins + 1): by sea, or by group of photons of the only sea
    by_sea = np.stack(waveforms)
    groups = by_sea.mean(axis=-1) if n_seas > 1 else np.moveaxis(by_sea[0], -1, 0)
    # the glint of smooth water has no Monte Carlo noise: its error is that of a quadrature, as that
    # of the gain, which is glint for the most part
    quadrature = first.stderrs[0] / max(first.gains[0], 1e-300)
    echo, echo_stderr = _mean(groups[..., :-1], quadrature)
    energy, energy_stderr = _mean(groups.sum(axis=-1), quadrature)
    peak, centroid = np.transpose(depths)
    return LidarResult(
        delay_edges=edges,
        echo=echo,
        echo_stderr=echo_stderr,
        energy=energy,
        energy_stderr=energy_stderr,
        depth=bottom,
        depth_by_peak=peak,
        depth_by_centroid=centroid,
        pulse_width=pulse_width,
        provenance=first.provenance,
    )


def _mean(groups: Floats, quadrature: float) -> tuple[Floats, Floats]:
    """Return the mean over groups and its error, the relative one of a quadrature without noise."""
    mean, stderr = groups.mean(axis=0), error_of_groups(groups)
    return mean, np.where((stderr == 0.0) & (mean > 0.0), quadrature * mean, stderr)
