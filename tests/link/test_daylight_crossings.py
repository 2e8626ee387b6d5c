"""Where sun and sky cross the surface to a receiver: the part of the mesh that is fine."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

import meshtrace as mt
from meshtrace.link import IrradiancePlanes
from meshtrace.optics.fresnel import unit_vector

N = 1.33
SLOPE = 0.12  # standard deviation along one direction


def refracted(direction, slopes):
    """Return the directions in the water behind facets of given slopes, by Snell's law."""
    up = np.column_stack([-slopes, np.ones(len(slopes))])
    up /= np.linalg.norm(up, axis=1)[:, None]
    cosine = -up @ direction
    inside = np.sqrt(1.0 - (1.0 - cosine**2) / N**2)
    return direction / N + (cosine / N - inside)[:, None] * up, cosine


@pytest.mark.parametrize("zenith_deg", [0.0, 40.0, 70.0])
def test_sunlight_crosses_within_the_lit_patch(zenith_deg):
    """At least 0.999 of it over Gaussian slopes; the patch is no wider than half more."""
    link = mt.Link(
        transmitter=mt.Sun(zenith_deg=zenith_deg, azimuth_deg=30.0, half_width=100.0),
        receiver=mt.WaterReceiver(depth=20.0, position=(3.0, -2.0), fov_deg=180.0),
    )
    rng = np.random.default_rng(1)
    slopes = rng.normal(0.0, SLOPE, (200_000, 2))
    d, facing = refracted(np.array(link.transmitter.axis), slopes)
    lit = facing > 0.0
    crossing = np.array([3.0, -2.0]) - 20.0 * d[lit, :2] / -d[lit, 2:]
    center, half = link.lit_patch(SLOPE)
    aside = np.abs(crossing - center).max(axis=1)
    assert np.average(aside < half, weights=facing[lit]) > 0.999
    assert half < 1.5 * np.quantile(aside, 0.9999)


def test_the_lever_of_sunlight_is_the_derivative_of_its_crossing():
    for zenith in (0.0, 40.0, 70.0):
        link = mt.Link(transmitter=mt.Sun(zenith_deg=zenith), receiver=mt.WaterReceiver(depth=20.0))
        d, _ = refracted(np.array(link.transmitter.axis), np.array([[1e-5, 0.0], [-1e-5, 0.0]]))
        places = 20.0 * d[:, 0] / d[:, 2]
        (crossing,) = link.crossings()
        assert crossing.place[0] == pytest.approx(places.mean(), rel=1e-6, abs=1e-9)
        assert crossing.lever == pytest.approx(abs(np.ptp(places)) / 2e-5, rel=1e-6)


def test_skylight_crosses_up_to_the_critical_angle_or_the_edge_of_the_view():
    for fov_deg, tangent in ((180.0, 1.0 / math.sqrt(N**2 - 1.0)), (40.0, 0.36397)):
        receiver = mt.WaterReceiver(depth=20.0, fov_deg=fov_deg, radius=0.05)
        for sky in (mt.UniformSky, mt.CardioidalSky):
            link = mt.Link(transmitter=sky(half_width=100.0), receiver=receiver)
            assert link.lit_patch(0.0)[1] == pytest.approx(20.0 * tangent + 0.1, rel=1e-4)


def test_daylight_crosses_on_its_square_alone():
    receiver = mt.WaterReceiver(depth=200.0, position=(1.0, 0.0), fov_deg=180.0)
    for kind in (mt.Sun, mt.UniformSky):
        link = mt.Link(transmitter=kind(half_width=4.0), receiver=receiver)
        assert link.lit_patch(0.3)[1] <= 4.0
        assert link.footprint().fine_extent <= 5.0
    beside = mt.Link(transmitter=mt.Sun(position=(50.0, 0.0), half_width=4.0), receiver=receiver)
    center, half = beside.lit_patch(0.0)
    assert center[0] == 46.0
    assert 0.0 < half < 1.0


