"""Bodies in the way of analog photons: energy, shadows, mirrors, and the plane bottom."""

import math

import numpy as np
import pytest
import trimesh

import meshtrace as mt
from meshtrace.link import Body, IsotropicSource
from meshtrace.surfaces import FlatSea

Z_LIMIT = 4.06  # two-sided, alpha 5e-5 a comparison

CLEAR = mt.Water(a=0.0, b=0.0)


def mesh_of(solid):
    return mt.TriangleMesh(solid.vertices, solid.faces, overhangs=True)


def plate(half):
    """Return a level square of two facets about the origin."""
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    return mt.TriangleMesh(corners, [(0, 1, 2), (0, 2, 3)])


def run(link, photons=20_000, **options):
    # wide: hardly any light leaves sideways
    wide = mt.Meshing(extent=500.0, spacing=25.0)
    return mt.simulate(
        link, FlatSea(), estimator="analog", photons=photons, seed=7, mesh=wide, **options
    )


def weight(result, fate):
    return result.fates[fate].weight if fate in result.fates else 0.0


def boxed(albedo, **fields):
    box = mesh_of(trimesh.creation.box((4.0, 4.0, 4.0)))
    body = Body(box, albedo=albedo, position=(0.0, 0.0, -10.0), **fields)
    return mt.Link(water=CLEAR, transmitter=IsotropicSource(depth=10.0), objects=body)


@pytest.mark.parametrize("reflection", ["lambert", "mirror"])
@pytest.mark.parametrize("albedo", [1.0, 0.5])
def test_energy_of_a_closed_box(albedo, reflection):
    result = run(boxed(albedo, reflection=reflection), 2000, max_events=10, roulette=0.0)
    # ten reflections, after which the events end
    assert weight(result, "event_limit") == pytest.approx(albedo**10, abs=2e-3 * albedo**10)
    assert weight(result, "body") == pytest.approx(1.0 - albedo**10, abs=1e-12 + 2e-6)
    assert sum(tally.weight for tally in result.fates.values()) == pytest.approx(1.0, abs=1e-12)


# an isotropic lamp in clear water lights the sea up to the horizon
@pytest.mark.filterwarnings("ignore:.*left the meshed surface sideways")
def test_shadow_of_a_black_sphere():
    sphere = mesh_of(trimesh.creation.icosphere(subdivisions=4, radius=1.0))
    body = Body(sphere, reflection="black", position=(2.0, 0.0, -10.0))
    link = mt.Link(water=CLEAR, transmitter=IsotropicSource(depth=10.0), objects=body)
    n = 40_000
    share = weight(run(link, n), "body")
    # solid angle of a sphere at twice its radius, over 4 pi
    expected = 0.5 * (1.0 - math.cos(math.asin(0.5)))
    assert abs(share - expected) < Z_LIMIT * math.sqrt(expected * (1 - expected) / n) + 2e-4


def test_shadow_of_a_disk():
    angle = np.linspace(0.0, 2.0 * math.pi, 257)[:-1]
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(256)])
    turns = np.arange(256)
    faces = np.column_stack([np.full(256, 256), turns, (turns + 1) % 256])
    disk = mt.TriangleMesh(np.vstack([rim, [(0.0, 0.0, 0.0)]]), faces)
    lamp = mt.Led(depth=10.0, half_angle_deg=30.0)
    body = Body(disk, reflection="black", position=(0.0, 0.0, -8.0), scale=0.5)
    n = 40_000
    share = weight(run(mt.Link(water=CLEAR, transmitter=lamp, objects=body), n), "body")
    # intensity ~ cos^m: 1 - cos^(m + 1) lies within an angle
    expected = 1.0 - math.cos(math.atan2(0.5, 2.0)) ** (lamp.order + 1.0)
    assert abs(share - expected) < Z_LIMIT * math.sqrt(expected * (1 - expected) / n) + 1e-4


def test_plane_body_is_a_bottom():
    lamp = mt.Led(depth=5.0, zenith_deg=180.0)
    ends = {"transmitter": lamp, "receiver": mt.Receiver(radius=3.0, fov_deg=180.0)}
    water = mt.Water(a=0.05, b=0.1)
    as_bottom = water.replace(bottom_depth=9.0, bottom_albedo=0.6)
    body = Body(plate(300.0), albedo=0.6, position=(0.0, 0.0, -9.0))
    bottom = run(mt.Link(water=as_bottom, **ends), 40_000)
    plane = run(mt.Link(water=water, objects=body, **ends), 40_000)
    assert bottom.gain > 20.0 * bottom.gain_stderr
    errors = math.hypot(bottom.gain_stderr, plane.gain_stderr)
    assert abs(bottom.gain - plane.gain) < Z_LIMIT * errors


