"""Analog photons in a local frame: neither scale nor distance from the origin changes a gain."""

import math
from dataclasses import replace

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import Vertex
from meshtrace.engine.photons import analog
from meshtrace.errors import Refused
from meshtrace.surfaces import FlatSea, JonswapSea

pytestmark = pytest.mark.filterwarnings("ignore::meshtrace.engine.outcome.DomainWarning")

PHOTONS = 8192
MESH = JonswapSea(wind_speed=5.0, seed=7).mesh(extent=20.0, spacing=0.5)


def moved(k=1.0, x=0.0, y=0.0, **parts):
    """Return a link with a wide view over waves: lengths times k, then a shift, and its mesh."""
    given = {
        "water": mt.Water(a=0.114 / k, b=0.3 / k),
        "transmitter": mt.Led(depth=10.0 * k, position=(x, y)),
        "receiver": mt.Receiver(height=5.0 * k, radius=2.0 * k, fov_deg=120.0, position=(x, y)),
    }
    vertices = k * MESH.vertices + np.array([x, y, 0.0])
    return mt.Link(**{**given, **parts}), replace(MESH, vertices=vertices)


def run(link, mesh, **options):
    return mt.simulate(link, mesh, estimator="analog", photons=PHOTONS, seed=5, **options)


@pytest.fixture(scope="module")
def metres():
    return run(*moved(), record=[mt.Arrivals()])


@pytest.mark.parametrize("k", [2.0**-14, 2.0**7])
def test_a_power_of_two_changes_no_bit(k, metres):
    found = run(*moved(k), record=[mt.Arrivals()])
    assert found.gain == metres.gain
    assert found.gain_stderr == metres.gain_stderr
    assert found.fates == metres.fates
    for name in ("water_path", "air_path"):
        paths, expected = (getattr(r.arrivals, name) for r in (found, metres))
        np.testing.assert_array_equal(paths, k * expected)


class Counted(mt.BruteForceIntersector):
    """Intersector of a user that counts its calls, shared by those over other meshes."""

    def __init__(self, mesh, calls=None):
        super().__init__(mesh)
        self.calls = [] if calls is None else calls

    def for_mesh(self, mesh):
        return Counted(mesh, self.calls)

    def facets(self, origins, directions):
        self.calls.append(len(origins))
        return super().facets(origins, directions)


@pytest.mark.parametrize("k", [1.0, 2.0**-14])
def test_the_intersector_of_a_user_traces_in_any_units(k):
    link, mesh = moved(k)
    own, embree = Counted(mesh), mt.EmbreeIntersector(mesh, 1)
    found, expected = (analog.run_analog(link, i, photons=512, seed=5) for i in (own, embree))
    assert sum(own.calls) > 500
    assert found.score.sum() > 0.0
    np.testing.assert_array_equal(found.score, expected.score)


@pytest.mark.parametrize("k", [1e-7, 1e-4, 3e-3, 50.0])
def test_all_lengths_times_k_change_nothing(k, metres):
    """From a drop to a basin of 750 m: gain and fates of the light."""
    found = run(*moved(k))
    np.testing.assert_allclose(found.gain, metres.gain, rtol=1e-3)
    for fate, tally in metres.fates.items():
        assert found.fates[fate].weight == pytest.approx(tally.weight, abs=3e-4)


@pytest.mark.parametrize(("x", "y"), [(1e5, 0.0), (-3e5, 6e5), (9e5, 9e5)])
def test_links_far_from_the_origin(x, y, metres):
    """Single precision at 9e5 m has steps of 6 cm; the mesh itself is exact to 1e-10 m."""
    found = run(*moved(1.0, x, y))
    np.testing.assert_allclose(found.gain, metres.gain, rtol=1e-3)
    assert found.rays_lost == 0


