"""The light pattern agrees with forced detection and keeps the light."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea, TiltedPlane, resolved_sea

SHARP = mt.Link(physics={"unresolved": "none"})
SEA = resolved_sea(5.0, fetch=30e3, seed=3).model_copy(update={"omega_max": 16.0})


def disk_mean(pattern, radius):
    """Return the mean of the gain over a disk about the middle."""
    x, y = np.meshgrid(pattern.x, pattern.y, indexing="ij")
    return pattern.gain[np.hypot(x, y) < radius].mean()


@pytest.mark.filterwarnings("ignore::meshtrace.FewSamplesWarning")  # of scattered light
@pytest.mark.parametrize(
    ("link", "sea", "rel"),
    [
        (SHARP, FlatSea(), 0.01),
        (SHARP, TiltedPlane(slope_x=0.05), 0.01),
        (SHARP, SinusoidalSea(amplitude=0.02, wavelength=3.0), 0.02),
        (SHARP, SEA, 0.06),  # caustics cross the edge of the aperture
        (mt.Link(), SEA, 0.01),
        (SHARP.replace("whitecaps", mt.Whitecaps(wind_speed=8.0)), FlatSea(height=0.2), 0.01),
        (SHARP, JonswapSea(wind_speed=5.0, omega_max=9.0, choppy=True, seed=2), 0.02),
    ],
    ids=["flat", "plane", "sine", "resolved", "tilts", "foam", "choppy"],
)
@pytest.mark.thorough
@pytest.mark.slow_but("tilts", "choppy")
def test_it_agrees_with_forced_detection(link, sea, rel):
    radius = link.receiver.radius
    pattern = mt.light_pattern(link, sea, extent=0.1, step=0.01)
    forced = mt.simulate(link, sea, photons=32, spacing=None if sea is SEA else 0.02)
    assert disk_mean(pattern, radius) == pytest.approx(forced.gain_ballistic, rel=rel)


@pytest.mark.parametrize(
    "changes",
    [
        {"bubbles": mt.HallNovarini(wind_speed=12.0)},
        {"water": mt.Water(layers=[(0.0, 0.05, 0.02), (4.0, 0.05, 0.1), (9.0, 0.3, 0.1)])},
    ],
    ids=["bubbles", "layers"],
)
def test_bubbles_and_layers_dim_it(changes):
    link = SHARP.model_copy(update=changes)
    pattern = mt.light_pattern(link, FlatSea(), extent=0.1, step=0.01)
    gain = mt.simulate(link, FlatSea(), photons=32).gain_ballistic
    assert disk_mean(pattern, link.receiver.radius) == pytest.approx(gain, rel=0.01)


def test_light_far_aside_is_seen_where_it_lands():
    aside = mt.Link(receiver=mt.Receiver(position=(1.5, -0.5)), physics=SHARP.physics)
    pattern = mt.light_pattern(aside, SEA, extent=0.5, step=0.02)
    whole = mt.light_pattern(SHARP, SEA, extent=2.0, step=0.02)
    at = (np.abs(whole.x - 1.5) < 0.5, np.abs(whole.y + 0.5) < 0.5)
    # the patch of the surface is another: rays sample the pattern at other places
    coarse = [
        g.reshape(10, 5, 10, 5).mean(axis=(1, 3)) for g in (pattern.gain, whole.gain[np.ix_(*at)])
    ]
    np.testing.assert_allclose(coarse[0], coarse[1], rtol=0.05, atol=0.05 * whole.gain.mean())


def test_tilts_blur_and_keep_the_light():
    sharp, blurred = (mt.light_pattern(link, SEA, 2.0, 0.02) for link in (SHARP, mt.Link()))
    assert blurred.gain.mean() == pytest.approx(sharp.gain.mean(), rel=0.02)
    assert blurred.gain.std() < 0.6 * sharp.gain.std()


def test_the_field_of_view_and_the_axis_of_the_receiver_count():
    narrow = mt.light_pattern(SHARP.replace("receiver.fov_deg", 1.0), FlatSea(), 2.0, 0.05)
    assert (narrow.gain > 0.0).mean() < 0.1  # light at x arrives at an angle
    tilted = SHARP.replace("receiver.tilt_deg", 20.0)
    level, turned = (mt.light_pattern(link, FlatSea(), 0.1, 0.02) for link in (SHARP, tilted))
    assert turned.gain.mean() / level.gain.mean() == pytest.approx(
        np.cos(np.radians(20.0)), rel=1e-3
    )


def test_other_links_are_refused():
    beam = mt.Link(transmitter=mt.GaussianBeam())
    with pytest.raises(mt.Refused, match="transmitter: gaussian-beam, allowed: one LED"):
        mt.light_pattern(beam, FlatSea())
    with pytest.raises(mt.Refused, match=r"step: 1\.0, allowed: 0\.002 to 0\.5 m"):
        mt.light_pattern(mt.Link(), FlatSea(), extent=2.0, step=1.0)
    with pytest.raises(mt.Refused, match=r"extent: -1\.0, allowed: 0 < extent"):
        mt.light_pattern(mt.Link(), FlatSea(), extent=-1)
    with pytest.raises(mt.Refused, match="surface: TriangleMesh, allowed: a sea"):
        mt.light_pattern(mt.Link(), FlatSea().mesh())
    with pytest.raises(mt.Refused, match=r"step: 0\.001, allowed: 0\.05 to 12\.5 m"):
        mt.light_pattern(mt.Link(), FlatSea(), extent=50.0, step=0.001)