def test_mirror_shows_the_image_of_the_lamp():
    receiver = mt.Receiver(radius=2.0, fov_deg=180.0)
    water = mt.Water(a=0.1, b=0.0)
    mirror = Body(plate(300.0), albedo=0.8, reflection="mirror", position=(0.0, 0.0, -10.0))
    lamp = mt.Led(depth=5.0, zenith_deg=180.0)
    seen = run(mt.Link(water=water, transmitter=lamp, receiver=receiver, objects=mirror), 40_000)
    image = run(mt.Link(water=water, transmitter=mt.Led(depth=15.0), receiver=receiver), 40_000)
    errors = math.hypot(seen.gain_stderr, 0.8 * image.gain_stderr)
    assert image.gain > 20.0 * image.gain_stderr
    assert abs(seen.gain - 0.8 * image.gain) < Z_LIMIT * errors


@pytest.mark.parametrize(("level", "seen"), [(7.0, True), (3.0, False)])
def test_body_in_the_air_hides_what_lies_behind(level, seen):
    receiver = mt.Receiver(height=5.0, radius=2.0, fov_deg=180.0)
    roof = Body(plate(100.0), reflection="black", position=(0.0, 0.0, level))
    link = mt.Link(receiver=receiver)
    open_air = run(link, 4000)
    covered = run(link.replace(objects=(roof,)), 4000)
    if not seen:
        assert covered.gain == 0.0
        return
    errors = math.hypot(open_air.gain_stderr, covered.gain_stderr)
    assert abs(covered.gain - open_air.gain) < Z_LIMIT * errors


def test_either_side_of_the_surface_of_a_body_that_crosses_it():
    wall = Body(
        plate(60.0), albedo=1.0, reflection="mirror", position=(3.0, 0.0, 0.0),
        rotation_deg=(0.0, 90.0, 0.0),
    )  # fmt: skip
    # a vertical mirror shows lamp and receiver at 3 m those at 9 m, under water and in the air
    water = mt.Water(a=0.05, b=0.0)
    lamp = mt.Led(depth=4.0, half_angle_deg=60.0)
    near = mt.Receiver(height=3.0, position=(0.0, 0.0), radius=1.0, fov_deg=180.0)
    far = near.replace(position=(6.0, 0.0))
    mirrored = run(mt.Link(water=water, transmitter=lamp, receiver=near, objects=wall), 60_000)
    plain = run(mt.Link(water=water, transmitter=lamp, receiver=(near, far)), 60_000)
    expected, errors = plain.gain.sum(), plain.gain_stderr
    assert abs(mirrored.gain - expected) < Z_LIMIT * math.hypot(mirrored.gain_stderr, *errors)


def test_threads_and_batches_leave_the_digits():
    one, two = (run(boxed(0.7), 4096, max_events=20, threads=n) for n in (1, 2))
    assert one.fates == two.fates


def test_paths_record_bodies():
    paths = mt.trace_paths(boxed(0.9), FlatSea(), 5, seed=1)
    assert (paths.what == mt.Vertex.BODY).any()
    hits = paths.vertex[paths.what == mt.Vertex.BODY]
    np.testing.assert_allclose(np.abs(hits - (0.0, 0.0, -10.0)).max(axis=1), 2.0, atol=1e-5)


def test_each_wavelength_has_its_albedo():
    # weights at other wavelengths cannot tell the bodies that a path has met
    link = boxed([(400.0, 0.2), (600.0, 0.8)]).replace(water=mt.Water.from_type("jerlov-IB"))
    result = run(link, 2000, wavelengths_nm=[450.0, 550.0], max_events=40)
    for nm, at in zip(result.wavelength_nm, result.results, strict=True):
        assert at.fates == run(link.at_wavelength(nm), 2000, max_events=40).fates


def test_background_refuses_bodies():
    day = mt.Daylight(direct=1.0, diffuse=0.3)
    with pytest.raises(mt.Refused, match=r"objects: 1 of them"):
        mt.background(boxed(0.5), FlatSea(), day)
