"""Forced detection beside bodies: shadows and reflections against closed forms and analog photons.

Bodies under water reflect, those in the air are black. Apertures that analog photons are to hit are
wide.
"""

import math

import numpy as np
import pytest
import trimesh
from scipy import stats

import meshtrace as mt
from meshtrace.engine import straight
from meshtrace.engine.chains.aimed import AimedChains
from meshtrace.engine.setup import ends
from meshtrace.link import Body
from meshtrace.quadrature import gauss_legendre
from meshtrace.results import tallies
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea

CLEAR = mt.Water(a=0.0, b=0.0)
BODIES, BOTTOM = (tallies.ONE_SIDE_PARTS[name] for name in ("bodies", "bottom"))


def plate(half):
    """Return a level square of two facets about the origin."""
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    return mt.TriangleMesh(corners, [(0, 1, 2), (0, 2, 3)])


def disk(radius, n=128):
    """Return a level disk about the origin, a polygon of the area of the circle."""
    angle = 2.0 * math.pi * np.arange(n) / n
    radius *= math.sqrt(math.pi / (0.5 * n * math.sin(2.0 * math.pi / n)))
    rim = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])
    faces = np.column_stack([np.full(n, n), np.arange(n), (np.arange(n) + 1) % n])
    return mt.TriangleMesh(np.vstack([rim, [(0.0, 0.0, 0.0)]]), faces)


def ball(radius):
    """Return a sphere about the origin whose silhouettes have the area of the circle."""
    solid = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    # the mean silhouette of a convex body is a quarter of its surface
    solid.apply_scale(math.sqrt(4.0 * math.pi * radius**2 / solid.area))
    return mt.TriangleMesh(solid.vertices, solid.faces, overhangs=True)


# ---- shadows: light without noise ---------------------------------------------------------------


def straight_gain(link):
    forced = ends.forced_link(link)
    gain, error = straight.straight_gains(forced, None, forced.medium, 0, 0)
    return gain, error * gain


@pytest.mark.parametrize("aside", [0.0, 0.1, 0.3])
def test_a_disk_takes_the_light_onto_it(aside):
    lamp = mt.Led(depth=4.0, zenith_deg=180.0, half_angle_deg=20.0)
    end = mt.WaterReceiver(depth=8.0, radius=1.1, fov_deg=180.0)
    link = mt.Link(water=mt.Water(a=0.1, b=0.2), transmitter=lamp, receiver=end)
    whole, _ = straight_gain(link)
    body = Body(disk(0.2), reflection="black", position=(aside, 0.0, -6.0))
    left, error = straight_gain(link.replace(objects=body))
    # light onto the disk would go on to the aperture, through as much water again
    clear = link.replace(water=CLEAR)
    onto, _ = straight_gain(
        clear.replace(receiver=end.replace(depth=6.0, radius=0.2, position=(aside, 0.0)))
    )
    open_water, _ = straight_gain(clear)
    shaded, clear_error = straight_gain(clear.replace(objects=body))
    assert open_water - shaded == pytest.approx(onto, abs=3.0 * clear_error + 2e-4 * onto)
    assert clear_error < 3e-4 * open_water
    assert 0.0 < left < whole - 5.0 * error


def test_shadow_of_a_sphere():
    lamp = mt.Led(depth=4.0, zenith_deg=180.0, half_angle_deg=20.0)
    end = mt.WaterReceiver(depth=8.0, radius=1.5, fov_deg=180.0)
    body = Body(ball(0.3), reflection="black", position=(0.0, 0.0, -6.0))
    link = mt.Link(water=CLEAR, transmitter=lamp, receiver=end, objects=body)
    # cos^m within a cone: 1 - cos^(m + 1)
    power = lamp.order + 1.0
    silhouette, rim = math.cos(math.asin(0.3 / 2.0)), math.cos(math.atan2(1.5, 4.0))
    expected = silhouette**power - rim**power
    gain, error = straight_gain(link)
    assert gain == pytest.approx(expected, abs=3.0 * error + 1e-3 * expected)


def through_gain(link, mesh):
    aimed = AimedChains(ends.forced_link(link), mesh, "vertex", link.physics.unresolved)
    gain = float(aimed.direct_light(0, 0)[0])
    return gain, aimed.relative_error(0, 0) * gain


