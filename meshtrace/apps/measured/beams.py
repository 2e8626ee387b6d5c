"""Beams in water, and from water into the air."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from meshtrace import IrradianceMap, PhotonPaths, Vertex, simulate, trace_paths
from meshtrace.fading import pointing_residual
from meshtrace.link import GaussianBeam, Link, Receiver, TopHatBeam
from meshtrace.models import Floats
from meshtrace.optics import Petzold, PhaseFunction, Water
from meshtrace.optics.constituents import fournier_forand_of
from meshtrace.parallel import default_threads, ordered_map
from meshtrace.surfaces import FlatSea, JonswapSea, resolved_sea

from .suite import MeasuredRow

_CHUNK, _VERTICES, _LASER = 8192, 96, 12  # photons, vertices of each, chunks
_DEPTH, _C = 1.83, 0.7226  # [m], [m-1] of the laser in the lake
_EDGES = (0.0, 2.0, 4.0, 58.0, 180.0)  # [deg]
_GRAZING = 0.05  # least cosine at a spherical collector


@cache
def phase_of(name: str) -> PhaseFunction:
    """Return Petzold's phase function of a water, or Fournier and Forand's of b_b/b "ff 0.01"."""
    if not name.startswith("ff "):
        return Petzold.model_validate({"water": name})
    return fournier_forand_of(float(name.removeprefix("ff ")))


def through_spheres(
    paths: PhotonPaths, photons: int, center: Floats, axis: Floats, radii: Floats, a: float
) -> Floats:
    """Return the flux through spheres about the source, per photon.

    Returns
    -------
    ndarray, shape (radii, collectors, bins)
        In bins of the angle off the axis: flux (cosine collector), and flux over the cosine of
        incidence (spherical collector).
    """
    what = paths.what[:, 1:]
    # pieces in the water: those that land or are received end in the air
    flown = (what >= 0) & ~np.isin(what, (Vertex.LANDED, Vertex.RECEIVED))
    start, end = (paths.vertex[:, i:][:, : what.shape[1]][flown] - center for i in (0, 1))
    weight = paths.weight[:, :-1][flown]
    way = end - start
    length = np.linalg.norm(way, axis=1)
    way /= np.maximum(length, 1e-12)[:, None]
    along = np.einsum("ij,ij->i", start, way)
    # |x + s w|^2 = r^2, solved for the way s to the sphere, with (x . w)^2 + off = |x|^2
    off = np.einsum("ij,ij->i", start, start) - along**2
    flux = np.zeros((len(radii), 2, len(_EDGES) - 1))
    for i, r in enumerate(radii):
        reach = np.sqrt(np.maximum(r**2 - off, 0.0)) - along
        out = (off < r**2) & (reach > 0.0) & (reach <= length)
        at = start[out] + reach[out, None] * way[out]
        power = weight[out] * np.exp(-a * reach[out])
        incidence = np.einsum("ij,ij->i", at, way[out]) / r
        angle = np.degrees(np.arccos(np.clip(at @ axis / r, -1.0, 1.0)))
        # a sphere collects the same from all sides: flux over the cosine of incidence
        for j, share in enumerate((1.0, np.maximum(incidence, _GRAZING))):
            flux[i, j] = np.histogram(angle, _EDGES, weights=power / share)[0]
    return flux / photons


@cache
def laser_light(
    phase: str, a: float, divergence_mrad: float, surface: str, lengths: tuple[float, ...],
    chunks: int,
) -> Floats:  # fmt: skip
    """Return `through_spheres` of each chunk for a horizontal laser, at attenuation lengths."""
    # deep enough that no light meets the surface
    depth = _DEPTH if surface == "flat" else 1000.0
    divergence = math.degrees(1e-3 * divergence_mrad)
    beam = TopHatBeam(depth=depth, zenith_deg=90.0, divergence_deg=divergence)
    water = Water(a=a, b=_C - a, phase=phase_of(phase))
    link, mesh = Link(water=water, transmitter=beam), FlatSea().mesh(0.0, 2000.0, 500.0)

    def chunk(seed: int) -> Floats:
        paths = trace_paths(
            link, mesh, _CHUNK, seed=seed, max_vertices=_VERTICES, max_events=_VERTICES,
            roulette=1e-3,
        )  # fmt: skip
        center, axis = np.array([0.0, 0.0, -depth]), np.array(beam.axis)
        return through_spheres(paths, _CHUNK, center, axis, np.array(lengths) / _C, a)

    return np.array(list(ordered_map(chunk, range(1, chunks + 1), default_threads())))


def share_of(part: Floats, whole: Floats) -> tuple[float, float]:
    """Return sum(part) / sum(whole) of independent chunks, and its standard error."""
    # the variance of a ratio of means by its linear expansion
    share, n = part.sum() / whole.sum(), len(part)
    return share, math.sqrt(n / (n - 1.0) * ((part - share * whole) ** 2).sum()) / whole.sum()


def laser_shares(
    row: MeasuredRow, photons: float, phase: str, half_angle: float, whole: str, collector: str,
    divergence: float, surface: str, a: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the share of the power within a cone, at attenuation lengths `at`."""
    chunks = max(int(_LASER * photons), 8)
    power = laser_light(phase, a, divergence, surface, row.along, chunks)
    mine = power[:, row.along.index(row.at), ("cosine", "sphere").index(collector)]
    cone = mine[:, : _EDGES.index(half_angle)].sum(axis=1)
    return share_of(cone, mine[:, : 3 if whole == "58 deg" else 4].sum(axis=1))


