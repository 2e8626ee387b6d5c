"""Sources and receivers closer to the surface than a millimetre are refused by name."""

import pytest

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.surfaces import SinusoidalSea

LAMPS = (mt.Led, mt.GaussianBeam, mt.TopHatBeam)
AIR_LAMPS = (mt.AirLed, mt.AirBeam, mt.AirTopHatBeam)


@pytest.mark.parametrize("distance", [1e-300, 1e-9, 1e-5, 9.9e-4])
@pytest.mark.parametrize("lamp", LAMPS)
def test_lamps_just_below_still_water(lamp, distance):
    with pytest.raises(Refused, match=r"^transmitter.depth: .* m, allowed: at least 0.001 m from"):
        mt.Link(transmitter=lamp(depth=distance))


@pytest.mark.parametrize("distance", [1e-300, 1e-5])
@pytest.mark.parametrize("lamp", AIR_LAMPS)
def test_lamps_just_above_still_water(lamp, distance):
    with pytest.raises(Refused, match=r"^transmitter.height: .*, allowed: at least 0.001 m"):
        mt.Link(transmitter=lamp(height=distance), receiver=mt.WaterReceiver())


def test_receivers():
    with pytest.raises(Refused, match=r"^receiver.height: 1e-05 m, allowed: at least 0.001 m"):
        mt.Link(receiver=mt.Receiver(height=1e-5))
    with pytest.raises(Refused, match=r"^receiver\[1\].height: 1e-05 m, allowed"):
        mt.Link(receiver=(mt.Receiver(), mt.Receiver(height=1e-5)))
    with pytest.raises(Refused, match=r"^receiver.depth: 1e-05 m, allowed: at least 0.001 m"):
        mt.Link(transmitter=mt.AirLed(), receiver=mt.WaterReceiver(depth=1e-5))


def test_other_ways_to_a_depth():
    with pytest.raises(Refused, match=r"at least 0.001 m from still water"):
        mt.Link().at_depth(1e-5)
    with pytest.raises(Refused, match=r"at least 0.001 m from still water"):
        mt.Link().replace("transmitter.depth", 1e-5)
    with pytest.raises(Refused, match=r"^transmitter.depth: 1e-05 m, allowed: at least 0.001 m"):
        mt.Scenario.from_toml("[transmitter]\ndepth = 1e-5\n")


def test_a_link_of_a_millimetre_may_be_closer():
    """All lengths of a link may be scaled; a tenth of the farthest end is left."""
    small = {"transmitter": mt.Led(depth=1e-3), "receiver": mt.Receiver(height=5e-4, radius=1e-5)}
    assert mt.Link(**small).least_distance == pytest.approx(1e-4)
    with pytest.raises(Refused, match=r"at least 0.0001 m from still water"):
        mt.Link(transmitter=mt.Led(depth=1e-3), receiver=mt.Receiver(height=9e-5))
    with pytest.raises(Refused, match=r"at least 1e-09 m from still water"):
        mt.Link(transmitter=mt.Led(depth=1e-300), receiver=mt.Receiver(height=1e-300))


def test_apertures_that_count_photons_may_be_anywhere():
    aperture = mt.WaterAperture(depth=1e-5)
    assert mt.Link(receiver=aperture).receiver.depth == 1e-5


@pytest.mark.parametrize(
    ("part", "gap", "text"),
    [
        ("transmitter.depth", 5e-4, "at least 0.001 m below the lowest trough at -0.1 m"),
        ("transmitter.depth", -5e-4, "below the lowest trough, depth > 0.1 m"),
        ("receiver.height", 5e-4, "at least 0.001 m above the highest crest at 0.1 m"),
        ("receiver.height", -5e-4, "above the highest crest, height > 0.1 m"),
    ],
)
def test_ends_close_to_waves(part, gap, text):
    mesh = SinusoidalSea(amplitude=0.1, wavelength=2.0).mesh(extent=20.0, spacing=0.125)
    low, high = mesh.bounds[:, 2]
    assert (low, high) == pytest.approx((-0.1, 0.1), abs=1e-9)
    link = mt.Link().replace(part, 0.1 + gap)
    with pytest.raises(Refused, match=f"^{part}: .* m, allowed: {text}$"):
        mt.simulate(link, mesh, photons=64)
    assert mt.simulate(mt.Link().replace(part, 0.12), mesh, photons=64).gain > 0.0
