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
    assert mt.in_wind(link, 13.0) == windy
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
