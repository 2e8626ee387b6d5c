"""Links: places, paths of items, and variants in another wind or depth."""

import pytest

import meshtrace as mt
from meshtrace.errors import Refused

SOURCES = [
    mt.Led(position=(1.0, 2.0), depth=3.0),
    mt.GaussianBeam(position=(1.0, 2.0), depth=3.0, waist=0.2),
    mt.TopHatBeam(position=(1.0, 2.0), depth=3.0, radius=0.3),
    mt.IsotropicSource(position=(1.0, 2.0), depth=3.0),
    mt.Sun(position=(1.0, 2.0), zenith_deg=30.0),
    mt.UniformSky(position=(1.0, 2.0)),
    mt.CardioidalSky(position=(1.0, 2.0)),
]


@pytest.mark.parametrize("source", SOURCES, ids=lambda s: s.kind)
def test_every_source_has_a_place_and_a_direction(source):
    under_water = hasattr(source, "depth")
    assert source.center == (1.0, 2.0, -3.0 if under_water else 0.0)
    assert sum(x * x for x in source.axis) == pytest.approx(1.0)
    assert source.axis[2] == pytest.approx({"sun": -(0.75**0.5)}.get(source.kind, 0.0) or (
        1.0 if under_water else -1.0
    ))  # fmt: skip
    sizes = {"gaussian-beam": 0.2, "top-hat-beam": 0.3}
    assert source.size == sizes.get(source.kind, 0.0 if under_water else 5.0)


def test_every_aperture_has_a_place():
    assert mt.Receiver(position=(1.0, 2.0), height=4.0).center == (1.0, 2.0, 4.0)
    assert mt.WaterAperture(position=(1.0, 2.0), depth=4.0).center == (1.0, 2.0, -4.0)


def test_items_are_named_as_in_link_files():
    assert [path for path, _ in mt.Link().items()] == ["transmitter", "receiver"]
    link = mt.Link(transmitter=(mt.Sun(), mt.Led()), receiver=())
    assert [path for path, _ in link.items()] == ["transmitter[0]", "transmitter[1]"]
    with pytest.raises(Refused, match=r"^transmitter\[1\]\.depth: 10 m, allowed: less than"):
        link.replace("water.bottom_depth", 5.0)


def test_plain_data_make_sources_and_apertures():
    link = mt.Link(transmitter=[{"kind": "sun"}, {"depth": 3.0}], receiver={"height": 2.0})
    assert link == mt.Link(
        transmitter=(mt.Sun(), mt.Led(depth=3.0)), receiver=mt.Receiver(height=2)
    )
    assert mt.Link.model_validate_json(link.model_dump_json()) == link


def test_in_wind_and_at_depth():
    link = mt.Link(water=mt.Water(n=1.34), transmitter=mt.Led(wavelength_nm=520.0))
    windy = link.in_wind(13.0)
    assert windy.bubbles == mt.HallNovarini(wind_speed=13.0, n_water=1.34, wavelength_nm=520.0)
    assert (windy.wind_speed, link.wind_speed, windy.in_wind(0.0)) == (13.0, None, link)
    assert link.at_depth(7.0) == link.replace("transmitter.depth", 7.0)


def test_variants_refuse_links_that_have_none():
    several = mt.Link(transmitter=(mt.Led(), mt.Led()), receiver=(mt.Receiver(), mt.Receiver()))
    with pytest.raises(Refused, match=r"^transmitter: led, led, allowed: one source"):
        several.at_depth(3.0)
    with pytest.raises(Refused, match=r"^receiver: receiver, receiver, allowed: one receiver"):
        several.only_receiver  # noqa: B018
    with pytest.raises(Refused, match=r"^transmitter\.depth: -1.0"):
        mt.Link().at_depth(-1.0)
    assert mt.Link().only_receiver == mt.Receiver()


AIR = [
    mt.AirLed(position=(1.0, 2.0), height=3.0, tilt_deg=30.0, tilt_azimuth_deg=90.0),
    mt.AirBeam(position=(1.0, 2.0), height=3.0, waist=0.2, tilt_deg=30.0, tilt_azimuth_deg=90.0),
    mt.AirTopHatBeam(
        position=(1.0, 2.0), height=3.0, radius=0.3, tilt_deg=30.0, tilt_azimuth_deg=90.0
    ),
]


@pytest.mark.parametrize("lamp", AIR, ids=lambda s: s.kind)
def test_lamps_in_the_air_lean_from_straight_down(lamp):
    assert lamp.center == (1.0, 2.0, 3.0)
    assert lamp.axis == pytest.approx((0.0, 0.5, -(0.75**0.5)))
    receiver = mt.WaterReceiver(tilt_deg=30.0, tilt_azimuth_deg=90.0, depth=4.0)
    assert receiver.axis == pytest.approx((0.0, -0.5, -(0.75**0.5)))
    link = mt.Link(transmitter=lamp, receiver=receiver)
    assert mt.Link.model_validate_json(link.model_dump_json()) == link
    assert link.direction == "down"
    assert link.air_end == ("transmitter", lamp)
    assert (link.depth, link.at_depth(7.0).receiver.depth) == (4.0, 7.0)


