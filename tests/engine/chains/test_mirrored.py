"""Unscattered light that the surface mirrors, against closed forms and points on all facets.

The other way: random points on every facet, the reflected ray of each with its interpolated normal,
a ray to lamp and receiver for shadows, all in numpy; only the rays are Embree's.
"""

import dataclasses
import functools
import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak
from scipy import stats

import meshtrace as mt
from meshtrace.engine.chains import aimed
from meshtrace.engine.setup import ends
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea

CLEAR = mt.Water(a=0.114, b=0.037, n=1.33)
CHUNKS = 16
LIMIT = stats.t.isf(sidak(ALPHA, 40) / 2.0, CHUNKS - 1)
FLAT = FlatSea().mesh(extent=60.0, spacing=0.5)


def mirrored(link, mesh, unresolved="none"):
    """Return the light that the surface mirrors, and its stated error."""
    chains = aimed.AimedChains(ends.forced_link(link), mesh, "vertex", unresolved)
    assert chains.blurred == (unresolved == "tilt")
    gain = float(chains.direct_light(0, 0)[0])
    return gain, gain * chains.relative_error(0, 0)


def intensity(lamp, cosine):
    """Return the intensity [sr-1] of a Lambertian lamp or of a top hat."""
    order = getattr(lamp, "order", None)
    if order is not None:
        return (order + 1.0) / (2.0 * math.pi) * np.maximum(cosine, 0.0) ** order
    edge = math.cos(math.radians(lamp.divergence_deg))
    return (cosine >= edge) / (2.0 * math.pi * (1.0 - edge))


def fresnel(cosine, n1, n2):
    """Return the unpolarised reflectance."""
    sine2 = (n1 / n2) ** 2 * (1.0 - cosine**2)
    behind = np.sqrt(np.maximum(1.0 - sine2, 0.0))
    s = (n1 * cosine - n2 * behind) / (n1 * cosine + n2 * behind)
    p = (n2 * cosine - n1 * behind) / (n2 * cosine + n1 * behind)
    return np.where(sine2 >= 1.0, 1.0, 0.5 * (s * s + p * p))


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def is_free(intersector, start, end):
    """Return whether no facet lies between points; both are left out."""
    way = end - start
    distance = intersector.intersect(start + 1e-4 * way, 0.9998 * way).distance
    return distance > 1.0


def by_points(link, mesh, within, each=4, slopes=(0.0, 0.0), seed=5):
    """Return mean and standard error over `CHUNKS` sets of random points on all facets.

    `within` is (x, y, half), a square that holds the crossings; `each` points on every facet, with
    random slopes of standard deviations `slopes` along x and y.
    """
    rng, lamp, receiver = np.random.default_rng(seed), link.transmitter, link.receiver
    start, center, axis = np.array(lamp.center), np.array(receiver.center), np.array(receiver.axis)
    under = start[2] < 0.0
    n1, n2 = (link.water.n, link.n_air) if under else (link.n_air, link.water.n)
    corners = mesh.vertices[mesh.faces]
    near = np.abs(corners[:, :, :2].mean(axis=1) - within[:2]).max(axis=1) < within[2]
    corners, normals = corners[near], mesh.vertex_normals[mesh.faces][near]
    facets = mesh.face_normals[near]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    intersector, sums = mt.EmbreeIntersector(mesh, 1), []
    for _ in range(CHUNKS):
        total = 0.0
        for _ in range(each):
            u, v = rng.random((2, len(corners)))
            u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
            weights = np.stack([1.0 - u - v, u, v], axis=1)[..., None]
            p, n = (weights * corners).sum(axis=1), unit((weights * normals).sum(axis=1))
            way = p - start
            length = np.linalg.norm(way, axis=1)
            d = way / length[:, None]
            exposed = np.ones(len(p))
            if slopes[0] > 0.0:
                tilt = rng.normal(size=(len(p), 2)) * slopes
                exposed = 1.0 - n[:, 2] * (d[:, :2] * tilt).sum(axis=1) / (d * n).sum(axis=1)
                exposed = np.clip(exposed, 0.0, 2.0)
                slope = -n[:, :2] / n[:, 2:] + tilt
                n = unit(np.concatenate([-slope, np.ones((len(p), 1))], axis=1))
            onto, facing = (d * n).sum(axis=1), (d * facets).sum(axis=1)
            r = d - 2.0 * onto[:, None] * n
            ahead = r @ axis
            with np.errstate(divide="ignore", invalid="ignore"):
                flight = ((center - p) @ axis) / ahead
                at = p + flight[:, None] * r
                hit = np.linalg.norm(at - center, axis=1) <= receiver.radius
            side = 1.0 if under else -1.0
            hit &= (side * onto > 0.0) & (side * facing > 0.0) & (ahead > 0.0) & (flight > 0.0)
            hit &= ahead >= math.cos(math.radians(receiver.fov_deg) / 2.0) - 1e-12
            i = np.flatnonzero(hit)
            i = i[is_free(intersector, np.broadcast_to(start, (len(i), 3)), p[i])]
            i = i[is_free(intersector, p[i], at[i])]
            light = intensity(lamp, d[i] @ np.array(lamp.axis)) * exposed[i]
            light *= fresnel(np.abs(onto[i]), n1, n2) * area[i] * np.abs(facing[i]) / length[i] ** 2
            if under:
                light = light * np.exp(-link.water.c * (length[i] + flight[i]))
            total += light.sum()
        sums.append(total / each)
    return np.mean(sums), np.std(sums, ddof=1) / math.sqrt(CHUNKS)


