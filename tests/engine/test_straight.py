"""Light straight from lamp to receiver in one medium: closed forms, scipy, and rays by the million.

Gains of any-link.md are those of its own codes.
"""

import math

import numpy as np
import pytest
from scipy import integrate

import meshtrace as mt
from meshtrace.engine import straight
from meshtrace.engine.setup import ends
from meshtrace.kernels import vectors
from meshtrace.mesh import TriangleMesh

CLEAR = mt.Water(a=0.114, b=0.037, n=1.33)
DARK = mt.Water(a=0.0, b=0.0)


def ahead(lamp, distance, radius, aside=0.0, water=CLEAR, fov_deg=180.0, depth=50.0, up=0.0):
    """Return a link along +x to a receiver that looks back along -x."""
    receiver = mt.WaterReceiver(
        depth=depth - up, position=(distance, aside), radius=radius, fov_deg=fov_deg,
        tilt_deg=90.0, tilt_azimuth_deg=180.0,
    )  # fmt: skip
    return mt.Link(water=water, transmitter=lamp, receiver=receiver)


def led(half_angle_deg=10.0, zenith_deg=90.0, depth=50.0, azimuth_deg=0.0):
    return mt.Led(
        depth=depth, zenith_deg=zenith_deg, half_angle_deg=half_angle_deg, azimuth_deg=azimuth_deg
    )


def top_hat(divergence_deg, azimuth_deg=0.0, zenith_deg=90.0, depth=50.0):
    return mt.TopHatBeam(
        depth=depth, zenith_deg=zenith_deg, divergence_deg=divergence_deg, azimuth_deg=azimuth_deg
    )


def gaussian(divergence_deg, azimuth_deg=0.0):
    return mt.GaussianBeam(
        depth=50.0, zenith_deg=90.0, divergence_deg=divergence_deg, azimuth_deg=azimuth_deg
    )


def gain_of(link, mesh=None, at=None):
    """Return gain and relative error of the only pair of a link."""
    forced = ends.forced_link(link)
    surface = None if mesh is None else mt.EmbreeIntersector(forced.frame.mesh(mesh), 1)
    return straight.straight_gains(forced, surface, forced.medium, 0, 0, at)


def over_disk(link, radius, intensity):
    """Return the gain by scipy, over a disk that faces -x; `intensity` of the unit direction."""
    lamp, end = np.array(link.transmitter.center), np.array(link.receiver.center)
    c = link.water.a + link.water.b

    def light(phi, r):
        way = end + np.array([0.0, r * math.cos(phi), r * math.sin(phi)]) - lamp
        length = float(np.linalg.norm(way))
        w = way / length
        return r * intensity(w) * w[0] / length**2 * math.exp(-c * length)

    options = {"epsabs": 0.0, "epsrel": 1e-9}
    return integrate.dblquad(light, 0.0, radius, 0.0, 2.0 * math.pi, **options)[0]


# ---- figures of other codes --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lamp", "distance", "radius", "depth", "gain", "rtol"),
    [
        # these two take the light for even over the disk: (R / d)^2 (m + 4) / 4 too much
        (led(depth=4.0), 10.0, 0.05, 4.0, 1.27750e-4, 4e-4),
        (led(), 20.0, 0.05, 50.0, 7.058e-6, 2e-4),
        # photons counted where they hit the disk, of a noise of about 1 %
        (led(), 20.0, 0.5, 50.0, 6.921e-4, 0.03),
    ],
)
def test_published_gains(lamp, distance, radius, depth, gain, rtol):
    value, error = gain_of(ahead(lamp, distance, radius, depth=depth))
    print(value, error, value / gain - 1.0)
    assert value == pytest.approx(gain, rel=rtol)
    assert 1e-9 <= error < 1e-6


# ---- closed forms ------------------------------------------------------------------------------


@pytest.mark.parametrize(("distance", "radius"), [(20.0, 0.5), (1.0, 3.0), (0.01, 0.5)])
def test_disk_in_water(distance, radius):
    """The integral of (m + 1) cos^m sin exp(-c d / cos) over the angles of a disk on the axis."""
    link = ahead(led(), distance, radius)
    order, c = link.transmitter.order, link.water.c

    def light(theta):
        cosine = math.cos(theta)
        return (order + 1) * cosine**order * math.sin(theta) * math.exp(-c * distance / cosine)

    expected = integrate.quad(light, 0.0, math.atan(radius / distance), epsrel=1e-12)[0]
    assert gain_of(link)[0] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("distance", [1e-3, 0.05, 3.0])
