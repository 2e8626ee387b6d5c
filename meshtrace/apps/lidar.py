"""Lidar through waves: the waveform that comes back to the air, and depths read from it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field
from scipy.ndimage import gaussian_filter1d

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
from meshtrace.engine.setup.options import resolve
from meshtrace.errors import Described, Refused
from meshtrace.mesh import SeededSurface
from meshtrace.models import Floats
from meshtrace.results.tallies import SPEED_OF_LIGHT, error_of_groups, sums_by_group
from meshtrace.scenario import Scenario
from meshtrace.stored import Stored, Variable
from meshtrace.studies.campaign import realization_seed

ECHOES = {"surface": 3, "column": 1, "bottom": 4}
"""Echoes by the last event of their light, as numbers of `ArrivalTally.part`."""

_FINE = 16  # samples of a pulse's full width at half maximum, at which depths are read
_BLANK = 1.5  # pulse widths after the echo of the surface, before which no bottom is looked for
_GRAVITY = 9.81  # [m s-2], of the dispersion omega^2 = g k of waves in deep water
_MOST_SAMPLES = 10**6  # at which depths are read: light so late is left out
_WIDTHS = 6.0  # pulse widths of the waveform beyond the deepest light


@dataclass(frozen=True, eq=False, repr=False)
class LidarResult(Stored, kind="lidar", title="meshtrace lidar waveform"):
    """Waveform of the light that comes back to the air, and depths read from it.

    Attributes
    ----------
    delay_edges : ndarray, shape (n + 1,)
        Edges of the bins of the delay after the echo of still water [s].
    echo, echo_stderr : ndarray, shape (3, n)
        Received share of the emitted energy in each bin, mean over the seas: surface, column and
        bottom; and its standard error, by seas, or by groups of samples for a single one.
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
    depth: Annotated[float, Variable(name="bottom_depth")]
    depth_by_peak: Annotated[Floats, Variable("sea")]
    depth_by_centroid: Annotated[Floats, Variable("sea")]
    pulse_width: Annotated[float, Variable()]
    provenance: dict[str, Any] = field(default_factory=dict)

    def bias(self, reading: str = "peak") -> tuple[float, float]:
        """Return the mean error of a depth over the seas, and its standard error [m].

        Parameters
        ----------
        reading : {"peak", "centroid"}
            Reading of the depth.
        """
        errors = self._errors(reading)
        stderr = float(error_of_groups(errors)) if len(errors) > 1 else math.nan
        return float(errors.mean()) if len(errors) else math.nan, stderr

    def scatter(self, reading: str = "peak") -> float:
        """Return the standard deviation of a depth from sea to sea [m]; nan for a single sea."""
        errors = self._errors(reading)
        return float(errors.std(ddof=1)) if len(errors) > 1 else math.nan

    def _errors(self, reading: str) -> Floats:
        depths = self.depth_by_peak if reading == "peak" else self.depth_by_centroid
        return depths[np.isfinite(depths)] - self.depth

    def _headline(self) -> str:
        return f"echo of the bottom {self.echo[2].sum():.3e} from {self.depth:g} m"

    def summary(self) -> str:
        """Return echoes and depths as text for a terminal."""
        seas = len(self.depth_by_peak)
        lines = []
        for name, energy, stderr in zip(ECHOES, self.echo, self.echo_stderr, strict=True):
            # bins of one sea are nearly independent: errors add up in quadrature
            error = math.sqrt(float(stderr @ stderr))
            text = f"{energy.sum():.4e} +- {error:.1e}" if energy.any() else "none"
            lines.append(f"{'echo of the ' + name:<24}{text}")
        for reading in ("peak", "centroid"):
            bias, error = self.bias(reading)
            text = f"bias {bias:+.3f} +- {error:.3f} m, scatter {self.scatter(reading):.3f} m"
            lines.append(f"{'depth by ' + reading:<24}{text}")
        lost = seas - len(self._errors("peak"))
        note = f", {lost} without an echo of the bottom" if lost else ""
        lines.append(f"{'seas':<24}{seas}{note}; bottom at {self.depth:g} m")
        return "\n".join(lines)