def under(depth=5.0, end=3.0, aside=4.0, radius=0.4, tilt=0.0, fov=180.0, zenith=0.0, half=60.0,
          lamp=mt.Led):  # fmt: skip
    """Return a link under water along x; a tilted receiver leans towards the lamp."""
    spread = {"half_angle_deg" if lamp is mt.Led else "divergence_deg": half}
    return mt.Link(
        water=CLEAR,
        transmitter=lamp(depth=depth, zenith_deg=zenith, **spread),
        receiver=mt.WaterReceiver(
            depth=end, position=(aside, 0.0), radius=radius, fov_deg=fov, tilt_deg=tilt,
            tilt_azimuth_deg=180.0,
        ),
    )  # fmt: skip


def over(height=5.0, end=3.0, aside=4.0, radius=0.4, tilt=0.0, fov=180.0, lean=0.0, half=60.0,
         lamp=mt.AirLed):  # fmt: skip
    """Return a link over the sea along x; a tilted receiver leans towards the lamp."""
    spread = {"half_angle_deg" if lamp is mt.AirLed else "divergence_deg": half}
    return mt.Link(
        water=CLEAR,
        transmitter=lamp(height=height, tilt_deg=lean, **spread),
        receiver=mt.Receiver(
            height=end, position=(aside, 0.0), radius=radius, fov_deg=fov, tilt_deg=tilt,
            tilt_azimuth_deg=180.0,
        ),
    )  # fmt: skip


LINKS = {
    "under, up": under(),
    "under, narrow view": under(fov=40.0, tilt=30.0),
    "under, sideways": under(zenith=60.0, tilt=90.0, half=30.0),
    "under, from behind": under(zenith=60.0, tilt=120.0, half=40.0, radius=0.8),
    "under, wide": under(radius=3.0, aside=2.0, end=5.0),
    "under, beam": under(zenith=30.0, half=4.0, lamp=mt.TopHatBeam, aside=5.0),
    "under, near": under(depth=1.2, end=1.0, aside=3.0, zenith=50.0, half=30.0),
    "under, total reflection": under(depth=2.0, end=2.0, aside=4.0 * math.tan(0.85), zenith=48.0),
    "over, down": over(),
    "over, narrow view": over(fov=40.0, tilt=30.0),
    "over, sideways": over(lean=60.0, tilt=90.0, half=30.0),
    "over, wide": over(radius=3.0, aside=2.0, end=5.0),
    "over, beam": over(lean=30.0, half=4.0, lamp=mt.AirTopHatBeam, aside=5.0),
    "over, near": over(height=1.5, end=1.2, aside=5.0, lean=60.0, half=30.0),
}