def test_disk_facing_a_led(distance):
    """Without attenuation a disk on the axis collects 1 - cos^(m + 1) of its half-angle."""
    link = ahead(led(60.0), distance, 0.5, water=DARK)
    value, error = gain_of(link)
    expected = 1.0 - math.cos(math.atan2(0.5, distance)) ** (link.transmitter.order + 1.0)
    assert value == pytest.approx(expected, rel=1e-8)
    assert abs(value / expected - 1.0) <= max(error, 1e-12)


@pytest.mark.parametrize("half_deg", [1e-3, 0.01, 1.0, 20.0])
@pytest.mark.parametrize("kind", [led, top_hat, gaussian])
def test_narrow_beam_on_a_wide_disk(kind, half_deg):
    """All of a narrow beam that hits the disk away from its centre and rim is collected."""
    link = ahead(kind(half_deg, azimuth_deg=20.0), 5.0, 50.0, water=DARK)
    value, _ = gain_of(link)
    # of the widest beams a share passes by; a Gaussian in a plane is cut off nowhere
    assert value == pytest.approx(1.0, rel=1e-7 if half_deg < 20.0 else 0.03)


def lens_area(r, big, distance):
    """Return the area that two circles share."""
    if distance <= abs(r - big):
        return math.pi * min(r, big) ** 2
    x = (distance**2 + r**2 - big**2) / (2.0 * distance)
    y = distance - x
    half = math.sqrt(r * r - x * x)
    return r * r * math.acos(x / r) + big * big * math.acos(y / big) - distance * half


@pytest.mark.parametrize("spot", [0.001, 0.03, 0.2])
@pytest.mark.parametrize("share", [-0.8, -0.3, 0.2, 0.9])
def test_top_hat_partly_beside_the_lens(spot, share):
    """The share of a narrow uniform cone that a disk on its axis' normal plane covers.

    The lens has its centre aside; the spot's centre lies `share` spots beyond its rim.
    """
    radius, distance = 0.1, 50.0
    aside = radius + share * min(spot, radius)
    half = math.degrees(math.atan(spot / distance))
    link = ahead(top_hat(half), distance, radius, aside=aside, water=DARK)
    value, error = gain_of(link)
    expected = lens_area(radius, spot, aside) / (math.pi * spot**2)
    # a plane has less light per area towards the rim, cos^3, of which (size / distance)^2 is left
    assert value == pytest.approx(expected, rel=5e-5)
    assert error < 1e-6


@pytest.mark.parametrize(("offset_deg", "half_deg"), [(0.5, 1.0), (2.0, 1.0), (3.0, 0.7)])
def test_gaussian_off_axis(offset_deg, half_deg):
    link = ahead(gaussian(half_deg, azimuth_deg=offset_deg), 10.0, 0.3, aside=0.1)
    emitter = ends.forced_link(link).emitters[0]

    def intensity(w):
        angle = math.acos(min(float(w @ np.array(emitter.axis)), 1.0))
        ratio = angle / math.sin(angle) if angle > 1e-6 else 1.0
        return emitter.norm * ratio * math.exp(-2.0 * (angle / emitter.spread) ** 2)

    assert gain_of(link)[0] == pytest.approx(over_disk(link, 0.3, intensity), rel=1e-7)


@pytest.mark.parametrize("distance", [0.01, 0.3, 4.0])
def test_led_aslant_in_water(distance):
    link = ahead(led(30.0, zenith_deg=70.0, azimuth_deg=25.0), distance, 0.4, aside=0.25)
    emitter = ends.forced_link(link).emitters[0]

    def intensity(w):
        return emitter.norm * max(float(w @ np.array(emitter.axis)), 0.0) ** emitter.spread

    assert gain_of(link)[0] == pytest.approx(over_disk(link, 0.4, intensity), rel=1e-7)