def _spot(link: Link) -> float:
    """Return the radius of the spot of the only lamp on still water, at nadir [m], or 0."""
    lamp = link.transmitters[0]
    spread = math.radians(min(getattr(lamp, "spread_deg", 0.0), 60.0))
    return float(lamp.size + abs(lamp.center[2]) * math.tan(spread))


class _Clock(NamedTuple):
    """Times of light along the axis of a lamp over still water."""

    surface: float  # from the lamp to the receiver by the surface [s]
    per_depth: float  # delay of the bottom after the surface per metre of depth [s m-1]

    @classmethod
    def of_link(cls, link: Link) -> _Clock:
        """Return the times of a link with one lamp and one receiver in the air."""
        lamp, end = link.transmitters[0], link.receivers[0]
        start, axis = np.array(lamp.center), np.array(lamp.axis)
        if axis[2] >= 0.0:
            raise Refused(
                "transmitter", Described("an axis that leads up"), "a lamp that looks down"
            )
        way = start[2] / -axis[2]
        back = float(np.linalg.norm(start + way * axis - np.array(end.center)))
        # Snell's law for the axis; the way back starts from the bottom at the same angle
        n = link.water.n / link.n_air
        cosine = math.sqrt(1.0 - (1.0 - axis[2] ** 2) / n**2)
        slow = 2.0 * link.water.n / (SPEED_OF_LIGHT * cosine)
        return cls(link.n_air * (way + back) / SPEED_OF_LIGHT, slow)

    def delay_of(self, depth: float) -> float:
        """Return the delay of a bottom [s]."""
        return self.per_depth * depth

    def depth_of(self, delay: float) -> float:
        """Return the depth [m] that a delay tells."""
        return delay / self.per_depth


def _delays(result: GainResult, clock: _Clock) -> tuple[Floats, Floats]:
    """Return the delays after the echo of still water [s] and the weights of all arrivals."""
    arrivals = result.arrivals
    assert arrivals is not None  # recorded
    return arrivals.time - clock.surface, arrivals.weight


def _waveform(result: GainResult, delay: Floats, edges: Floats) -> Floats:
    """Return the energy (echoes, bins, groups) of each group of samples."""
    arrivals = result.arrivals
    assert arrivals is not None
    bins = np.floor((delay - edges[0]) / (edges[1] - edges[0])).astype(int)
    inside = (bins >= 0) & (bins < len(edges) - 1)
    echoes = []
    for part in ECHOES.values():
        chosen = inside & (arrivals.part == part)
        group, weight = arrivals.group[chosen], arrivals.weight[chosen]
        echoes.append(sums_by_group(group, weight, bins[chosen], len(edges) - 1).T)
    return np.stack(echoes)