@pytest.mark.parametrize("level", [-3.0, 2.0], ids=["water", "air"])
def test_shadow_of_a_disk_through_still_water(level):
    link = mt.Link(
        water=mt.Water(a=0.05, b=0.0),
        transmitter=mt.Led(depth=5.0),
        receiver=mt.Receiver(height=5.0, radius=1.0, fov_deg=180.0),
    )
    n, angle = link.water.n / link.n_air, math.radians(2.0)  # in water, at the rim of the disk
    steep = math.tan(angle), math.tan(math.asin(n * math.sin(angle)))
    radius = (5.0 + min(level, 0.0)) * steep[0] + max(level, 0.0) * steep[1]
    behind = 5.0 * steep[0] + 5.0 * steep[1]
    body = Body(disk(radius, 64), reflection="black", position=(0.0, 0.0, level))
    mesh = FlatSea().mesh(0.0, extent=20.0, spacing=1.0)
    whole, _ = through_gain(link, mesh)
    inside, _ = through_gain(link.replace("receiver.radius", behind), mesh)
    left, error = through_gain(link.replace(objects=body), mesh)
    assert left == pytest.approx(whole - inside, abs=4.0 * error + 1e-4 * whole)
    assert error < 0.02 * whole
    wide = Body(disk(3.0, 16), reflection="black", position=(0.0, 0.0, level))
    assert through_gain(link.replace(objects=wide), mesh)[0] == 0.0


# ---- reflections ---------------------------------------------------------------------------------


def lit_plate(reflection="lambert"):
    """Return a lamp over a plate, seen by a receiver aside whose view ends below the surface."""
    lamp = mt.Led(depth=6.0, zenith_deg=180.0, half_angle_deg=15.0)
    end = mt.WaterReceiver(
        depth=6.0, position=(2.0, 0.0), radius=0.1, fov_deg=90.0, tilt_deg=135.0,
        tilt_azimuth_deg=180.0,
    )  # fmt: skip
    body = Body(plate(0.5), albedo=0.5, reflection=reflection, position=(0.0, 0.0, -8.0))
    return mt.Link(water=mt.Water(a=0.1, b=0.0), transmitter=lamp, receiver=end, objects=body)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_plate_under_a_lamp():
    link = lit_plate()
    result = mt.simulate(link, FlatSea(), photons=4096, seed=1)
    lamp, end = link.transmitter, link.receiver
    nodes, weights = gauss_legendre(24)
    x, y = np.meshgrid(0.5 * nodes, 0.5 * nodes, indexing="ij")
    area = np.multiply.outer(weights, weights) * 0.25
    down, across = 2.0, np.hypot(x, y)
    first = np.hypot(down, across)
    cos_lamp = down / first
    irradiance = (lamp.order + 1) / (2 * math.pi) * cos_lamp ** (lamp.order + 1) / first**2
    way = np.stack([2.0 - x, -y, np.full_like(x, down)], axis=-1)
    second = np.linalg.norm(way, axis=-1)
    cosines = (way[..., 2] / second) * (way @ np.array(end.axis) / second)
    seen = 0.5 / math.pi * cosines / second**2 * math.pi * end.radius**2
    # the aperture is small: its centre stands for it, to 1e-3
    expected = float((area * irradiance * seen * np.exp(-0.1 * (first + second))).sum())
    noise = result.gain_part_stderr[0, BODIES]
    assert noise < 0.01 * expected
    assert abs(result.gain_parts["bodies"] - expected) < 4.0 * noise + 1e-3 * expected
    assert result.gain == pytest.approx(result.gain_parts["bodies"], rel=1e-9)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_integrating_sphere():
    """Energy of a closed box: the n-th reflection has albedo^n of the power."""
    body = Body(ball(2.0), albedo=0.6, position=(0.0, 0.0, -6.0))
    # looks up from above Lambert's lamp, which lights the lower half alone
    end = mt.WaterReceiver(depth=5.0, radius=0.1, fov_deg=180.0)
    lamp = mt.Led(depth=6.0, half_angle_deg=60.0, zenith_deg=180.0)
    link = mt.Link(water=CLEAR, transmitter=lamp, receiver=end, objects=body)
    result = mt.simulate(link, FlatSea(), photons=2048, seed=2)
    # what reaches a sphere from within is reflected evenly over all of it: from the second
    # reflection on rho^n P / (4 pi R^2) arrive anywhere
    expected = 0.1**2 / (4.0 * 2.0**2) * 0.6**2 / (1.0 - 0.6)
    noise = result.gain_part_stderr[0, BODIES]
    assert noise < 0.04 * expected
    assert abs(result.gain_parts["bodies"] - expected) < 4.06 * noise + 0.004 * expected


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_plane_body_is_the_bottom():
    lamp = mt.Led(depth=4.0, zenith_deg=180.0)
    end = mt.WaterReceiver(
        depth=3.0, position=(1.0, 0.0), radius=0.2, fov_deg=120.0, tilt_deg=180.0
    )
    water = mt.Water(a=0.05, b=0.1)
    as_bottom = water.replace(bottom_depth=8.0, bottom_albedo=0.6)
    body = Body(plate(200.0), albedo=0.6, position=(0.0, 0.0, -8.0))
    bottom = mt.simulate(
        mt.Link(water=as_bottom, transmitter=lamp, receiver=end), FlatSea(), photons=2048, seed=1
    )
    plane = mt.simulate(
        mt.Link(water=water, transmitter=lamp, receiver=end, objects=body),
        FlatSea(),
        photons=2048,
        seed=1,
    )
    for one, other in (("bottom", "bodies"), ("scattered", "scattered")):
        i, k = (tallies.ONE_SIDE_PARTS[name] for name in (one, other))
        error = math.hypot(bottom.gain_part_stderr[0, i], plane.gain_part_stderr[0, k])
        assert abs(bottom.gain_part[0, i] - plane.gain_part[0, k]) < 4.06 * error
    assert bottom.gain_parts["bottom"] > 20.0 * bottom.gain_part_stderr[0, BOTTOM]


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_hits_count_the_light_of_a_mirror():
    link = lit_plate("mirror").replace("receiver.radius", 0.6)
    wide = link.objects[0].replace(mesh=plate(1.5), sha256=None)
    link = link.replace("receiver.tilt_deg", 150.0).replace(objects=wide)
    link = link.replace("transmitter.half_angle_deg", 30.0)
    result = mt.simulate(link, FlatSea(), photons=4096, seed=1)
    # the image of the lamp below the plate, whose edge a black frame of the same size stands for
    lamp = link.transmitter.replace(depth=10.0, zenith_deg=0.0)
    frame = frame_of(1.5, 30.0)
    image = link.replace(
        transmitter=lamp, objects=Body(frame, reflection="black", position=(0.0, 0.0, -8.0))
    )
    expected, error = straight_gain(image)
    noise = result.gain_part_stderr[0, BODIES]
    assert noise < 0.1 * expected
    deviation = result.gain_parts["bodies"] - 0.5 * expected
    assert abs(deviation) < 4.06 * math.hypot(noise, error)