@pytest.mark.parametrize("transmitter", ["sun", "gaussian-beam"])
def test_sources_with_a_size(transmitter):
    def source(k, x):
        given = {"kind": transmitter, "position": (x, 0.0)}
        wide = {"sun": {"half_width": 4.0 * k, "zenith_deg": 30.0},
                "gaussian-beam": {"depth": 10.0 * k, "waist": 1.0 * k}}  # fmt: skip
        return {**given, **wide[transmitter]}

    def gain(k, x):
        eye = {"kind": "water-aperture", "depth": 8.0 * k, "radius": 4.0 * k, "position": (x, 0.0)}
        air = {"height": 5.0 * k, "radius": 2.0 * k, "fov_deg": 120.0, "position": (x, 0.0)}
        planes = {"depths": (2.0 * k, 6.0 * k), "n_cosines": 4, "n_azimuths": 1}
        link, mesh = moved(k, x, transmitter=source(k, x), receiver=(eye, air), planes=planes)
        found = run(link, mesh)
        return found.gain, found.planes

    expected, planes = gain(1.0, 0.0)
    assert expected[0] + expected[1] > 0.003
    for k, x in ((1e-4, 0.0), (1.0, 9e5)):
        found, seen = gain(k, x)
        np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-6)
        np.testing.assert_allclose(seen.depth, k * planes.depth)
        for name in ("e_d", "e_u", "e_od", "e_ou"):
            np.testing.assert_allclose(getattr(seen, name), getattr(planes, name), rtol=0.02)


@pytest.mark.parametrize("depth", ["local", "clamped", "mean_level"])
def test_bubbles(depth):
    """Bubbles have a depth in metres of their own, so the link is only shifted."""
    cloud = mt.HallNovarini(wind_speed=13.0, depth=depth)
    here, there = (run(*moved(1.0, x, bubbles=cloud)) for x in (0.0, 9e5))
    np.testing.assert_allclose(there.gain, here.gain, rtol=2e-3)


def test_maps_stay_about_the_origin():
    grid = mt.IrradianceMap(height=5.0, extent=8.0, step=1.0, fov_deg=120.0)
    link, mesh = moved()
    here = run(link, mesh, record=[grid]).map
    small = mt.IrradianceMap(height=5e-4, extent=8e-4, step=1e-4, fov_deg=120.0)
    there = run(*moved(1e-4), record=[small]).map
    np.testing.assert_allclose(there.x, 1e-4 * here.x)
    np.testing.assert_allclose(there.irradiance.sum(), 1e8 * here.irradiance.sum(), rtol=1e-3)
    np.testing.assert_allclose(1e-8 * there.irradiance, here.irradiance, atol=2e-3)


def test_recorded_paths_are_in_metres():
    paths = mt.trace_paths(*moved(1.0, 9e5, -1e5), n=50, seed=2)
    home = mt.trace_paths(*moved(), n=50, seed=2)
    assert (paths.what[:, 0] == Vertex.SOURCE).sum() == 50
    starts = paths.vertex[paths.what[:, 0] == Vertex.SOURCE, 0]
    np.testing.assert_allclose(starts, np.tile([9e5, -1e5, -10.0], (50, 1)))
    shift = np.array([9e5, -1e5, 0.0])
    np.testing.assert_allclose(paths.vertex[:50, 1] - shift, home.vertex[:50, 1], atol=1e-6)


def test_a_mesh_that_single_precision_cannot_hold():
    link, _ = moved(1e-7)
    with pytest.raises(Refused, match=r"mesh: reaches .* m from the link, allowed: at most 0\."):
        run(link, FlatSea().mesh(extent=20.0, spacing=5.0))


def test_default_seas_of_small_links():
    """The sea that is made for a tank is as fine as the one for the link in metres."""
    gains = [run(moved(k)[0], FlatSea()).gain for k in (1.0, 1e-4)]
    error = math.sqrt(2.0 * gains[0] / PHOTONS)
    assert gains[0] > 0.0
    assert abs(gains[1] - gains[0]) < 0.2 * error
