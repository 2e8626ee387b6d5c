"""Light through waves against quadrature over the exact surface; facets against corners.

Without scattering the gain is an integral over the surface, done here on a fine grid with the
exact elevations and slopes: a twin that knows neither facets nor photons.
"""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.optics import fresnel_reflectance
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea, TiltedPlane

# small meshes: the rim of the lamp's light leaves them, which is no matter to the apertures
pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

CLEAR = mt.Water(b=0.0)
FOCUSING = SinusoidalSea(amplitude=0.15, wavelength=2.0, phase=0.4)
OBLIQUE = SinusoidalSea(amplitude=0.1, wavelength=3.0, phase=0.4, direction_deg=25.0)


def quadrature_gains(sea, link, receivers, nodes=1200, half=3.2):
    """Return the unscattered gains by the midpoint rule over the surface.

    A path counts once: no second hit, no shadow. A surface element of the projection dx dy
    fills the solid angle w . (-zx, -zy, 1) dx dy / r^2 at the lamp.
    """
    led, n = link.transmitter, link.water.n
    axis = half * ((np.arange(nodes) + 0.5) / nodes * 2.0 - 1.0)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z, slope_x, slope_y = sea.grid(axis, axis)
    p = np.stack([x, y, z], axis=-1)
    w = p - np.array([*led.position, -led.depth])
    r = np.linalg.norm(w, axis=-1)
    w /= r[..., None]
    up = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=-1)
    solid_angle = (w * up).sum(-1) / r**2 * (2.0 * half / nodes) ** 2
    normal = up / np.linalg.norm(up, axis=-1)[..., None]
    cos_i = (w * normal).sum(-1)
    cos2_t = 1.0 - n**2 * (1.0 - cos_i**2)
    cos_t = np.sqrt(np.maximum(cos2_t, 0.0))
    d = n * w + (cos_t - n * cos_i)[..., None] * normal
    m = led.order
    intensity = (m + 1.0) / (2.0 * math.pi) * (w @ np.array(led.axis)).clip(0.0) ** m
    loss = 1.0 - fresnel_reflectance(cos_i.clip(0.0, 1.0), n, 1.0)
    light = intensity * solid_angle * loss * np.exp(-link.water.a * r)
    gains = []
    for receiver in receivers:
        along = d @ np.array(receiver.axis)
        t = ((np.array(receiver.center) - p) @ np.array(receiver.axis)) / along
        off = np.linalg.norm(p + t[..., None] * d - np.array(receiver.center), axis=-1)
        hit = (cos2_t > 0.0) & (solid_angle > 0.0) & (t > 0.0) & (off <= receiver.radius)
        hit &= along >= math.cos(math.radians(receiver.fov_deg / 2.0))
        gains.append(float(light[hit].sum()))
    return gains


def analog(link, sea, photons, **options):
    return mt.simulate(link, sea, estimator="analog", photons=photons, **options)


SEAS = {
    "flat": (FlatSea(height=0.3), 2.0),
    "tilted": (TiltedPlane(slope_x=0.2, slope_y=-0.1), 2.0),
    "focusing": (FOCUSING, 0.03),
    "oblique": (OBLIQUE, 0.04),
    "jonswap": (JonswapSea(wind_speed=13.0, seed=3, mss="band", waves="paper"), 0.1),
    "jonswap later": (JonswapSea(wind_speed=5.0, seed=4, mss="band", waves="paper"), 0.1),
}


@pytest.mark.parametrize(("sea", "spacing"), SEAS.values(), ids=SEAS.keys())
@pytest.mark.thorough
@pytest.mark.slow_but("oblique", "jonswap")
def test_vertex_normals_meet_the_quadrature(sea, spacing):
    """Several receivers, one of them tilted: slopes, refraction and Fresnel all have their sign."""
    receivers = (
        mt.Receiver(radius=0.5),
        mt.Receiver(radius=0.5, position=(1.1, 0.3)),
        mt.Receiver(radius=0.5, position=(-0.6, 1.0), tilt_deg=30.0, tilt_azimuth_deg=-60.0),
        mt.Receiver(radius=1.0, position=(-0.3, -0.6), fov_deg=10.0),
    )
    link = mt.Link(water=CLEAR, receiver=receivers)
    r = analog(link, sea, 1_200_000, extent=6.0, spacing=spacing, seed=5)
    gains = quadrature_gains(sea, link, receivers)
    for expected, gain, stderr in zip(gains, r.gain, r.gain_stderr, strict=True):
        assert stderr / gain < 0.012
        # the midpoint rule and the mesh are good to some 1e-3
        p = z_test(gain, stderr, expected, 1.5e-3 * expected)
        assert p > sidak(ALPHA, 4 * len(SEAS)), f"{gain} +- {stderr}, expected {expected}"