def test_directions():
    assert mt.Link().direction == "up"
    assert mt.Link(transmitter=mt.Sun(), receiver=mt.WaterAperture()).direction == "down"
    assert mt.Link(transmitter=mt.Sun()).direction == "mixed"
    assert mt.Link(transmitter=(mt.Led(), mt.AirLed())).direction == "mixed"
    assert mt.Link(receiver=(mt.WaterReceiver(), mt.Receiver())).direction == "mixed"
    assert mt.Link(receiver=mt.WaterReceiver()).direction == "under"
    assert mt.Link(transmitter=mt.AirLed()).direction == "over"
    assert mt.Link().air_end == ("receiver", mt.Receiver())


@pytest.mark.parametrize(
    "lamp",
    [
        mt.Led(depth=7.0, half_angle_deg=20.0, zenith_deg=5.0, power_mw=3.0),
        mt.GaussianBeam(divergence_deg=2.0, waist=0.1, wavelength_nm=520.0),
        mt.TopHatBeam(position=(1.0, 0.0), divergence_deg=3.0, radius=0.2),
    ],
    ids=lambda s: s.kind,
)
def test_a_mirrored_link_keeps_patterns_and_places(lamp):
    end = mt.Receiver(height=6.0, radius=0.1, fov_deg=40.0, position=(0.0, 2.0), tilt_deg=7.0)
    link = mt.Link(transmitter=lamp, receiver=end)
    down = link.mirrored()
    assert down.transmitter.center == end.center
    assert down.receiver.center == lamp.center
    assert down.transmitter.pattern == lamp.kind
    assert down.transmitter.spread_deg == lamp.spread_deg
    assert (down.transmitter.power_mw, down.transmitter.size) == (lamp.power_mw, lamp.size)
    assert (down.receiver.radius, down.receiver.fov_deg) == (0.1, 40.0)
    # the axes stay: the lamp shines along the line of sight of the receiver that was there
    assert down.transmitter.axis == pytest.approx([-x for x in end.axis])
    assert [-x for x in down.receiver.axis] == pytest.approx(lamp.axis)
    assert down.mirrored() == link
    assert down.footprint() == link.footprint()


@pytest.mark.parametrize(
    "link",
    [
        mt.Link(transmitter=mt.Sun()),
        mt.Link(transmitter=mt.IsotropicSource()),
        mt.Link(receiver=mt.WaterAperture()),
        mt.Link(receiver=(mt.Receiver(), mt.Receiver())),
        mt.Link(planes=mt.IrradiancePlanes(depths=(1.0,))),
    ],
)
def test_links_without_another_direction_are_refused(link):
    with pytest.raises(Refused, match=r"^(link|planes): "):
        link.mirrored()


@pytest.mark.parametrize("value", [-1.0, 180.1, float("nan")])
def test_tilts_beyond_half_a_turn_are_refused(value):
    with pytest.raises(Refused, match=r"^(AirLed\.)?tilt_deg"):
        mt.AirLed(tilt_deg=value)
    with pytest.raises(Refused, match="tilt_deg"):
        mt.WaterReceiver(tilt_deg=value)
    with pytest.raises(Refused, match="height"):
        mt.AirLed(height=0.0)


def test_a_receiver_beyond_the_floor_is_refused():
    with pytest.raises(Refused, match=r"^receiver\.depth: 10 m, allowed: less than"):
        mt.Link(
            water=mt.Water(bottom_depth=5.0), transmitter=mt.AirLed(), receiver=mt.WaterReceiver()
        )


def test_a_link_at_another_wavelength():
    lamps = (mt.Led(), mt.GaussianBeam(wavelength_nm=450.0))
    water = mt.Water.from_type("jerlov-II", n=1.34)
    green = mt.Link(water=water, transmitter=lamps).at_wavelength(520.0)
    assert [t.wavelength_nm for t in green.transmitters] == [520.0, 520.0]
    assert green.water == mt.Water.from_type("jerlov-II", 520.0, n=1.34)
    assert mt.Link().at_wavelength(470.0) == mt.Link()
    windy = mt.Link(water=water).in_wind(8.0)
    assert windy.at_wavelength(520.0).bubbles == windy.bubbles
    with pytest.raises(Refused, match=r"^water: a 0.114, b 0.037 m-1 of one wavelength"):
        mt.Link().at_wavelength(520.0)


def test_other_words_for_a_lamp_name_the_kind():
    with pytest.raises(Refused, match="kind: 'laser', did you mean gaussian-beam"):
        mt.Link(transmitter={"kind": "laser"})
