"""Links without a point source or with a bottom: forced detection against analog photons."""

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.surfaces import FlatSea, JonswapSea

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore:.*effective sample size:meshtrace.FewSamplesWarning"),
]

KILL = mt.Physics(reflected="kill", unresolved="none")
WIDE = mt.Receiver(radius=0.7, fov_deg=120.0, height=4.0)
BRIGHT = mt.Water(a=0.1, b=0.1, bottom_depth=6.0, bottom_albedo=0.8)
SEA = JonswapSea(wind_speed=8.0, seed=4)
LINKS = {
    "lamp of 1 m": (mt.Link(transmitter=mt.TopHatBeam(depth=5.0, divergence_deg=15.0, radius=1.0),
                            receiver=WIDE, physics=KILL), FlatSea()),
    "wide beam": (mt.Link(transmitter=mt.GaussianBeam(depth=5.0, divergence_deg=10.0, waist=0.6),
                          receiver=WIDE, physics=KILL), SEA),
    "bottom": (mt.Link(transmitter=mt.IsotropicSource(depth=5.0), water=BRIGHT, receiver=WIDE,
                       physics=KILL), SEA),
    "lamp to the bottom": (mt.Link(transmitter=mt.Led(depth=3.0, zenith_deg=180.0), water=BRIGHT,
                                   receiver=WIDE, physics=KILL), FlatSea()),
    "bottom and surface": (mt.Link(transmitter=mt.IsotropicSource(depth=5.0), water=BRIGHT,
                                   receiver=WIDE), FlatSea()),
}  # fmt: skip


@pytest.mark.parametrize("name", LINKS)
@pytest.mark.thorough
@pytest.mark.slow_but("bottom", "lamp to the bottom", "bottom and surface")
def test_analog_agrees(name):
    link, sea = LINKS[name]
    f = mt.simulate(link, sea, photons=16_000, seed=3, spacing=0.2, threads=1)
    a = mt.simulate(link, sea, "analog", photons=400_000, seed=4, spacing=0.2, threads=1)
    assert a.gain_stderr < 0.05 * a.gain
    assert f.gain_stderr < 0.03 * f.gain
    p = z_test(f.gain, f.gain_stderr, a.gain, a.gain_stderr)
    assert p > sidak(ALPHA, len(LINKS)), f"{f.gain} +- {f.gain_stderr}, analog {a.gain}"


def test_light_of_surface_and_bottom_is_traced_by_default():
    link, sea = LINKS["bottom and surface"]
    both = mt.simulate(link, sea, photons=2000, spacing=0.5)
    assert both.gain_reflected > 1e-4 * both.gain
    killed = mt.simulate(link.replace(physics=KILL), sea, photons=2000, spacing=0.5)
    assert killed.gain_reflected is None


@pytest.mark.slow
def test_the_errors_of_an_extended_lamp_are_true():
    """Scatter of independent runs over the stated error, chi-square of 15 degrees of freedom."""
    link, sea = LINKS["lamp of 1 m"]
    link = link.replace("receiver.radius", 0.2)
    runs = [mt.simulate(link, sea, photons=1024, seed=s, spacing=0.5) for s in range(16)]
    scatter = np.std([r.gain for r in runs], ddof=1)
    assert 0.5 < scatter / np.mean([r.gain_stderr for r in runs]) < 1.7


@pytest.mark.thorough
def test_arrivals_of_an_extended_lamp_add_up():
    link, sea = LINKS["lamp of 1 m"]
    link = link.replace("receiver.radius", 0.2)
    found = mt.simulate(link, sea, photons=256, spacing=0.5, record=[mt.Arrivals()])
    assert found.arrivals.weight.sum() == pytest.approx(found.gain, rel=1e-9)


def test_what_joined_photons_do_not_follow_is_refused():
    link = LINKS["bottom"][0].replace(physics=mt.Physics(snell="paper"))
    with pytest.raises(Refused, match=r"water.bottom_depth: 6.*allowed: a point source.*analog"):
        mt.simulate(link, FlatSea())