@functools.cache
def sea_mesh(name):
    sea = {
        "sinusoid": SinusoidalSea(amplitude=0.1, wavelength=2.5),
        "steep": SinusoidalSea(amplitude=0.25, wavelength=3.0),
        "jonswap": JonswapSea(wind_speed=6.0, seed=4),
    }[name]
    return sea.mesh(center=(2.0, 0.0), extent=14.0, spacing=0.1, fine_extent=6.0,
                    coarse_spacing=0.2)  # fmt: skip


@pytest.mark.parametrize(
    ("link", "gain"),
    [
        (under(end=3.0, aside=12.0, radius=0.1), 1.67619e-6),  # case A of any-link.md
        (
            under(depth=4.0, end=4.0, aside=10.0, zenith=90.0, half=10.0, tilt=90.0, radius=0.05),
            5.45954e-10,  # case C
        ),
    ],
)
def test_still_water(link, gain):
    value, error = mirrored(link, FLAT)
    # closed forms take the light for even over the disk
    assert value == pytest.approx(gain, rel=2e-5)
    assert error < 1e-4 * value


def compare(link, mesh, slopes=(0.0, 0.0), each=1):
    """Return (gain - points) over the error of both."""
    value, error = mirrored(link, mesh, "tilt" if slopes[0] > 0.0 else "none")
    mean, stderr = by_points(link, mesh, (2.0, 0.0, 13.0), each, slopes)
    if mean == 0.0:
        assert value == 0.0
        return 0.0
    z = (value - mean) / math.hypot(stderr, error)
    print(
        f"{value:.5e} +- {error / value:.1e}, points {mean:.5e} +- {stderr / mean:.2%}, z {z:.2f}"
    )
    assert stderr < 0.12 * mean
    return z


SHOWN = "under, up", "under, beam", "under, total reflection", "over, sideways"


def with_seas(*seas):
    """Return all pairs of a link and a sea; but for one of some links, by turns, they are slow."""
    pairs = [
        pytest.param(name, sea, marks=(pytest.mark.slow, pytest.mark.thorough)[shown])
        for i, name in enumerate(LINKS)
        for k, sea in enumerate(seas)
        for shown in [name in SHOWN and i % len(seas) == k]
    ]
    return pytest.mark.parametrize(("name", "sea"), pairs)


@with_seas("sinusoid", "steep", "jonswap")
def test_waves(name, sea):
    """Shadows, caustics, views, flat light and total reflection over smooth waves."""
    assert abs(compare(LINKS[name], sea_mesh(sea), each=2)) < LIMIT


@with_seas("steep", "jonswap")
def test_random_slopes(name, sea):
    """Random slopes along and across the wind on top of those of the waves."""
    slopes, mesh = (0.12, 0.08), sea_mesh(sea)
    variances = slopes[0] ** 2, slopes[1] ** 2
    mesh = dataclasses.replace(mesh, unresolved=UnresolvedSlopes(variances, variances))
    # most points send their light elsewhere
    assert abs(compare(LINKS[name], mesh, slopes, each=4)) < LIMIT