def frame_of(inner, outer):
    """Return a level plane up to `outer` with a square hole up to `inner`."""
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    points = [(s * x, s * y, 0.0) for s in (inner, outer) for x, y in corners]
    faces = [(i, 4 + i, 4 + (i + 1) % 4) for i in range(4)]
    faces += [(i, 4 + (i + 1) % 4, (i + 1) % 4) for i in range(4)]
    return mt.TriangleMesh(points, faces)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_threads_leave_the_digits():
    link = lit_plate().replace(water=mt.Water(a=0.1, b=0.3))
    one, two = (mt.simulate(link, FlatSea(), photons=256, seed=1, threads=n) for n in (1, 3))
    np.testing.assert_array_equal(one.gain_part, two.gain_part)
    np.testing.assert_array_equal(one.gain_part_stderr, two.gain_part_stderr)


# ---- what is refused -----------------------------------------------------------------------------


def test_light_that_nobody_follows_is_refused():
    hull = Body(ball(1.0), albedo=0.3, position=(0.0, 0.0, -0.5))
    link = lit_plate().replace(objects=hull)
    with pytest.raises(mt.Refused, match=r'objects\[0\]: a body that reflects.*"analog"') as error:
        mt.simulate(link, FlatSea(), photons=64)
    assert "\n" not in str(error.value)
    down = mt.Link(
        transmitter=mt.AirLed(height=3.0),
        receiver=mt.WaterReceiver(depth=5.0),
        objects=Body(plate(0.5), reflection="mirror", position=(0.0, 0.0, -8.0)),
    )
    with pytest.raises(mt.Refused, match=r"objects\[0\]\.reflection"):
        mt.simulate(down, FlatSea(), photons=64)
    with pytest.raises(mt.Refused, match="objects: 1 of them"):
        down.require_chains()


# ---- analog photons ------------------------------------------------------------------------------


def facing(center, at):
    """Return (tilt from straight up, azimuth) in degrees of the way from a place to another."""
    way = np.subtract(at, center)
    tilt = math.degrees(math.acos(way[2] / np.linalg.norm(way)))
    return tilt, math.degrees(math.atan2(way[1], way[0])) % 360.0


def random_bodies(rng, direction):
    """Return a reflecting body below the ends, and one that hides, in the water or in the air."""
    kinds = ["lambert", "mirror"] if direction != "down" else ["lambert"]
    solids = [plate(2.5), ball(1.5), ball(1.2)]
    reef = Body(
        solids[rng.integers(3)], albedo=float(rng.uniform(0.2, 0.9)),
        reflection=kinds[rng.integers(len(kinds))],
        position=(*rng.uniform(-2.0, 2.0, 2), float(rng.uniform(-9.5, -8.5))),
        rotation_deg=tuple(rng.uniform(-20.0, 20.0, 3)),
    )  # fmt: skip
    level = rng.uniform(-4.5, -3.0) if direction == "under" or rng.random() < 0.5 else 1.5
    hiding = Body(
        ball(0.7), reflection="black", position=(*rng.uniform(-1.0, 1.0, 2), float(level))
    )
    return reef, hiding


