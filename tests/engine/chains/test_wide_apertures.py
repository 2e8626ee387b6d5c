"""Unscattered light over random slopes onto apertures that the field of view covers in part.

Over still water a plain integral over directions of the lamp and points of the aperture is the
reference, elsewhere analog photons over the same mesh: neither shares the parts of facets.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy import stats

import meshtrace as mt
from meshtrace.engine import correlated
from meshtrace.engine.chains import aimed
from meshtrace.engine.forced import ForcedDetection
from meshtrace.engine.setup import ends, meshing
from meshtrace.errors import DomainWarning
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.optics import fresnel_reflectance
from meshtrace.results.tallies import error_of_groups
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea

VARIANCES = 0.0411, 0.0280
CLEAR = mt.Water(b=0.0)


def wide_link(fov_deg, radius=3.0, height=20.0, depth=10.0):
    return mt.Link(
        water=CLEAR,
        transmitter=mt.Led(depth=depth, half_angle_deg=2.0),
        receiver=mt.Receiver(height=height, radius=radius, fov_deg=fov_deg),
    )


def rough_still_water(spacing, variances=VARIANCES, extent=8.0, direction_deg=0.0):
    flat = FlatSea().mesh(extent=extent, spacing=spacing)
    rough = UnresolvedSlopes(variances, variances, direction_deg)
    return mt.TriangleMesh(flat.vertices, flat.faces, flat.vertex_normals, rough)


def still_gain(link, variances=VARIANCES, nodes=48):
    """Return the unscattered gain over still water with random slopes, of ends on one axis.

    gain = int dOmega I exp(-a L) int dx p(s(P, x)) |det ds/dx| E T, x on the aperture within
    H tan(fov / 2) of the crossing P = (X, Y): rows y by y = mean + half sin(pi u / 2), and chords
    in x, with Gauss's nodes of u and x.
    """
    lamp, end, n = link.transmitter, link.receiver, link.water.n
    order, radius, height = lamp.order, end.radius, end.height
    seen = height * math.tan(math.radians(end.fov_deg / 2.0))
    u, weight = np.polynomial.legendre.leggauss(nodes)
    polar, share = np.polynomial.legendre.leggauss(32)
    darkest = math.acos(math.exp(-16.0 / order))
    azimuths = 2.0 * math.pi * (np.arange(24) + 0.5) / 24
    total = 0.0
    for angle, part in zip(0.5 * darkest * (polar + 1.0), 0.5 * darkest * share, strict=True):
        light = (order + 1.0) / (2.0 * math.pi) * math.cos(angle) ** order
        light *= math.sin(angle) * part * 2.0 * math.pi / 24
        light *= math.exp(-link.water.a * lamp.depth / math.cos(angle))
        for azimuth in azimuths:
            d = math.sin(angle) * np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
            d[2] = math.cos(angle)
            px, py, _ = lamp.depth / d[2] * d
            low, high = max(-radius, py - seen), min(radius, py + seen)
            if low >= high:
                continue
            y = 0.5 * (low + high) + 0.5 * (high - low) * np.sin(0.5 * math.pi * u)
            rows = 0.25 * math.pi * (high - low) * np.cos(0.5 * math.pi * u) * weight
            rim = np.sqrt(np.maximum(radius**2 - y**2, 0.0))
            edge = np.sqrt(np.maximum(seen**2 - (y - py) ** 2, 0.0))
            west, east = np.maximum(-rim, px - edge), np.minimum(rim, px + edge)
            half = np.maximum(0.5 * (east - west), 0.0)
            x = 0.5 * (west + east)[:, None] + half[:, None] * u
            off = np.stack([x - px, np.broadcast_to((y - py)[:, None], x.shape)])
            density = _landing_density(off, height, d, n, variances)
            total += light * float(((half * rows)[:, None] * weight * density).sum())
    return total


def _landing_density(off, height, d, n, variances):
    """Return the density of light of direction d at places (2, ...) from above its crossing."""
    flight = np.sqrt(off[0] ** 2 + off[1] ** 2 + height**2)
    r = np.stack([off[0] / flight, off[1] / flight, height / flight])
    normal = n * d[:, None, None] - r
    slope = -normal[:2] / normal[2]
    # dr/dx_k = (e_k - r r_k) / flight
    change = np.zeros((2, 2, *flight.shape))
    for k in range(2):
        turn = -r * r[k] / flight
        turn[k] += 1.0 / flight
        change[k] = (turn[:2] + slope * turn[2]) / normal[2]
    det = np.abs(change[0, 0] * change[1, 1] - change[0, 1] * change[1, 0])
    square = slope[0] ** 2 / variances[0] + slope[1] ** 2 / variances[1]
    gauss = np.exp(-0.5 * square) / (2.0 * math.pi * math.sqrt(variances[0] * variances[1]))
    cos_i = np.einsum("i,i...->...", d, normal) / np.linalg.norm(normal, axis=0)
    exposed = np.clip(1.0 - (d[0] * slope[0] + d[1] * slope[1]) / d[2], 0.0, 2.0)
    return gauss * det * exposed * (1.0 - fresnel_reflectance(cos_i, n, 1.0))


def unscattered(link, mesh):
    """Return gain and relative error of the unscattered light of a link without scattering."""
    parts = ForcedDetection(link, 64, 1, scattered="chains").evaluate(mesh)
    return float(parts.gain[0]), float(parts.stderr[0])


@pytest.mark.parametrize("spacing", [0.1, 0.4])
@pytest.mark.parametrize("fov_deg", [5.0, 10.0, 20.0, 60.0])
def test_views_that_end_within_the_aperture_over_still_water(fov_deg, spacing):
    """Once 0.16402 +- 0 for 0.15966 at 10 deg, at any size of facets."""
    link = wide_link(fov_deg)
    expected = still_gain(link)
    gain, error = unscattered(link, rough_still_water(spacing))
    assert abs(gain - expected) < 3.0 * error
    assert 0.0 < error < 5e-4 * expected
    if fov_deg == 10.0:
        assert expected == pytest.approx(0.15966, abs=1e-5)


@pytest.mark.parametrize(
    ("radius", "fov_deg", "deviation"), [(3.0, 10.0, 0.02), (1.0, 0.5, 0.02), (0.02, 1.0, 0.02)]
)
def test_narrow_views_and_apertures(radius, fov_deg, deviation):
    """Apertures of 0.2 to 30 widths of the light, views of a twelfth of one and of nine."""
    link, variances = wide_link(fov_deg, radius), (deviation**2, 0.5 * deviation**2)
    expected = still_gain(link, variances, nodes=100)
    gain, error = unscattered(link, rough_still_water(0.1, variances, extent=4.0))
    assert abs(gain - expected) < 3.0 * error
    assert 0.0 < error < 2e-3 * expected


@pytest.mark.parametrize(
    ("radius", "fov_deg", "deviation"), [(3.0, 10.0, 0.003), (0.3, 60.0, 0.002)]
)
@pytest.mark.thorough
@pytest.mark.statistical
def test_light_much_narrower_than_the_aperture(radius, fov_deg, deviation):
    """Apertures of 60 to 200 widths of the light."""
    link, variances = wide_link(fov_deg, radius), (deviation**2, 0.5 * deviation**2)
    mesh = rough_still_water(0.1, variances, extent=4.0)
    gain, error = unscattered(link, mesh)
    photons = mt.simulate(link, mesh, estimator="analog", photons=1_000_000, seed=2)
    assert 0.0 < error < 1e-3 * gain
    assert z_test(gain, math.hypot(error, photons.gain_stderr), photons.gain) > sidak(ALPHA, 2)


@pytest.mark.parametrize(
    ("wind_speed", "fov_deg", "radius", "height"),
    [(5.0, 5.0, 3.0, 20.0), (13.0, 5.0, 3.0, 20.0), (5.0, 3.0, 2.0, 5.0), (5.0, 3.0, 3.0, 5.0)],
)
@pytest.mark.thorough
@pytest.mark.statistical
def test_views_that_end_within_the_aperture_over_waves(wind_speed, fov_deg, radius, height):
    """Once 6.1 % low and 4.2 % high without an error; for the last two no answer came."""
    link, sea = wide_link(fov_deg, radius, height), JonswapSea(wind_speed=wind_speed, seed=1)
    mesh = meshing.mesh_for(link, sea, reach=ends.crossing_reach(link))[0]
    found = mt.simulate(link, mesh, seed=1)
    photons = mt.simulate(link, mesh, estimator="analog", photons=1_000_000, seed=2)
    error = math.hypot(found.gain_stderr, photons.gain_stderr)
    assert 0.0 < found.gain_stderr < 1e-3 * found.gain
    assert z_test(found.gain, error, photons.gain) > sidak(ALPHA, 4)


def test_links_that_scatter_have_the_error_of_the_quadrature(monkeypatch):
    """Once 0 for unscattered light away from the edge of the view, and for common chains."""
    mesh, water = rough_still_water(0.4), mt.Water(b=1e-6)
    monkeypatch.setattr(aimed, "LEAST_ERROR", 0.1)
    wide = wide_link(60.0, radius=0.02).replace(water=water)
    found = ForcedDetection(wide, 64, 1, scattered="chains").evaluate(mesh)
    assert found.stderr[0] > 0.099 * found.ballistic[0]
    narrow = wide_link(10.0).replace(water=water)
    direct = correlated.FrozenForced(narrow, 64, 1).parts(narrow, mesh)[1][0]
    assert abs(direct.mean() - still_gain(narrow)) < 3.0 * error_of_groups(direct)


def test_work_that_is_cut_short_says_so(monkeypatch):
    link, mesh = wide_link(10.0), rough_still_water(0.4)
    gain, _ = unscattered(link, mesh)
    monkeypatch.setattr(aimed, "_MOST_NODES", 20_000.0)
    with pytest.warns(DomainWarning, match="1 pair of a source and a receiver took too long"):
        found = mt.simulate(link, mesh, photons=64)
    assert found.chains.cut_short == 1
    assert abs(found.gain - gain) < 3.0 * found.gain_stderr
    assert found.gain_stderr > 0.01 * gain


def log_uniform(rng, low, high):
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def random_link(rng):
    """Return a link without scattering, up or down, of any lamp, view, aperture and place."""
    depth, height = log_uniform(rng, 1, 30), log_uniform(rng, 1, 40)
    reach = 0.3 * min(depth, height) * (rng.random() < 0.5)
    aside = tuple((rng.uniform(-reach, reach, 2)).tolist())
    half, down, kind = log_uniform(rng, 1, 50), rng.random() < 0.3, rng.choice(3)
    disk = {"radius": log_uniform(rng, 0.05, 4), "fov_deg": log_uniform(rng, 2, 120)}
    spread = ("half_angle_deg", "divergence_deg", "divergence_deg")[kind]
    narrow = {spread: min(half, 20.0) if kind == 1 else half}
    if down:
        lamp = (mt.AirLed, mt.AirBeam, mt.AirTopHatBeam)[kind](height=height, **narrow)
        end = mt.WaterReceiver(depth=depth, position=aside, **disk)
    else:
        lamp = (mt.Led, mt.GaussianBeam, mt.TopHatBeam)[kind](depth=depth, **narrow)
        tilt = float(rng.uniform(0, 15) * (rng.random() < 0.3))
        end = mt.Receiver(height=height, position=aside, tilt_deg=tilt, **disk)
    return mt.Link(water=mt.Water(a=0.05, b=0.0), transmitter=lamp, receiver=end)


def random_mesh(rng, link, seed):
    """Return still water with random slopes, or waves of 2 to 14 m/s."""
    if rng.random() < 0.25:
        half = min(ends.crossing_reach(link) + 10.0, 30.0)
        variances = tuple((10.0 ** rng.uniform(-2.7, -1.3, 2)).tolist())
        direction = float(rng.uniform(0, 360))
        return rough_still_water(half / 40.0, variances, 2.0 * half, direction)
    sea = JonswapSea(wind_speed=float(rng.uniform(2, 14)), seed=seed)
    return meshing.mesh_for(link, sea, reach=ends.crossing_reach(link))[0]


@pytest.mark.parametrize(
    ("first", "links", "photons"),
    [
        pytest.param(1000, 10, 500_000, marks=pytest.mark.thorough),
        pytest.param(0, 500, 1_500_000, marks=pytest.mark.slow),
    ],
)
@pytest.mark.statistical
@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
def test_random_links_against_photons(first, links, photons):
    """Radius, view, height, wind and lamp at random: the sum of z^2 is a chi-square."""
    squares = []
    for k in range(first, first + links):
        rng = np.random.default_rng([47, k])
        link = random_link(rng)
        mesh = random_mesh(rng, link, k + 1)
        gain, error = unscattered(link, mesh)
        analog = mt.simulate(link, mesh, estimator="analog", photons=photons, seed=2)
        if analog.gain_stderr < 0.1 * analog.gain:  # a hundred photons: a normal mean
            assert error > 0.0
            squares.append((gain - analog.gain) ** 2 / (error**2 + analog.gain_stderr**2))
    assert len(squares) > 0.5 * links
    assert stats.chi2.sf(max(squares), 1) > sidak(ALPHA, len(squares))
    assert stats.chi2.sf(sum(squares), len(squares)) > ALPHA


@pytest.mark.parametrize("links", [24, pytest.param(48, marks=pytest.mark.slow)])
@pytest.mark.thorough
def test_the_error_over_smooth_facets_is_that_of_finer_parts(links):
    """Once a stated error of 0 for gains that were wrong by up to 2e-3."""
    rng, deviations = np.random.default_rng(6), []
    surfaces = (
        FlatSea(),
        SinusoidalSea(amplitude=0.05, wavelength=2.0),
        JonswapSea(wind_speed=4.0, seed=1),
        JonswapSea(wind_speed=11.0, seed=2),
    )
    for k in range(links):
        link = random_link(rng)
        mesh = meshing.mesh_for(link, surfaces[k % 4], reach=ends.crossing_reach(link))[0]
        smooth = mt.TriangleMesh(mesh.vertices, mesh.faces, mesh.vertex_normals)
        forced = ForcedDetection(link, 64, 1, scattered="chains")
        gains = forced.evaluate(smooth)
        if gains.gain[0] == 0.0:
            continue
        # parts half as long err by a quarter (Richardson)
        finer = forced.planner.aim_over(smooth).direct_gains(0, 0, longer=0.5).sum()
        limit = finer + (finer - gains.gain[0]) / 3.0
        assert 0.0 < gains.stderr[0] < 0.01 * gains.gain[0]
        deviations.append((gains.gain[0] - limit) / gains.stderr[0])
    assert len(deviations) > 0.75 * links
    assert np.abs(deviations).max() < 4.0
    assert 0.3 < np.sqrt(np.mean(np.square(deviations))) < 1.5
