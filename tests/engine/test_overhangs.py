"""Light through surfaces that are no height fields: crests that lean over, plates, jets."""

import math
from itertools import pairwise

import numpy as np
import pytest
from leaning import LeaningWave
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.engine.setup import arrays
from meshtrace.kernels import jit, vectors
from meshtrace.kernels.medium import local_elevation
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.optics import fresnel_reflectance
from meshtrace.optics.fresnel import refract
from meshtrace.scenario import Scenario
from meshtrace.surfaces import from_trimesh
from meshtrace.surfaces.triangulate import triangulate

pytestmark = pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")

N = 1.33
WAVE = LeaningWave(amplitude=0.3, wavelength=4.0, lean=0.9)
CLEAR = mt.Water(a=0.0, b=0.0)
LAMP = mt.Link(
    water=mt.Water(a=0.05, b=1e-4),
    transmitter=mt.Led(depth=5.0, position=(1.0, 0.0), half_angle_deg=10.0),
    receiver=mt.Receiver(height=5.0, position=(1.0, 0.0), radius=0.5),
)
"""The lamp of the reference gain 0.03211 +- 0.0003 under `WAVE`."""


def extruded(*profiles, half=20.0):
    """Return strips along y of profiles (x, z), with the air on the left of their way along x.

    Strips share no corners, so that interpolated normals are those of the strips.
    """
    vertices, faces = [], []
    for profile in profiles:
        for (x0, z0), (x1, z1) in pairwise(profile):
            k = len(vertices)
            vertices += [(x0, -half, z0), (x1, -half, z1), (x1, half, z1), (x0, half, z0)]
            faces += [(k, k + 1, k + 2), (k, k + 2, k + 3)]
    return mt.TriangleMesh(vertices, faces, overhangs=True)


def beam(start, zenith_deg, azimuth_deg=0.0):
    return mt.TopHatBeam(
        depth=-start[2],
        position=(float(start[0]), float(start[1])),
        divergence_deg=0.0,
        zenith_deg=float(zenith_deg),
        azimuth_deg=azimuth_deg,
    )


@pytest.fixture(scope="module")
def leaning():
    return WAVE.mesh(extent=20.0, spacing=0.1)


def test_embree_finds_the_facets_of_brute_force():
    mesh = WAVE.mesh(extent=2.2, spacing=0.4)
    rng = np.random.default_rng(1)
    n = 100_000
    origins = rng.uniform((-2.5, -2.2, -0.6), (3.0, 2.2, 0.6), (n, 3)).astype(np.float32)
    directions = rng.normal(size=(n, 3))
    directions = (directions / np.linalg.norm(directions, axis=1)[:, None]).astype(np.float32)
    fast = mt.EmbreeIntersector(mesh, 1).intersect(origins, directions)
    slow = mt.BruteForceIntersector(mesh).intersect(origins, directions)
    differ = fast.facet != slow.facet
    assert (slow.facet >= 0).mean() > 0.3
    assert differ.mean() < 1e-3
    same = ~differ & (slow.facet >= 0)
    p = np.stack([1.0 - fast.u - fast.v, fast.u, fast.v], axis=1)[same]
    hit = np.einsum("ij,ijk->ik", p, mesh.vertices[mesh.faces[fast.facet[same]]])
    along = origins[same] + fast.distance[same, None] * directions[same]
    np.testing.assert_allclose(hit, along, atol=1e-9)
    # single precision decides between neighbours at an edge, and nothing else
    for hits in (fast, slow):
        u, v = hits.u[differ], hits.v[differ]
        edge = np.nanmin(np.abs([u, v, 1.0 - u - v]), axis=0)
        assert not (edge > 1e-4).any()


def test_share_of_verticals_with_three_crossings(leaning):
    """The closed form is the overlap over the wavelength, 0.034099."""
    embree = mt.EmbreeIntersector(WAVE.mesh(extent=5.0, spacing=0.02), 1)
    n = 100_000
    at = np.random.default_rng(2).uniform(-4.0, 4.0, (n, 2))
    at[:, 1] *= 0.9
    z, crossings = np.full(n, 1.0), np.zeros(n, int)
    for _ in range(5):
        start = np.column_stack([at, z - 1e-5])
        hits = embree.intersect(start, np.broadcast_to((0.0, 0.0, -1.0), start.shape))
        found = np.isfinite(hits.distance)
        crossings += found
        z = np.where(found, z - 1e-5 - hits.distance, -1.0)
    assert set(crossings) == {1, 3}
    share = (crossings == 3).mean()
    assert z_test(share, math.sqrt(share * (1 - share) / n), 0.034099) > ALPHA