def test_stratified_water():
    """A small receiver straight above a lamp: exp of the integral of c over the layers."""
    layers = ((0.0, 0.1, 0.5), (2.0, 0.1, 0.05), (9.0, 0.3, 0.4))
    receiver = mt.WaterReceiver(depth=1.0, radius=1e-3, tilt_deg=180.0, fov_deg=180.0)
    gains = []
    for water in (mt.Water(layers=layers), DARK):
        lamp = led(20.0, zenith_deg=0.0, depth=8.0)
        gains.append(gain_of(mt.Link(water=water, transmitter=lamp, receiver=receiver))[0])
    depth = np.linspace(1.0, 8.0, 70_001)
    table = np.array(layers)
    c = np.interp(depth, table[:, 0], table[:, 1]) + np.interp(depth, table[:, 0], table[:, 2])
    expected = math.exp(-np.trapezoid(c, depth))
    assert gains[0] / gains[1] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("aside", [0.0, 0.2])
def test_view_ends_within_the_aperture(aside):
    """The view is a cone about the normal: a circle of h tan(fov / 2) about the lamp's foot."""
    link = ahead(led(50.0), 2.0, 0.4, aside=aside, water=DARK, fov_deg=10.0)
    seen = 2.0 * math.tan(math.radians(5.0))
    order = link.transmitter.order
    if aside == 0.0:
        expected = 1.0 - math.cos(math.radians(5.0)) ** (order + 1.0)
        assert gain_of(link)[0] == pytest.approx(expected, rel=1e-9)
        return
    y, z = np.meshgrid(*2 * [np.linspace(-seen, seen, 2001)], indexing="ij")
    inside = (y * y + z * z <= seen**2) & ((y - aside) ** 2 + z * z <= 0.4**2)
    square = 4.0 + y * y + z * z
    light = (order + 1) / (2 * math.pi) * (2.0 / np.sqrt(square)) ** (order + 1) / square
    expected = light[inside].sum() * (y[1, 0] - y[0, 0]) ** 2
    assert gain_of(link)[0] == pytest.approx(expected, rel=1e-3)


def test_dark_links():
    """Light behind the receiver, behind a lamp, or beside the view is none, without an error."""
    behind = ahead(led(60.0, azimuth_deg=180.0), -5.0, 0.3)
    away = ahead(top_hat(20.0, azimuth_deg=180.0), 5.0, 0.3)
    unseen = ahead(led(60.0), 5.0, 0.1, aside=5.0, fov_deg=20.0)
    for link in (behind, away, unseen):
        assert gain_of(link) == (0.0, 0.0)


@pytest.mark.parametrize("zenith_deg", [37.0, 60.0, 123.0])
def test_aslant_on_the_axis(zenith_deg):
    """Ends that face each other in any direction, up to the rounding of their places."""
    angle = math.radians(zenith_deg)
    receiver = mt.WaterReceiver(
        depth=50.0 - 7.0 * math.cos(angle), position=(7.0 * math.sin(angle), 0.0), radius=1.5,
        fov_deg=180.0, tilt_deg=180.0 - zenith_deg, tilt_azimuth_deg=180.0,
    )  # fmt: skip
    link = mt.Link(water=DARK, transmitter=led(20.0, zenith_deg), receiver=receiver)
    order = link.transmitter.order
    expected = 1.0 - math.cos(math.atan2(1.5, 7.0)) ** (order + 1.0)
    assert gain_of(link)[0] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("aside", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 37.0])
def test_lamp_in_the_plane_of_the_aperture(aside, tilt_deg):
    """A laser beside its telescope, or in it, sends nothing straight into it."""
    receiver = mt.Receiver(height=30.0, radius=0.2, fov_deg=180.0, tilt_deg=tilt_deg)
    angle = math.radians(tilt_deg)
    lamp = mt.AirTopHatBeam(
        height=30.0 + aside * math.sin(angle), position=(aside * math.cos(angle), 0.0),
        divergence_deg=0.5, tilt_deg=tilt_deg,
    )  # fmt: skip
    link = mt.Link(transmitter=lamp, receiver=receiver)
    assert gain_of(link) == (0.0, 0.0)
    wide = mt.AirLed(height=lamp.height, position=lamp.position, half_angle_deg=60.0, tilt_deg=90.0)
    assert gain_of(link.replace(transmitter=wide)) == (0.0, 0.0)