def test_random_slopes_of_a_level_sea():
    """Midpoints of a grid of the surface, each with the one slope that leads to the receiver."""
    link, deviation = under(radius=0.1), 0.1
    variances = deviation**2, deviation**2
    mesh = dataclasses.replace(FLAT, unresolved=UnresolvedSlopes(variances, variances))
    step = 0.04
    x = np.arange(-25.0, 25.0, step) + 0.5 * step
    p = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((len(x), len(x)))], axis=-1)
    way, on = p - np.array(link.transmitter.center), np.array(link.receiver.center) - p
    length, flight = np.linalg.norm(way, axis=-1), np.linalg.norm(on, axis=-1)
    d, r = way / length[..., None], on / flight[..., None]
    normal = unit(d - r)
    slope = -normal[..., :2] / normal[..., 2:]
    density = np.exp(-0.5 * (slope**2).sum(axis=-1) / deviation**2)
    density /= 2.0 * math.pi * deviation**2
    cosine = (normal * d).sum(axis=-1)
    # dOmega_r = 4 cos(i) dOmega_n, and ds = dOmega_n / n_z^3
    per_solid_angle = density / (4.0 * cosine * normal[..., 2] ** 3)
    exposed = np.clip(1.0 - (d[..., :2] * slope).sum(axis=-1) / d[..., 2], 0.0, 2.0)
    light = intensity(link.transmitter, d[..., 2]) * d[..., 2] / length**2 * exposed
    light *= fresnel(cosine, 1.33, 1.0) * per_solid_angle * np.abs(r[..., 2]) / flight**2
    light *= np.exp(-link.water.c * (length + flight))
    expected = light.sum() * step**2 * math.pi * 0.1**2
    value, error = mirrored(link, mesh, "tilt")
    print(value, error, expected)
    assert value == pytest.approx(expected, rel=3e-4)


def test_one_wave_hides_the_light_of_another():
    """Light that the far side of a crest mirrors does not pass through the crest."""
    # a lamp among the crests of waves of 2 m lights all of the slope that faces it
    sea = SinusoidalSea(amplitude=0.4, wavelength=4.0)
    mesh = sea.mesh(center=(2.0, 0.0), extent=14.0, spacing=0.08, fine_extent=6.0,
                    coarse_spacing=0.2)  # fmt: skip
    links = (
        over(height=0.7, end=0.7, aside=5.0, lean=80.0, half=30.0, tilt=80.0),
        under(depth=0.7, end=0.7, aside=5.0, zenith=80.0, half=30.0, tilt=80.0),
    )
    for link in links:
        assert abs(compare(link, mesh, each=2)) < LIMIT


@pytest.mark.parametrize("half_deg", [0.001, 0.01, 0.1])
@pytest.mark.parametrize(
    "kinds", [(mt.TopHatBeam, mt.AirTopHatBeam), (mt.GaussianBeam, mt.AirBeam)]
)
@pytest.mark.parametrize("is_under", [True, False])
def test_narrow_beam(half_deg, kinds, is_under):
    """All of a beam narrower than a facet goes the way of its central ray."""
    mesh, make = sea_mesh("sinusoid"), under if is_under else over
    angle = {"zenith": 30.0} if is_under else {"lean": 30.0}
    link = make(half=half_deg, lamp=kinds[not is_under], **angle)
    start, d = np.array(link.transmitter.center), np.array(link.transmitter.axis)
    hits = mt.EmbreeIntersector(mesh, 1).intersect(start[None], d[None])
    corners = mesh.faces[hits.facet[0]]
    u, v = hits.u[0], hits.v[0]
    n = unit(np.array([1.0 - u - v, u, v]) @ mesh.vertex_normals[corners])
    p = start + hits.distance[0] * d
    r = d - 2.0 * (d @ n) * n
    end = p + ((-3.0 if is_under else 3.0) - p[2]) / r[2] * r
    link = make(half=half_deg, lamp=kinds[not is_under], aside=end[0], radius=0.3, **angle)
    link = link.replace("receiver.position", tuple(end[:2]))
    indices = (1.33, 1.0) if is_under else (1.0, 1.33)
    expected = float(fresnel(np.array(abs(d @ n)), *indices))
    if is_under:
        expected *= math.exp(-link.water.c * float(hits.distance[0] + np.linalg.norm(end - p)))
    value, error = mirrored(link, mesh)
    print(value, error, expected)
    # the waves spread a beam of 0.1 degrees over a centimetre, of other reflectance
    assert abs(value - expected) < error + (1e-6 if half_deg < 0.1 else 1e-3) * expected