@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_ledger_and_gain(leaning, normals):
    r = mt.simulate(LAMP, leaning, photons=100_000, normals=normals)
    assert r.provenance["run"]["estimator"] == "analog"
    assert r.provenance["run"]["max_surface_events"] == 100
    assert sum(f.weight for f in r.fates.values()) == pytest.approx(1.0, abs=1e-12)
    assert sum(f.photons for f in r.fates.values()) == r.photons
    assert (r.rays_recast, r.rays_lost) == (0, 0)
    assert r.fates["leaked"] == (0, 0.0)
    assert z_test(r.gain, math.hypot(r.gain_stderr, 0.0003), 0.03211) > sidak(ALPHA, 2)


def test_ledger_with_tilts_and_bubbles(leaning):
    slopes = UnresolvedSlopes((0.02, 0.01), (0.02, 0.01))
    rough = mt.TriangleMesh(
        leaning.vertices, leaning.faces, leaning.vertex_normals, slopes, overhangs=True
    )
    link = LAMP.replace(bubbles=mt.HallNovarini(wind_speed=13.0))
    assert link.physics.unresolved == "tilt"
    r = mt.simulate(link, rough, photons=20_000)
    assert sum(f.weight for f in r.fates.values()) == pytest.approx(1.0, abs=1e-12)
    assert r.fates["leaked"].weight < 1e-3


def test_volume_is_that_of_the_cosine(leaning):
    """Integral of z over the projected facets: that of the cosine and of the ends."""
    a, b, c = (leaning.vertices[leaning.faces[:, i]] for i in range(3))
    u, v = b - a, c - a
    area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    volume = float(np.sum(area * (a + b + c)[:, 2] / 3.0))
    s = np.array([-20.0 - 0.9, 20.0])
    k, z = WAVE.wavenumber, WAVE.profile(s)[1]
    cosine = 0.3 * np.diff(np.sin(k * s))[0] / k
    ends = 2.0 / 3.0 * 0.9 * np.diff(np.maximum(z, 0.0) ** 3)[0] / 0.3**2
    assert volume == pytest.approx(40.0 * (cosine + ends), abs=40.0 * 2e-3)


def test_mirrored_mesh_has_the_mirrored_gain(leaning):
    mirror = np.array([-1.0, 1.0, 1.0])
    mirrored = mt.TriangleMesh(
        leaning.vertices * mirror,
        leaning.faces[:, ::-1],
        leaning.vertex_normals * mirror,
        overhangs=True,
    )
    assert mirrored.facing_down == leaning.facing_down > 1000
    at = {"transmitter.position": (0.4, 0.0), "receiver.position": (1.2, 0.0)}
    other = {key: (-x, y) for key, (x, y) in at.items()}
    results = []
    for places, mesh in ((at, leaning), (other, mirrored)):
        link = LAMP
        for key, place in places.items():
            link = link.replace(key, place)
        results.append(mt.simulate(link, mesh, photons=100_000))
    first, second = results
    assert z_test(first.gain, first.gain_stderr, second.gain, second.gain_stderr) > ALPHA
    wrong = mt.simulate(LAMP.replace("receiver.position", (-1.2, 0.0)), leaning, photons=20_000)
    assert z_test(first.gain, first.gain_stderr, wrong.gain, wrong.gain_stderr) < 1e-6


