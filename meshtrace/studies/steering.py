"""Beams that a tracker steers: their axes and spots in time, by refraction at the exact sea."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.checks import Seed, check_call
from meshtrace.errors import Described, Refused, require_finite
from meshtrace.fading.pointing import LEAST_NOISE, Wander, sample_lags
from meshtrace.link import Link, Tracker, WaterSource
from meshtrace.mesh import SurfaceModel
from meshtrace.models import Floats
from meshtrace.optics.fresnel import refract
from meshtrace.surfaces.waves import WaveComponents, sum_waves

_MOST_SAMPLES = 10**7
_LEAST = {"slope": LEAST_NOISE, "spot": 1e-3}  # share of noise that predictors count on
_SETTLING = 3  # latencies before the first frame, after which a held beam follows the sea
_STREAM = 0x7472  # of the noise: another one than that of the wind from the same seed
_NODES = 6  # Gauss-Hermite nodes of the footprint along each axis: waves down to 1.5 radii
_STEP, _NEWTON = 1e-4, 12  # [rad] of the derivatives over level water; steps of Newton's method
_HALVINGS, _STARTS = 6, 30  # of a step of Newton's method; further starts of it
_TIE = 1e-6  # share of a sample by which rounding may set times apart that are equal


class Steering(NamedTuple):
    """Axis of a beam and its spot in time.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Times [s].
    axis : ndarray, shape (n, 3)
        Unit vectors of the emission.
    spot : ndarray, shape (n, 2)
        Place (x, y) of the refracted axis in the plane of the receiver, from its centre [m]; nan
        where the sea reflects the beam.
    """

    time: Floats
    axis: Floats
    spot: Floats


@check_call
def steer(link: Link, surface: SurfaceModel, times: ArrayLike, seed: Seed = 1) -> Steering:
    r"""Return the axis of a tracked beam, and its spot, over a moving sea.

    Parameters
    ----------
    link : Link
        A link of one beam, to a receiver on the other side of the surface, of several the first.
        A beam without a `Tracker` keeps its axis.
    surface : SurfaceModel
        The sea.
    times : array_like, shape (n,)
        Increasing times [s].
    seed : int
        Seed of the noise of the tracker.

    Returns
    -------
    Steering

    Raises
    ------
    Refused
        If there are several lamps, or one that is no beam, both ends lie on one side, the tracker
        predicts over a sea that is no sum of plane waves, or there are more than 10^7 samples.

    Notes
    -----
    The axis meets the sea at its exact height and is refracted there by the slope averaged over the
    footprint, of the irradiance exp(-2 r^2 / w^2) with the radius w of the beam at still water,
    that of the disk for a top-hat beam.

    A steered beam crosses elsewhere: by d u for a lamp at the depth d. A tracker that sees slopes
    knows those of the whole surface, and finds the turn that would have hit; its spot is off by the
    change of the slope at one place, as in `fading.pointing_residual`. One that sees the spot knows
    the slope where the beam crossed alone. It follows while

    .. math:: g = \beta \sqrt{\langle (\partial s / \partial x)^2 \rangle} \ll 1, \quad
              \beta = (n - 1) h d / (d + n h)

    (`loop_gain` of a design). Beyond, the sea sends light to the receiver from several places at
    once: the spot leaves before the next correction, whatever the latency.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import TiltedPlane
    >>> beam = mt.GaussianBeam(depth=1.0, tracker=mt.Tracker())
    >>> link, sea = mt.Link(transmitter=beam), TiltedPlane(slope_x=0.05)
    >>> bool(abs(steer(link, sea, [0.0]).spot).max() < 1e-3)
    True
    """
    at = require_finite(times, "times", "increasing times (n,) [s]")
    _require_increasing(at)
    return _Beam([link] * len(at), surface, at).steering(seed)


def tracker_of(link: Link) -> Tracker | None:
    """Return the tracker of a link's beam; refuse one among several beams."""
    trackers = [getattr(source, "tracker", None) for source in link.transmitters]
    if len(trackers) > 1 and any(trackers):
        raise Refused("transmitter", Described(f"{len(trackers)} sources"), "one, with a tracker")
    return trackers[0]


def axes_of(links: Sequence[Link], surface: Any, times: Floats, seed: int) -> Floats:
    """Return the axes (n, 3) of the tracked beam of links at increasing times (n,) [s]."""
    if not isinstance(surface, SurfaceModel):
        kind = Described(type(surface).__name__)
        raise Refused("surface", kind, "a sea (SurfaceModel) under a beam with a tracker")
    _require_increasing(times)
    return _Beam(links, surface, times).steering(seed).axis