@pytest.mark.parametrize("normals", ["vertex", "facet"])
@pytest.mark.thorough
def test_facets_of_a_plane_are_exact(normals):
    sea = TiltedPlane(slope_x=-0.25, slope_y=0.15)
    receiver = mt.Receiver(radius=1.0, position=(0.8, -0.4))
    link = mt.Link(water=CLEAR, receiver=receiver)
    r = analog(link, sea, 1_000_000, extent=6.0, spacing=0.37, seed=6, normals=normals)
    (expected,) = quadrature_gains(sea, link, [receiver])
    assert z_test(r.gain, r.gain_stderr, expected, 5e-4 * expected) > sidak(ALPHA, 2)


@pytest.mark.parametrize("sea", [FOCUSING, OBLIQUE], ids=["focusing", "oblique"])
@pytest.mark.thorough
@pytest.mark.slow_but("focusing")
def test_facet_and_vertex_normals_converge_to_each_other(sea):
    """The same photons on ever finer meshes: the difference falls with every halving.

    Nine apertures of 60 cm; rms difference over their mean gain. The noise is common.
    """
    places = [(x, y) for x in (-1.2, 0.0, 1.2) for y in (-1.2, 0.0, 1.2)]
    link = mt.Link(water=CLEAR, receiver=tuple(mt.Receiver(radius=0.3, position=p) for p in places))
    differences = []
    for spacing in (0.5, 0.25, 0.125, 0.0625):
        corner, facet = (
            analog(link, sea, 1_000_000, extent=5.0, spacing=spacing, seed=7, normals=kind)
            for kind in ("vertex", "facet")
        )
        difference = facet.gain - corner.gain
        differences.append(np.sqrt(np.mean(difference**2)) / corner.gain.mean())
    assert differences[0] > 0.1
    ratios = np.array(differences[:-1]) / np.array(differences[1:])
    assert (ratios > 1.4).all(), differences
    assert differences[-1] < 0.03


@pytest.mark.thorough
def test_focusing_moves_light_and_loses_none():
    """A caustic at the receiver's height: bright lines, dark gaps, the same total."""
    grid = mt.IrradianceMap(height=5.0, extent=6.0, step=0.1)
    lamp = mt.Led(half_angle_deg=5.0)
    link = mt.Link(water=CLEAR, transmitter=lamp, receiver=mt.Receiver(radius=0.3))
    calm, wavy = (
        analog(link, sea, 2_000_000, extent=10.0, spacing=spacing, seed=8, record=[grid])
        for sea, spacing in ((FlatSea(), 5.0), (FOCUSING, 0.05))
    )
    bright, even = (r.map.irradiance for r in (wavy, calm))
    across = slice(50, 70)
    contrast = bright[across, across].max() / bright[across, across].min()
    assert contrast > 3.0 * even[across, across].max() / even[across, across].min()
    for r in (calm, wavy):
        light = r.fates["landed"].weight + r.fates["received"].weight
        on_map = r.map.irradiance.sum() * grid.step**2
        assert on_map <= light
        assert on_map == pytest.approx(light, rel=0.01)
        assert sum(f.weight for f in r.fates.values()) == pytest.approx(1.0, abs=1e-12)
    # the slopes reflect a little more, the total stays within a per cent
    a, b = (r.fates["landed"].weight + r.fates["received"].weight for r in (calm, wavy))
    assert b == pytest.approx(a, rel=0.02)
    assert b < a


@pytest.mark.parametrize("wind_speed", [5.0, 13.0])
@pytest.mark.thorough
@pytest.mark.slow_but("13.0")
def test_mean_over_realizations_is_the_gain_of_the_flat_sea(wind_speed):
    """On the paper's seas the mean gain is that of still water within 1-2 % (physics.md)."""
    link = mt.Link(receiver=mt.Receiver(radius=0.5))
    calm = analog(link, FlatSea(), 1_000_000, seed=9)
    gains = np.array(
        [
            analog(
                link,
                JonswapSea(wind_speed=wind_speed, seed=k, waves="paper"),
                200_000,
                seed=k,
                spacing=0.3,
            ).gain
            for k in range(24)
        ]
    )
    stderr = gains.std(ddof=1) / math.sqrt(len(gains))
    assert stderr / gains.mean() < 0.04
    spread = math.hypot(calm.gain_stderr, 0.02 * calm.gain)
    assert z_test(gains.mean(), stderr, calm.gain, spread) > sidak(ALPHA, 2)