def test_thin_plate_of_water():
    """Two parallel sheets, 1 cm apart, transmit (1 - R) / (1 + R) = 0.96067 upright light.

    The sea below is tilted: what the plate sends back does not return to it upright.
    """
    tilt = math.radians(15.0)
    normal = np.array([-math.sin(tilt), 0.0, math.cos(tilt)])
    in_water = -refract(np.array([0.0, 0.0, -1.0]), -normal, 1.0, N)
    start = -4.0 / in_water[2] * in_water
    zenith = math.degrees(math.acos(in_water[2]))
    link = mt.Link(
        water=CLEAR,
        transmitter=beam(start, zenith, 0.0 if in_water[0] > 0.0 else 180.0),
        receiver=mt.Receiver(height=8.0, radius=0.2, fov_deg=4.0),
    )
    rise = 10.0 * math.tan(tilt)
    sea = [(-10.0, -rise), (10.0, rise)]
    plate = [(-10.0, 4.01), (10.0, 4.01)]
    under = [(10.0, 4.0), (-10.0, 4.0)]
    n = 200_000
    r = mt.simulate(link, extruded(sea, under, plate), photons=n, normals="facet")
    passed = 1.0 - float(fresnel_reflectance(in_water @ normal, N, 1.0))
    reflected = ((N - 1.0) / (N + 1.0)) ** 2
    assert (1.0 - reflected) / (1.0 + reflected) == pytest.approx(0.96067, abs=1e-5)
    assert r.gain_stderr < 1e-3
    assert abs(r.gain / passed - 0.96067) < 3.0 * r.gain_stderr / passed
    bare = mt.simulate(link, extruded(sea), "analog", photons=4096, normals="facet")
    assert bare.gain == pytest.approx(passed, rel=1e-12)


@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_a_jet_guides_light_beyond_the_critical_angle(normals):
    """A sheet of water with upright walls: light at 60 deg from their normals never leaves it."""
    width, height = 0.1, 40.0
    half = 0.5 * width
    jet = [(-20, 0), (-half, 0), (-half, height), (half, height), (half, 0), (20, 0)]
    mesh = extruded(jet)
    assert mesh.facing_down == 4
    link = mt.Link(
        water=CLEAR,
        transmitter=beam((0.0, 0.0, -0.02), 30.0),
        receiver=mt.Receiver(height=60.0),
    )
    r = mt.simulate(link, mesh, photons=4096, normals=normals)
    assert r.fates["landed"].weight == r.fates["received"].weight == 0.0
    assert r.fates["event_limit"] == (4096, 1.0)
    # through the top of a jet that they climb, and at 40 deg from the normals through the walls
    enough = {"max_surface_events": 1000}
    top = mt.simulate(link, mesh, "analog", photons=4096, normals=normals, **enough)
    climbed = 1.0 - float(fresnel_reflectance(math.cos(math.radians(30.0)), N, 1.0))
    assert top.fates["landed"].weight == pytest.approx(climbed, rel=1e-9)
    leaving = link.replace("transmitter.zenith_deg", 50.0)
    sides = mt.simulate(leaving, mesh, photons=4096, normals=normals)
    assert sides.fates["landed"].weight + sides.fates["event_limit"].weight > 0.0
    assert sides.fates["event_limit"].weight < 1e-9


@pytest.mark.thorough
def test_a_gentle_lean_is_a_height_field():
    """Sheared label grid and height field on a grid: one surface, one gain."""
    wave = LeaningWave(amplitude=0.3, wavelength=4.0, lean=0.4)
    assert wave.single_valued
    link = LAMP.replace(water=mt.Water(a=0.05, b=0.1))
    axis = np.linspace(-8.0, 8.0, 321)
    on_grid = triangulate(axis, axis, *wave.grid(axis, axis))
    meshes = wave.mesh(extent=8.0, spacing=0.05), on_grid
    assert all(mesh.single_valued for mesh in meshes)
    sheared, field = (mt.simulate(link, mesh, photons=2048) for mesh in meshes)
    assert sheared.provenance["run"]["estimator"] == "forced"
    assert sheared.gain_ballistic == pytest.approx(field.gain_ballistic, rel=3e-3)
    assert sheared.gain == pytest.approx(field.gain, rel=5e-3)


@jit.allocating_entry
def elevations(medium, points):
    out = np.empty(len(points))
    for i in range(len(points)):
        out[i] = local_elevation(medium, vectors.row(points, i))
    return out