def _read(delay: Floats, weight: Floats, pulse_width: float) -> tuple[float, float]:
    """Return the delays of the peak and of the centroid of the echo of the bottom [s], or nan."""
    step, blank = pulse_width / _FINE, _BLANK * pulse_width
    late = delay > 0.0
    if not late.any():
        return math.nan, math.nan
    # samples of the energy convolved with the pulse, a Gaussian of this standard deviation
    n = math.ceil((float(delay[late].max()) + _WIDTHS * pulse_width) / step)
    samples = np.bincount((delay[late] / step).astype(int), weight[late], min(n, _MOST_SAMPLES))
    sigma = pulse_width / math.sqrt(8.0 * math.log(2.0))
    received = gaussian_filter1d(samples[:_MOST_SAMPLES], sigma / step, mode="constant")
    time = step * (np.arange(len(received)) + 0.5)
    # local maxima: the falling end of the echo of the surface is no echo of its own
    inner = received[1:-1]
    maxima = 1 + np.flatnonzero((inner > received[:-2]) & (inner >= received[2:]))
    maxima = maxima[time[maxima] > blank]
    if not len(maxima):
        return math.nan, math.nan
    top = int(maxima[received[maxima].argmax()])
    low = high = top
    while low > 0 and received[low - 1] > 0.5 * received[top]:
        low -= 1
    while high < len(received) - 1 and received[high + 1] > 0.5 * received[top]:
        high += 1
    echo = slice(low, high + 1)
    centroid = float((time[echo] * received[echo]).sum() / received[echo].sum())
    # parabola through the highest sample and its neighbours
    a, b, c = np.log(received[top - 1 : top + 2])
    return float(time[top] + 0.5 * step * (a - c) / (a - 2.0 * b + c)), centroid


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
    r"""Compute the waveform of a lidar over many seas, and the depths that it tells.

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
    Waves as short as twice the radius of the spot are resolved, unless the link file names its
    waves; shorter ones are random slopes, drawn anew at each crossing. The delay :math:`\tau`
    counts from the echo of still water on the axis of the lamp: waves lift it, too. The waveform is
    convolved with the pulse; its highest local maximum more than 1.5 pulse widths after that echo
    is that of the bottom, and the centroid is that of the peak above half its height. The depth is

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
    options: dict[str, Any] = {"photons": photons, "seed": seed, "threads": threads}
    chosen = {name: value for name, value in options.items() if value is not None}
    base = link if isinstance(link, Link) else link.link
    is_open = isinstance(link, Link) or link.meshing.waves is None
    if is_open and not isinstance(surface, TriangleMesh) and (spot := _spot(base)) > 0.0:
        # waves down to twice the radius of the spot tilt all of it; shorter ones are random slopes
        chosen["waves"] = math.sqrt(2.0 * math.pi * _GRAVITY / (2.0 * spot))
    case = resolve(link, surface, **chosen)
    link, sea = case.link, case.surface
    if link.direction != "over" or len(link.transmitters) * len(link.receivers) != 1:
        ends = ", ".join(item.kind for _, item in link.items())
        raise Refused("link", Described(ends), "one lamp and one receiver in the air")
    bottom = link.water.bottom_depth
    if bottom is None:
        raise Refused("water.bottom_depth", None, "a depth: the echo of a bottom is looked for")
    clock = _Clock.of_link(link)
    # from before the surface, whose waves scatter its echo, to some pulses after the bottom
    longest = clock.delay_of(bottom) + _WIDTHS * pulse_width
    edges: Floats = bin_width * np.arange(
        -math.ceil(_WIDTHS * pulse_width / bin_width),
        math.ceil(longest / bin_width) + 1,
        dtype=float,
    )
    waveforms, depths = [], []
    several = seas if isinstance(sea, SeededSurface) else 1
    for i in range(several):
        # the first sea is that of the link file, photons are other ones over each
        seed = realization_seed(case.run.seed, i)
        at = sea.with_seed(seed) if i and isinstance(sea, SeededSurface) else sea
        with warnings.catch_warnings():
            # of the light between the echoes; the error of the bottom's echo is in the result
            warnings.simplefilter("ignore", FewSamplesWarning)
            result = simulate(
                link, at, photons=case.run.photons, seed=seed, threads=case.run.threads,
                mesh=case.meshing, record=[Arrivals()],
            )  # fmt: skip
        if not i:
            first = result.provenance
        delay, weight = _delays(result, clock)
        waveforms.append(_waveform(result, delay, edges))
        depths.append([clock.depth_of(t) for t in _read(delay, weight, pulse_width)])
        if progress is not None:
            progress(1)
    # groups of samples of a single sea, or the seas themselves
    table = np.stack(waveforms)
    groups = table.mean(axis=-1) if several > 1 else np.moveaxis(table[0], -1, 0)
    echo, stderr = groups.mean(axis=0), error_of_groups(groups)
    # the echo of still water has no noise: the error of its quadrature is that of the gain
    quadrature = result.stderrs[0] / max(result.gains[0], 1e-300)
    stderr = np.where((stderr == 0.0) & (echo > 0.0), quadrature * echo, stderr)
    peak, centroid = np.transpose(depths)
    return LidarResult(
        delay_edges=edges,
        echo=echo,
        echo_stderr=stderr,
        depth=bottom,
        depth_by_peak=peak,
        depth_by_centroid=centroid,
        pulse_width=pulse_width,
        provenance=first,
    )