def with_axes(links: Sequence[Link], axes: Floats) -> list[Link]:
    """Return links with other axes (n, 3) of their only beam."""
    changed = []
    for link, (x, y, z) in zip(links, axes.tolist(), strict=True):
        beam: Any = link.transmitters[0]
        water = isinstance(beam, WaterSource)
        names = ("zenith_deg", "azimuth_deg") if water else ("tilt_deg", "tilt_azimuth_deg")
        lean = math.degrees(math.atan2(math.hypot(x, y), z if water else -z))
        values = dict(zip(names, (lean, math.degrees(math.atan2(y, x))), strict=True))
        turned = beam.model_copy(update=values)
        several = isinstance(link.transmitter, tuple)
        changed.append(link.model_copy(update={"transmitter": (turned,) if several else turned}))
    return changed


def _require_increasing(times: Floats) -> None:
    if np.any(np.diff(times) <= 0.0):
        raise Refused("times", Described("in another order"), "increasing times [s]")


class _Beam:
    """Beam of a link whose ends move, over a sea; u (2,) are the components of its turn."""

    def __init__(self, links: Sequence[Link], surface: Any, times: Floats) -> None:
        link = links[0]
        self.tracker = tracker_of(link)
        link.require_chains()
        if not hasattr(link.transmitters[0], "tracker"):
            raise Refused("transmitter", Described(link.transmitters[0].kind), "a beam")
        if not link.receivers:
            raise Refused("receiver", (), "at least one")
        self._surface, self._times = surface, times
        n = link.water.n, link.n_air
        self._indices = n if link.direction == "up" else n[::-1]
        pairs = [(k.transmitters[0], k.receivers[0]) for k in links]
        # lamp, receiver and axis at each time: shape (n, 3, 3)
        self._ends = np.array([(beam.center, end.center, beam.axis) for beam, end in pairs])
        self._ends_rest = not np.ptp(self._ends, axis=0).any()
        beam: Any = pairs[0][0]
        x, y, z = beam.axis
        if z * beam.center[2] >= 0.0:
            raise Refused("transmitter", Described("an axis away from the sea"), "one towards it")
        # across the axis: the direction nearest to +x, and the one square to both
        first = np.array([1.0 - x * x, -x * y, -x * z]) if abs(x) < 0.9 else np.array([-z, 0.0, x])
        first /= np.linalg.norm(first)
        self._across = np.stack([first, np.cross(beam.axis, first)])
        spread = abs(beam.center[2] / z) * math.tan(math.radians(min(beam.divergence_deg, 89.0)))
        self.radius = math.hypot(beam.size, spread)
        nodes, weights = np.polynomial.hermite.hermgauss(_NODES)
        # the weight exp(-2 r^2 / w^2) is that of Hermite's rule at r = w x / sqrt(2)
        nodes *= self.radius / math.sqrt(2.0)
        self._nodes = np.stack([np.repeat(nodes, _NODES), np.tile(nodes, _NODES)])
        self._weights = np.outer(weights, weights).ravel() / math.pi
        waves = None if getattr(surface, "choppy", False) else getattr(surface, "components", None)
        # plane waves are averaged in closed form, which takes one point in place of all nodes
        if waves is not None:  # over the footprint: exp(-k^2 w^2 / 8) of the amplitude
            k2 = waves.kx**2 + waves.ky**2
            footprint = np.exp(-0.125 * k2 * self.radius**2)
            waves = waves._replace(amplitude=waves.amplitude * footprint)
        self._waves = waves
        self._predicted = self._waves

    def _at(self, time: float) -> Floats:
        """Return lamp, receiver and axis at a time (3, 3), interpolated between frames."""
        i = int(np.searchsorted(self._times, time))
        if self._ends_rest or i in (0, len(self._times)):
            return np.asarray(self._ends[min(i, len(self._times) - 1)])
        t0, t1 = self._times[i - 1 : i + 1]
        share = (time - t0) / (t1 - t0)
        return np.asarray(self._ends[i - 1] + share * (self._ends[i] - self._ends[i - 1]))

    def _turned(self, axis: Floats, u: Floats) -> Floats:
        """Return the unit vector of an axis turned by u."""
        turned = axis + u @ self._across
        return np.asarray(turned / np.linalg.norm(turned))

    def _slope(self, at: Floats, time: float, waves: WaveComponents | None) -> Floats:
        """Return the slope over the footprint at a place (x, y, ...)."""
        if waves is not None:
            return np.array([float(s) for s in sum_waves(waves, 1, at[0], at[1], time)])
        slopes = np.stack(self._surface.slopes(*(at[:2, None] + self._nodes), time))
        return np.asarray(slopes @ self._weights)

    def _crossing(self, lamp: Floats, axis: Floats, time: float) -> Floats:
        """Return where an axis meets the sea."""
        height = 0.0
        for _ in range(3):  # each step is exact to the slope times the tangent of the axis
            x, y, _z = lamp + (height - lamp[2]) / axis[2] * axis
            height = float(self._surface.elevation(x, y, time))
        return np.asarray(lamp + (height - lamp[2]) / axis[2] * axis)

    def _spot(self, crossing: Floats, slope: Floats, axis: Floats, end: Floats) -> Floats:
        """Return the spot of an axis refracted at a slope, from the centre of the receiver."""
        normal = np.array([-slope[0], -slope[1], 1.0])
        way = refract(axis, normal / np.linalg.norm(normal), *self._indices)
        return np.asarray((crossing + (end[2] - crossing[2]) / way[2] * way - end)[:2])

    def _aim(
        self, ends: Floats, u: Floats, slope: Floats, height: float = 0.0, time: float | None = None
    ) -> Floats:
        """Return u that hits the receiver, by Newton's method from a first u.

        At a time over the sea, whose slope is that of the predicted waves and the noise `slope`;
        else over a sea that has the slope and the height wherever light crosses it.
        """
        lamp, end, axis = ends

        def miss(u: Floats) -> Floats:
            turned = self._turned(axis, u)
            if time is None:
                at = lamp + (height - lamp[2]) / turned[2] * turned
                return self._spot(at, slope, turned, end)
            at = self._crossing(lamp, turned, time)
            return self._spot(at, self._slope(at, time, self._predicted) + slope, turned, end)

        # Strongly refracting seas send light to the receiver from many places, between which folds
        # end a search: it starts anew on rings about the first place, of widening footprints.
        ring = np.exp(2j * math.pi * np.arange(_STARTS) / 6.0) * (1.0 + np.arange(_STARTS) // 6)
        starts = (
            np.stack([ring.real, ring.imag], axis=1) * 2.0 * max(self.radius, 1e-3) / abs(lamp[2])
        )
        best, least = u, math.inf
        for start in [u, *(u + starts)] if time is not None else [u]:
            turned, distance = _newton(miss, start, 1e-6 * abs(end[2]))
            if distance < least:
                best, least = turned, distance
            if least <= 1e-6 * abs(end[2]):
                break
        return best

    def _coefficients(self) -> Floats:
        """Return the weights of the samples in a correction, newest first."""
        t = self.tracker
        assert t is not None
        if t.predictor == "hold":
            return np.ones(1)
        if self._waves is None:
            raise Refused("tracker.predictor", t.predictor, "hold, over no sum of plane waves")
        waves = self._waves
        k = np.stack([waves.kx, waves.ky])
        wander = Wander(waves.omega, 0.5 * (waves.amplitude * k) ** 2)
        noise = 2.0 * self._noise() ** 2 / float(wander.variance.sum())
        a = wander.coefficients(t.latency, t.sample, max(noise, _LEAST[t.sees]))
        if t.sees == "slope":
            # each wave of the prediction is that of the sea times sum_j a_j exp(-i omega j T)
            ages = np.outer(waves.omega, sample_lags(t.sample))
            cosine, sine = np.cos(ages) @ a, np.sin(ages) @ a
            amplitude = waves.amplitude * np.hypot(cosine, sine)
            phase = waves.phase - np.arctan2(sine, cosine)
            self._predicted = waves._replace(amplitude=amplitude, phase=phase)
        return a

    def _noise(self) -> float:
        """Return the standard deviation of the noise of a measured slope component."""
        t = self.tracker
        assert t is not None
        noise = math.tan(math.radians(t.noise_deg))
        # a slope s turns vertical light by (n1 / n2 - 1) s
        turn = abs(self._indices[0] / self._indices[1] - 1.0)
        return noise / turn if t.sees == "spot" else noise

    def _sample_times(self, past: int) -> Floats:
        """Return the times (m,) of the samples that the frames need, in order."""
        t, times = self.tracker, self._times
        assert t is not None
        if t.sees == "slope" and t.rate_deg_s is None:
            # what is seen does not depend on where the beam was
            before = t.latency
        else:
            before = _SETTLING * t.latency + past * t.sample
        if times[-1] - times[0] + before > _MOST_SAMPLES * t.sample:
            raise Refused("tracker.sample", t.sample, f"at most {_MOST_SAMPLES:,} samples")
        first = np.floor((times - before) / t.sample + _TIE).astype(np.int64)
        last = np.floor((times - t.latency) / t.sample + _TIE).astype(np.int64)
        # each frame has a run of samples, which may overlap that of the frame before
        first[1:] = np.maximum(first[1:], last[:-1] + 1)
        runs = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
        return t.sample * np.concatenate(runs)

    def steering(self, seed: int) -> Steering:
        """Return the axes and spots of the beam at the times."""
        if self.tracker is None:
            return self._record(np.zeros((len(self._times), 2)))
        t, a = self.tracker, self._coefficients()
        samples = self._sample_times(len(a))
        numbers = np.round(samples / t.sample).astype(np.int64)
        first = numbers[0] - len(a) + 1  # a number for each sample of the past, too
        noise = (
            np.random.default_rng((seed, _STREAM)).standard_normal((numbers[-1] - first + 1, 2))
            * self._noise()
        )
        level, past, last = np.zeros(2), deque[Floats](maxlen=len(a)), -math.inf
        mirror, u_frames = _Mirror(t, self._aim(self._at(self._times[0]), level, level)), []
        i, slope = 0, level
        # in the order of time, a sample before a frame at the same time
        order = np.argsort(np.append(samples, self._times + _TIE * t.sample), kind="stable")
        events = np.append(samples, self._times)[order].tolist()
        for time, is_frame in zip(events, (order >= len(samples)).tolist(), strict=True):
            u = mirror.at(time)
            if is_frame:
                u_frames.append(u)
                continue
            ends, number, i = self._at(time), int(numbers[i] - first), i + 1
            if t.sees == "slope":
                e = a @ noise[number - len(a) + 1 : number + 1][::-1]
                mirror.command(time + t.latency, self._aim(ends, mirror.target, e, time=time))
                continue
            turned = self._turned(ends[2], u)
            crossing = self._crossing(ends[0], turned, time)
            seen = self._slope(crossing, time, self._waves)
            # a beam that the sea reflects shows no spot: the last slope stands
            if np.isfinite(self._spot(crossing, seen, turned, ends[1])).all():
                slope = seen + noise[number]
            if time - last > 1.5 * t.sample:
                past.clear()
            past.appendleft(slope)
            last = time
            # a predictor of a past that it has not seen would throw the beam off the sea
            expected = a @ np.array(past) if len(past) == len(a) else slope
            mirror.command(time + t.latency, self._aim(ends, u, expected, crossing[2]))
        return self._record(np.array(u_frames))

    def _record(self, u: Floats) -> Steering:
        """Return the axes turned by u (n, 2), and their spots."""
        axes, spots = [], []
        for time, turn in zip(self._times.tolist(), u, strict=True):
            lamp, end, axis = self._at(time)
            axes.append(self._turned(axis, turn))
            at = self._crossing(lamp, axes[-1], time)
            spots.append(self._spot(at, self._slope(at, time, self._waves), axes[-1], end))
        return Steering(self._times, np.array(axes), np.array(spots))


def _newton(miss: Callable[[Floats], Floats], u: Floats, tolerance: float) -> tuple[Floats, float]:
    """Minimise the norm of a function of u (2,) from a first guess; return u and the norm."""
    y = miss(u)
    distance = float(np.linalg.norm(y))
    for _ in range(_NEWTON):
        if not distance > tolerance:
            break
        columns = [(miss(u + du) - y) / _STEP for du in _STEP * np.eye(2)]
        step = np.linalg.lstsq(np.nan_to_num(np.stack(columns, axis=1)), y)[0]
        # halved until it comes nearer: refraction by a curved sea is far from linear
        for halving in range(_HALVINGS):
            nearer = u - 0.5**halving * step
            y = miss(nearer)
            if float(np.linalg.norm(y)) < distance:
                break
        else:
            break
        u, distance = nearer, float(np.linalg.norm(y))
    return u, distance if math.isfinite(distance) else math.inf


class _Mirror:
    """Mirror of a tracker: turns by u (2,), within its range and at its speed."""

    def __init__(self, tracker: Tracker, u: Floats) -> None:
        self._range = math.tan(math.radians(tracker.range_deg or 90.0))
        self._rate = math.radians(tracker.rate_deg_s or math.inf)
        self._u = self.target = self._within(u)
        self._tie = _TIE * tracker.sample
        self._since, self._commands = -math.inf, deque[tuple[float, Floats]]()

    def _within(self, u: Floats) -> Floats:
        return u * min(1.0, self._range / max(float(np.linalg.norm(u)), 1e-300))

    def command(self, time: float, target: Floats) -> None:
        """Turn towards a target from a time on; times of commands increase."""
        self._commands.append((time, self._within(target)))

    def at(self, time: float) -> Floats:
        """Return u at a time [s]; times must not decrease between calls."""
        while self._commands and self._commands[0][0] <= time + self._tie:
            since, target = self._commands.popleft()
            self._u, self._since, self.target = self._turned(since), since, target
        return self._turned(time)

    def _turned(self, time: float) -> Floats:
        """Return u at a time on the way to the target."""
        way = self.target - self._u
        angle = float(np.linalg.norm(way))
        if angle == 0.0 or self._rate == math.inf:
            return self.target
        return self._u + way * min(1.0, self._rate * max(time - self._since, 0.0) / angle)