_HEIGHT, _LAMP = 300.0, 2.4  # [m], of the map of the light in the air; [m-1]
_LAMP_PHOTONS, _LAMP_SEAS = 2**15, 4


@cache
def pattern_in_air(
    lengths: float, albedo: float, phase: str, wind: float, half_angle: float, photons: int
) -> tuple[float, float]:
    """Return the half width at half maximum of the intensity in the air, and its error [deg]."""
    lamp = TopHatBeam(depth=lengths / _LAMP, divergence_deg=half_angle)
    b = albedo * _LAMP
    water = Water(a=_LAMP - b, b=b, phase=phase_of(phase))
    link = Link(water=water, transmitter=lamp, receiver=Receiver(height=_HEIGHT))
    extent = _HEIGHT * math.tan(math.radians(60.0))
    plane = IrradianceMap(height=_HEIGHT, extent=extent, step=2.0)
    widths = []
    for seed in range(1, _LAMP_SEAS + 1):
        sea = JonswapSea(wind_speed=wind, seed=seed)
        run = simulate(link, sea, estimator="analog", photons=photons, seed=seed, record=[plane])
        assert run.map is not None
        radius = np.hypot(*np.meshgrid(run.map.x, run.map.y, indexing="ij"))
        angle = np.degrees(np.arctan(radius / _HEIGHT))
        widths.append(half_width(angle.ravel(), run.map.irradiance.ravel()))
    return float(np.mean(widths)), float(np.std(widths, ddof=1) / math.sqrt(len(widths)))


def half_width(angle: Floats, power: Floats) -> float:
    """Return the half width at half maximum [deg] of the intensity of a map.

    Means over rings of an eighth of the angle that holds half of the power; the maximum is the
    mean of the inner two.
    """
    order = np.argsort(angle)
    sums = np.cumsum(power[order])
    median = angle[order][np.searchsorted(sums, 0.5 * sums[-1])]
    # rings in proportion to the pattern, whatever its width
    edges = np.linspace(0.0, 4.0 * median, 33)
    in_rings = np.histogram(angle, edges, weights=power)[0]
    profile = in_rings / -np.diff(np.cos(np.radians(edges)))
    half, middle = 0.5 * profile[:2].mean(), 0.5 * (edges[1:] + edges[:-1])
    last = max(int(np.argmax(profile < half)), 1)
    pair = slice(last - 1, last + 1)
    return float(np.interp(-half, -profile[pair], middle[pair]))


def lamp_widths(
    row: MeasuredRow, photons: float, albedo: float, phase: str, wind_speed: float,
    half_angle: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the width of the light pattern in the air at a depth of `at` attenuation lengths."""
    n = max(int(_LAMP_PHOTONS * photons), 2**14)
    return pattern_in_air(row.at, albedo, phase, wind_speed, half_angle, n)


_GEOMETRIES = {  # depth, height [m], bit rate [s-1]
    "sun-pool": (2.3, 3.5, 44e6),
    "sun-wide": (5.0, 5.0, 9e6),
    "chen-up": (21.0, 5.0, 5.5e9),
    "fu": (3.25, 3.2, 5e6),
    "amphilight": (3.0, 3.1, 5.04e6),
}
_QUANTUM = 6.626e-34 * 2.998e8  # [J m]


@cache
def link_gain(depth: float, height: float, divergence: float, radius: float, c: float) -> float:
    """Return the unscattered gain of a link over still water."""
    beam = GaussianBeam(depth=depth, divergence_deg=divergence)
    receiver = Receiver(height=height, radius=radius)
    link = Link(water=Water(a=c, b=0.0), transmitter=beam, receiver=receiver)
    return float(simulate(link, FlatSea(), photons=64).gain)


def link_margins(
    row: MeasuredRow, photons: float, power_mw: float, divergence: float, radius: float, c: float,
    photons_per_bit: float,
) -> float:  # fmt: skip
    """Return the margin of the received photons of a bit over the needed ones [dB]."""
    depth, height, rate = _GEOMETRIES[row.series]
    gain = link_gain(depth, height, divergence, radius, c)
    # photons = energy of a bit over that of a photon of 520 nm
    bit = gain * 1e-3 * power_mw / rate * 520e-9 / _QUANTUM
    return 10.0 * math.log10(bit / photons_per_bit)


_TRACKED = {"di": (0.75, 0.34), "xu": (None, math.radians(28.0))}  # loss without, [rad s-1]


def tracked_loss(
    row: MeasuredRow, photons: float, latency: float, slope: float, untracked_percent: float,
    radius: float,
) -> float:  # fmt: skip
    """Return the packet loss of a tracked beam [%] from its residual and the loss of a fixed one.

    The spot of a round Gaussian law is off by more than R with P = exp(-R^2 / (2 sigma^2)): a share
    of the variance that is left raises the loss without tracking to the power of its inverse.
    """
    loss, rate = _TRACKED.get(row.series, _TRACKED["di"])
    if row.series == "sea":
        left = pointing_residual(resolved_sea(5.0), latency, radius)
    else:
        # the mean length of a change is sqrt(pi / 2) of the deviation of a component; slopes of a
        # Gaussian correlation, which forget themselves
        turn = rate / math.sqrt(0.5 * math.pi) * latency / slope
        left = -2.0 * math.expm1(-0.5 * turn**2)
    return 100.0 * (loss or 0.01 * untracked_percent) ** (1.0 / left)