def random_link(rng, direction):
    """Return a link beside two bodies, and the sea."""
    a, b = [(0.114, 0.037), (0.179, 0.219), (0.3, 0.6)][rng.integers(3)]
    places = rng.uniform(-2.0, 2.0, (2, 2))
    low, high = (float(rng.uniform(5.0, 7.0)), float(rng.uniform(2.5, 4.0)))
    reef = np.array([0.0, 0.0, -9.0])
    lamp_down = direction in ("under", "up") and rng.random() < 0.6
    wide = float(rng.uniform(15.0, 50.0))
    if direction in ("under", "up"):
        z = float(rng.uniform(1.5, 6.0)) if direction == "under" else low
        tilt, azimuth = facing([*places[0], -z], reef if lamp_down else [*places[1], high])
        kind = (mt.Led, mt.TopHatBeam)[rng.integers(2)]
        name = "half_angle_deg" if kind is mt.Led else "divergence_deg"
        lamp = kind(
            depth=z, position=tuple(places[0]), zenith_deg=tilt, azimuth_deg=azimuth, **{name: wide}
        )
    else:
        lamp = mt.AirLed(height=high, position=tuple(places[0]), half_angle_deg=wide)
    fields = {"position": tuple(places[1]), "radius": float(rng.uniform(0.8, 1.5))}
    fields["fov_deg"] = float(rng.choice([120.0, 180.0]))
    if direction in ("up", "over"):
        end = mt.Receiver(height=float(rng.uniform(2.5, 4.0)), **fields)
    else:
        tilt, azimuth = facing([*places[1], -low], reef)
        end = mt.WaterReceiver(depth=low, **fields)
        if direction == "under":
            end = end.replace(tilt_deg=tilt, tilt_azimuth_deg=azimuth)
    seas = [
        FlatSea(),
        SinusoidalSea(amplitude=0.05, wavelength=2.0),
        JonswapSea(wind_speed=4.0, seed=3),
    ]
    sea = seas[rng.integers(3)]
    water = mt.Water(a=a, b=b)
    link = mt.Link(water=water, transmitter=lamp, receiver=end)
    return link.replace(objects=random_bodies(rng, direction)), sea


def deviations(number, direction, photons, analog, seed=11):
    """Return the deviations of forced from analog gains, over their errors, of random links."""
    z = []
    for i in range(number):
        link, sea = random_link(np.random.default_rng([seed, i]), direction)
        try:
            forced = mt.simulate(link, sea, photons=photons, seed=i + 1, extent=40.0)
        except mt.Refused as error:  # a mirror for light that goes down
            assert "reflection" in str(error)
            continue
        hits = mt.simulate(
            link, sea, "analog", photons=analog, seed=i + 1000, extent=40.0, threads=2
        )
        if hits.gain > 8.0 * hits.gain_stderr:
            error = math.hypot(forced.gain_stderr, hits.gain_stderr)
            z.append((forced.gain - hits.gain) / error)
            print(
                direction,
                i,
                type(sea).__name__,
                link.objects[0].reflection,
                z[-1],
                forced.gain,
                forced.gain_stderr,
                hits.gain,
                hits.gain_stderr,
            )
    return np.array(z)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("reflection", ["lambert", "mirror"])
@pytest.mark.slow
def test_stated_errors_are_true(reflection):
    link = lit_plate(reflection).replace(water=mt.Water(a=0.1, b=0.2))
    link = link.replace("receiver.radius", 0.5)
    results = [mt.simulate(link, FlatSea(), photons=256, seed=k) for k in range(1, 65)]
    gains = np.array([result.gain for result in results])
    variance = np.mean([result.gain_stderr**2 for result in results])
    # wider than chi-square's bounds, as stated errors scatter, too
    assert 0.4 < gains.var(ddof=1) / variance < 2.5


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("direction", ["under", "up", "over", "down"])
@pytest.mark.slow
def test_random_links_agree_with_analog_photons(direction):
    z = deviations(14 if direction == "under" else 6, direction, photons=4000, analog=400_000)
    assert len(z) >= 4
    # two-sided, at 1e-4: errors that are too large fail as well
    assert stats.chi2.ppf(5e-5, len(z)) < z @ z < stats.chi2.isf(5e-5, len(z))