@pytest.mark.parametrize("end", [mt.WaterReceiver(depth=20.0), mt.WaterAperture(depth=20.0)])
def test_a_footprint_under_the_sky_is_that_of_a_lamp_at_infinity(end):
    high = mt.Link(transmitter=mt.AirLed(height=1e5), receiver=mt.WaterReceiver(depth=20.0))
    link = mt.Link(transmitter=mt.Sun(half_width=50.0), receiver=end)
    fine = high.footprint().fine_extent
    assert link.footprint().fine_extent == pytest.approx(fine, rel=1e-3)


@pytest.mark.parametrize(
    ("source", "end"), [(mt.Led(), mt.WaterReceiver(depth=5.0)), (mt.AirLed(), mt.Receiver())]
)
def test_ends_on_one_side_cross_where_the_sea_mirrors_their_light(source, end):
    (crossing,) = mt.Link(transmitter=source, receiver=end).crossings()
    assert crossing.place.tolist() == [0.0, 0.0]
    # 2 h h' / (h + h') at normal incidence
    high, other = abs(source.center[2]), abs(end.center[2])
    assert crossing.lever == pytest.approx(2.0 * high * other / (high + other))


def test_sunlight_and_receivers_in_the_air_have_no_crossing():
    link = mt.Link(transmitter=mt.Sun(), receiver=mt.Receiver())
    assert link.crossings() == []
    with pytest.raises(mt.Refused, match=r"^receiver: .*, allowed: a receiver on the other side"):
        link.lit_patch(0.1)
    # of two sources and two receivers each source crosses to the receiver opposite to it
    both = mt.Link(transmitter=(mt.Led(), mt.AirLed()),
                   receiver=(mt.Receiver(), mt.WaterAperture()))  # fmt: skip
    assert len(both.crossings()) == 2


def test_a_link_of_planes_alone_has_a_footprint_far_aside():
    lamp = mt.Led(position=(30.0, 5.0))
    link = mt.Link(transmitter=lamp, receiver=(), planes=IrradiancePlanes(depths=(1.0,)))
    assert link.footprint().center == (30.0, 5.0)


def test_a_tilted_view_of_the_sky_reaches_farther_aside():
    axis = unit_vector(25.0, 0.0)
    receiver = mt.WaterReceiver(depth=10.0, fov_deg=40.0, tilt_deg=25.0, radius=0.05)
    assert receiver.axis == pytest.approx([-x for x in axis])
    link = mt.Link(transmitter=mt.UniformSky(half_width=100.0), receiver=receiver)
    assert link.lit_patch(0.0)[1] == pytest.approx(10.0 * math.tan(math.radians(45.0)) + 0.1)


@pytest.mark.parametrize(
    ("depth", "height", "aside"), [(10.0, 10.0, 20.0), (10.0, 2.0, 20.0), (2.0, 10.0, 5.0)]
)
def test_a_slope_moves_slanted_light_by_the_lever(depth, height, aside):
    link = mt.Link(
        transmitter=mt.Led(depth=depth),
        receiver=mt.Receiver(height=height, position=(aside, 0.0)),
    )

    def crossing(slope):
        """Return x on a facet through (x, 0) where Fermat's principle holds along (1, slope)."""

        def change(x):
            up, way = np.array([x, depth]), np.array([aside - x, height])
            along = np.array([1.0, slope])
            n = link.water.n / link.n_air
            return n * (up @ along) / np.hypot(*up) - (way @ along) / np.hypot(*way)

        return brentq(change, -depth, aside + height, xtol=1e-14)

    lever = (crossing(-1e-5) - crossing(1e-5)) / 2e-5
    (there,) = link.crossings()
    assert there.place[0] == pytest.approx(crossing(0.0), rel=1e-9)
    assert there.lever == pytest.approx(lever, rel=1e-5)