def test_depth_below_the_first_crossing_above():
    """In the jet the surface above is its back, under it the trough."""
    big = LeaningWave(amplitude=3.0, wavelength=40.0, lean=9.0)
    mesh = big.mesh(extent=20.0, spacing=0.1)
    embree = mt.EmbreeIntersector(mesh, 1)
    medium = arrays.with_raster(
        arrays.medium_arrays(mt.Link(bubbles=mt.HallNovarini(wind_speed=9.0))), embree
    )
    assert medium.overhangs
    folds = big.folds
    rng = np.random.default_rng(3)
    low, high = folds[1, 1] + 0.3, folds[0, 1] - 0.3
    points = rng.uniform((low, -5.0, -1.0), (high, 5.0, 3.0), (4000, 3))
    up = embree.intersect(points, np.broadcast_to((0.0, 0.0, 1.0), points.shape))
    wet = np.isfinite(up.distance)
    wet[wet] &= mesh.face_normals[up.facet[wet], 2] > 0.0
    above = points[wet, 2] + up.distance[wet]
    found = elevations(medium, points[wet])
    in_jet = points[wet, 2] > folds[1, 2]
    assert 50 < in_jet.sum() < wet.sum() - 50
    assert np.quantile(np.abs(found - above), 0.9) < 0.1


CALM = LeaningWave(amplitude=0.1, wavelength=9.0, lean=0.1)


def test_forced_detection_refuses_in_one_line(leaning):
    expected = (
        f"sea.mesh: overhangs ({leaning.facing_down} facets face down), allowed: a height field"
    )
    for call in (
        lambda: mt.simulate(LAMP, leaning, "forced"),
        lambda: mt.simulate(LAMP, WAVE, "forced", extent=6.0),
        lambda: mt.time_series(LAMP, WAVE, [0.0], photons=64),
        lambda: mt.trace_paths(LAMP, leaning, 10, received_only=True),
    ):
        with pytest.raises(mt.Refused, match=r"sea\.mesh: overhangs") as caught:
            call()
        assert str(caught.value).endswith('overhangs need estimator="analog"')
    with pytest.raises(mt.Refused) as caught:
        mt.simulate(LAMP, leaning, "forced")
    assert str(caught.value).startswith(expected)


def test_analog_is_the_default_and_keeps_what_is_chosen(leaning):
    grid = mt.IrradianceMap(height=5.0, extent=2.0, step=1.0)
    r = mt.simulate(LAMP, leaning, photons=4096, record=[grid])
    assert r.map is not None
    few = mt.simulate(LAMP, leaning, "analog", photons=4096, max_surface_events=1)
    assert few.provenance["run"]["max_surface_events"] == 1
    assert few.fates["event_limit"].photons > 0
    flat = mt.simulate(LAMP, CALM.mesh(extent=20.0, spacing=0.5), "analog", photons=4096)
    assert flat.provenance["run"]["max_surface_events"] == 10


def test_link_files(tmp_path):
    text = """
    [sea]
    spectrum = "leaning:LeaningWave"
    amplitude = 0.3
    wavelength = 4.0
    lean = 0.9
    extent = 6.0
    [run]
    photons = 4096
    """
    scenario = Scenario.from_toml(text)
    assert scenario.surface == WAVE
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    assert "estimator" not in scenario.to_config()["run"]
    r = scenario.simulate()
    assert r.provenance["run"]["estimator"] == "analog"
    again = Scenario.from_provenance(r.provenance)
    assert again.surface == WAVE
    assert again.simulate().gain == r.gain
    # the same from a file of the mesh
    file = tmp_path / "wave.ply"
    WAVE.mesh(extent=40.0, spacing=0.4).to_trimesh().export(file)
    meshed = Scenario.from_toml(f'[sea]\nmesh = "{file}"\n[run]\nphotons = 4096')
    assert meshed.simulate().provenance["run"]["estimator"] == "analog"
    with pytest.raises(mt.Refused, match=r"sea\.mesh: overhangs"):
        Scenario.from_toml(f'[sea]\nmesh = "{file}"\n[run]\nestimator = "forced"').simulate()


def test_exported_overhangs_load_back(leaning):
    small = WAVE.mesh(extent=3.0, spacing=0.2)
    loaded = from_trimesh(small.to_trimesh(), overhangs=True, extent=2.9)
    assert loaded.facing_down == small.facing_down > 0
    with pytest.raises(mt.Refused, match="facets face down"):
        from_trimesh(small.to_trimesh())
