"""Still water cut into 1 to 10^4 facets: the gain of a link does not depend on the cut.

Independent means: chains whose random slope is drawn first and whose crossings are searched
(`AimedChains.blurred = False`), which know no parts of facets, and analog photons.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.engine.chains import sets
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.stored import SHIFTS
from meshtrace.surfaces import JonswapSea

TILTS = UnresolvedSlopes((0.0158, 0.0126), (0.0158, 0.0126))
WATER = mt.Water(b=0.05)
HALF = 40.0  # of the meshes [m]
CUTS = (1, 4, 100, 10_000)


def still_water(facets, tilts=None, half=HALF):
    """Return still water in a number of facets."""
    if facets == 1:
        corners = [(-3.0 * half, -half, 0.0), (3.0 * half, -half, 0.0), (0.0, 3.0 * half, 0.0)]
        return mt.TriangleMesh(np.array(corners), np.array([[0, 1, 2]]), unresolved=tilts)
    if facets == 4:
        square = [(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)]
        corners = np.array([*square, (0.0, 0.0, 0.0)])
        faces = np.array([[i, (i + 1) % 4, 4] for i in range(4)])
        return mt.TriangleMesh(corners, faces, unresolved=tilts)
    n = math.isqrt(2 * facets)
    nx, ny = n, facets // (2 * n) if n * n != 2 * facets else n // 2
    while 2 * nx * ny != facets:
        nx -= 1
        ny = facets // (2 * nx)
    x, y = np.meshgrid(
        np.linspace(-half, half, nx + 1), np.linspace(-half, half, ny + 1), indexing="ij"
    )
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    i, j = (k.ravel() for k in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
    a = i * (ny + 1) + j
    b = a + ny + 1
    faces = [np.column_stack([a, b, b + 1]), np.column_stack([a, b + 1, a + 1])]
    return mt.TriangleMesh(vertices, np.concatenate(faces), unresolved=tilts)


def up(transmitter, **receiver):
    return mt.Link(water=WATER, transmitter=transmitter, receiver=mt.Receiver(**receiver))


def down(transmitter, **receiver):
    return mt.Link(water=WATER, transmitter=transmitter, receiver=mt.WaterReceiver(**receiver))


LINKS = {
    "led 2": up(mt.Led(half_angle_deg=2.0), height=20.0, radius=0.5),
    "led 2, small": up(mt.Led(half_angle_deg=2.0), height=20.0),
    "led 10": up(mt.Led()),
    "led 10, aside": up(mt.Led(), position=(3.0, 1.0)),
    "led 60": up(mt.Led(half_angle_deg=60.0)),
    "led 10, tilted lamp": up(mt.Led(zenith_deg=15.0, azimuth_deg=30.0), position=(4.0, 2.0)),
    "led 5, tilted view": up(mt.Led(half_angle_deg=5.0), tilt_deg=12.0, position=(0.5, 0.0)),
    "led 30, far": up(mt.Led(half_angle_deg=30.0), height=50.0, radius=0.2),
    "gaussian 0.5": up(mt.GaussianBeam(divergence_deg=0.5), height=30.0),
    "gaussian 5": up(mt.GaussianBeam(divergence_deg=5.0), radius=0.2),
    "top hat 3": up(mt.TopHatBeam(divergence_deg=3.0), radius=0.1),
    "all around": up(mt.IsotropicSource(depth=5.0)),
    "down, led 10": down(mt.AirLed(height=5.0)),
    "down, led 60, aside": down(
        mt.AirLed(height=5.0, half_angle_deg=60.0), position=(2.0, 1.0), fov_deg=90.0
    ),
    "down, gaussian 2": down(mt.AirBeam(height=10.0, divergence_deg=2.0), radius=0.2),
}
CASES = [(name, tilts) for name in LINKS for tilts in (None, TILTS)]
NARROW = ("led 2", UnresolvedSlopes((1e-4, 4e-5), (1e-4, 4e-5), 30.0))
CASES.append(NARROW)
QUICK = {("led 2", TILTS), ("gaussian 0.5", TILTS)}


def mark(case):
    marks = pytest.mark.slow if case == NARROW else pytest.mark.thorough
    return pytest.param(*case, marks=() if case in QUICK else marks)


@pytest.mark.parametrize(("name", "tilts"), [mark(case) for case in CASES])
def test_gains_do_not_depend_on_the_facets(name, tilts):
    """31 links; the chains are the same, so that nothing but the cut differs."""
    parts = [
        ForcedDetection(LINKS[name], 256, 1, scattered="chains").evaluate(still_water(n, tilts))
        for n in CUTS
    ]
    direct = np.array([p.ballistic[0] for p in parts])
    gain = np.array([p.gain[0] for p in parts])
    assert (direct > 0.0).all()
    assert all("sampled" not in p.counts for p in parts)
    np.testing.assert_allclose(direct, direct[-1], rtol=3e-4)
    np.testing.assert_allclose(gain, gain[-1], rtol=1e-3)


@pytest.mark.parametrize(("name", "tilts"), [mark(case) for case in CASES if case[1] is not None])
def test_light_through_large_facets_against_searched_chains(name, tilts):
    forced = ForcedDetection(LINKS[name], 64, 1, scattered="chains")
    aimed = forced.planner.aim_over(still_water(4, tilts))
    gain = aimed.direct_gains(0, 0).sum()
    drawn = forced.drawer.draw(sets.Request(0, 0, 256, (7, 0, 0, 1)))
    aimed.blurred = False
    shifts = aimed.aim(0, 0, drawn)[0].reshape(SHIFTS, -1).mean(axis=1)
    stderr = shifts.std(ddof=1) / math.sqrt(SHIFTS)
    # a beam far narrower than the tilts is met by few of the chains
    assert stderr < 0.05 * gain
    assert z_test(gain, math.hypot(stderr, 1e-3 * gain), shifts.mean()) > sidak(ALPHA, len(CASES))


@pytest.mark.thorough
@pytest.mark.statistical
def test_four_large_facets_against_analog_photons():
    link = LINKS["led 2"]
    forced = mt.simulate(link, still_water(4, TILTS, 20.0), photons=4096, seed=1)
    analog = mt.simulate(link, still_water(4, TILTS, 20.0), "analog", photons=1_000_000, seed=2)
    assert forced.gain_bound is None
    stderr = math.hypot(forced.gain_stderr, analog.gain_stderr)
    assert z_test(forced.gain, stderr, analog.gain) > ALPHA


def test_light_that_no_facet_finds_is_sampled(monkeypatch):
    """A link is not called dark by the images of the facets alone."""
    from meshtrace.engine.chains import microfacets, unscattered

    usual = mt.simulate(LINKS["led 10"], still_water(100), photons=256, seed=1)
    for tilts in (None, TILTS):
        with monkeypatch.context() as patch:
            patch.setattr(microfacets, "blurred_gain", lambda *_: None)
            patch.setattr(unscattered, "image_gain", lambda *_: None)
            found = mt.simulate(
                LINKS["led 10"], still_water(100, tilts), photons=256, seed=1, record=["arrivals"]
            )
        assert found.chains.sampled == 1
        assert found.arrivals.weight.sum() == pytest.approx(found.gain, rel=1e-12)
        if tilts is None:
            assert found.gain_ballistic == pytest.approx(usual.gain_ballistic, rel=1e-3)


@pytest.mark.thorough
def test_light_of_beams_is_integrated_over_waves():
    """Facets in the dark do not make unscattered light be sampled, or a waist be refused."""
    sea = JonswapSea(wind_speed=8.0, seed=1)
    mesh = sea.mesh(extent=30.0, spacing=0.1, fine_extent=3.0)
    gains = []
    for waist in (0.0, 0.001):
        beam = mt.GaussianBeam(depth=20.0, divergence_deg=0.5, waist=waist)
        link = mt.Link(transmitter=beam, receiver=mt.Receiver(height=30.0))
        forced = ForcedDetection(link, 64, 1, sea=TypicalSea(1.0))
        gains.append(forced.evaluate(mesh).ballistic[0])
        if waist == 0.0:
            assert forced.planner.aim_over(mesh).direct_gains(0, 0) is not None
    assert gains[1] == pytest.approx(gains[0], rel=1e-3)


VIEWS = [("cox-munk", 1.0, 4096), ("cox-munk", 2.0, 1024), ("cox-munk", 8.0, 512)]
VIEWS += [("band", 2.0, 512), ("band", 4.0, 64)]


@pytest.mark.parametrize(
    ("mss", "fov", "points"),
    [pytest.param(*v, marks=() if v[1] == 2.0 else pytest.mark.thorough) for v in VIEWS],
)
def test_views_narrower_than_the_facets(mss, fov, points):
    """The edge of the field of view cuts facets, of 0.1 m; the view is 0.09 to 0.7 m wide there."""
    link = mt.Link(receiver=mt.Receiver(fov_deg=fov))
    mesh = JonswapSea(wind_speed=5.0, seed=4, mss=mss).mesh(extent=6.0, spacing=0.1)
    forced = ForcedDetection(link, 64, 1, sea=TypicalSea(0.6), scattered="chains")
    aimed = forced.planner.aim_over(mesh)
    gain = aimed.direct_gains(0, 0).sum()
    aimed.blurred = False
    drawn = forced.drawer.draw(sets.Request(0, 0, points, (7, 0, 0, 1)))
    shifts = aimed.aim(0, 0, drawn)[0].reshape(SHIFTS, -1).mean(axis=1)
    stderr = shifts.std(ddof=1) / math.sqrt(SHIFTS)
    assert stderr < 0.01 * gain
    assert z_test(gain, math.hypot(stderr, 1e-3 * gain), shifts.mean()) > sidak(ALPHA, len(VIEWS))