def test_points_of_a_source_and_scale():
    """A point aside is a lamp aside; a link of a tenth of the size in water as clear is as bright."""
    lamp = led(30.0)
    link, moved = ahead(lamp, 4.0, 0.2), ahead(lamp.replace(position=(0.0, 0.3)), 4.0, 0.2)
    frame = ends.forced_link(link).frame
    point = vectors.Vec3(*frame.points(np.array([0.0, 0.3, -50.0])).tolist())
    assert gain_of(link, at=point)[0] == pytest.approx(gain_of(moved)[0], rel=1e-9)
    small = ahead(
        led(30.0, depth=0.5), 0.04, 0.002, depth=0.5, water=mt.Water(a=11.4, b=3.7, n=1.33)
    )
    assert gain_of(small)[0] == pytest.approx(gain_of(link)[0], rel=1e-9)


def test_in_the_air():
    """Air takes nothing away; lamps and receivers may look up."""
    link = mt.Link(
        transmitter=mt.AirLed(height=10.0, half_angle_deg=60.0, tilt_deg=90.0),
        receiver=mt.Receiver(
            height=10.0, position=(8.0, 0.0), radius=0.5, fov_deg=180.0, tilt_deg=90.0,
            tilt_azimuth_deg=180.0,
        ),
    )  # fmt: skip
    expected = 1.0 - math.cos(math.atan2(0.5, 8.0)) ** 2
    assert gain_of(link)[0] == pytest.approx(expected, rel=1e-8)


# ---- shadows -----------------------------------------------------------------------------------


def trough(low=-1.5, half=0.4):
    """Return a level sea with a wedge of air across the line of sight, down to `low` at x = 2."""
    x, y = [-20.0, 2.0 - half, 2.0, 2.0 + half, 20.0], [-20.0, 0.05, 20.0]
    z = np.array([0.0, 0.0, low, 0.0, 0.0])
    vertices = [(a, b, z[i]) for i, a in enumerate(x) for b in y]
    faces = []
    for i in range(len(x) - 1):
        for j in range(len(y) - 1):
            a, b = 3 * i + j, 3 * (i + 1) + j
            faces += [(a, b, b + 1), (a, b + 1, a + 1)]
    return TriangleMesh(vertices=np.array(vertices), faces=np.array(faces))


@pytest.mark.parametrize("depth", [1.4, 1.5, 1.6])
def test_shadow_of_a_trough(depth):
    """Light over a straight edge: rays by the million that pass below the wedge."""
    link = ahead(led(30.0, depth=depth), 4.0, 0.3, depth=depth, water=DARK)
    value, error = gain_of(link, trough())
    # points of the disk in equal areas: the edge crosses half-way to it
    r = 0.3 * np.sqrt((np.arange(2000) + 0.5) / 2000)
    phi = 2.0 * math.pi * (np.arange(2000) + 0.5) / 2000
    y, z = r * np.cos(phi)[:, None], r * np.sin(phi)[:, None]
    square = 16.0 + y * y + z * z
    order = link.transmitter.order
    light = (order + 1) / (2 * math.pi) * (4.0 / np.sqrt(square)) ** (order + 1) / square
    # a point of height z on the disk is seen under z / 2 at the wedge
    free = -depth + 0.5 * z < -1.5
    expected = (light * free).mean() * math.pi * 0.3**2
    print(value, expected, error)
    assert value == pytest.approx(expected, rel=2e-3)
    assert abs(value / expected - 1.0) < error + 1e-3
    whole, _ = gain_of(link)
    assert value < 0.999 * whole


def test_crest_hides_a_lamp_in_the_air():
    """Upside down, the trough is a crest; light below the crests alone is cut."""
    crest = trough()
    crest = TriangleMesh(vertices=crest.vertices * [1, 1, -1], faces=crest.faces)

    def link(height):
        return mt.Link(
            transmitter=mt.AirLed(height=height, half_angle_deg=60.0, tilt_deg=90.0),
            receiver=mt.Receiver(
                height=height, position=(4.0, 0.0), radius=0.2, fov_deg=180.0, tilt_deg=90.0,
                tilt_azimuth_deg=180.0,
            ),
        )  # fmt: skip

    assert gain_of(link(1.2), crest) == (0.0, 0.0)
    half, clear = gain_of(link(1.5), crest)[0], gain_of(link(1.9), crest)[0]
    assert half == pytest.approx(0.5 * clear, rel=1e-3)
    assert clear == gain_of(link(1.9))[0]
