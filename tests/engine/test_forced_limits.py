"""Where forced detection could lose light in silence: it must be right, or refuse.

Each case once lost between some per cent and all of the gain without a sign of failure.
"""

import time
from functools import partial

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.engine.chains import aimed, sets
from meshtrace.engine.photons import joined
from meshtrace.engine.setup import ends
from meshtrace.surfaces import FlatSea

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore:.*effective sample size:meshtrace.FewSamplesWarning"),
]

KILL = mt.Physics(reflected="kill")
WIDE = mt.Receiver(radius=2.0, fov_deg=150.0)


def agree(link, photons, chains=10_000, tests=1):
    """Compare the estimators; a refusal in words is right too."""
    try:
        f = mt.simulate(link, FlatSea(), photons=chains, seed=3)
    except ValueError as error:
        assert 'estimator="analog"' in str(error)
        return
    a = mt.simulate(link, FlatSea(), estimator="analog", photons=photons, seed=4)
    assert a.gain_stderr < 0.05 * a.gain
    p = z_test(f.gain, f.gain_stderr, a.gain, a.gain_stderr)
    assert p > sidak(ALPHA, tests), f"{f.gain} +- {f.gain_stderr}, analog {a.gain}"


@pytest.mark.slow
def test_many_scatterings():
    """B d = 40: more orders than are kept must be said, not left out."""
    water = mt.Water(a=0.02, b=4.0)
    agree(mt.Link(water=water, receiver=WIDE, physics=KILL), 60_000)


@pytest.mark.parametrize(
    "layers",
    [
        ((0.0, 0.1, 0.0), (2.0, 0.1, 2.0)),
        ((0.0, 0.1, 0.0), (8.0, 0.1, 0.0), (9.9, 0.1, 1.5), (60.0, 0.1, 0.0)),
    ],
    ids=["turbid below", "turbid around the lamp"],
)
@pytest.mark.thorough
@pytest.mark.slow_but("turbid around the lamp")
def test_orders_follow_the_layers_on_the_way(layers):
    receiver = mt.Receiver(radius=0.5)
    agree(mt.Link(water=mt.Water(layers=layers), receiver=receiver, physics=KILL), 800_000, tests=3)


@pytest.mark.thorough
def test_a_thin_turbid_layer_below_the_surface_rests_on_photons():
    """Chains that wander there are hardly drawn: a fifth of the light would be missed."""
    water = mt.Water(layers=((0.0, 0.1, 6.0), (1.0, 0.1, 0.0), (100.0, 0.1, 0.0)))
    link = mt.Link(water=water, receiver=WIDE, physics=KILL)
    found = mt.simulate(link, FlatSea(), photons=64)
    # analog ones: the aperture is wide
    assert [row.estimator for row in found.scattered] == ["analog photons"]
    agree(link, 100_000)


@pytest.mark.thorough
def test_many_scatterings_back_and_forth():
    """Isotropic scattering of high albedo: far more orders than on the straight way."""
    water = mt.Water(a=0.02, b=1.0, phase=mt.HenyeyGreenstein(g=0.0))
    link = mt.Link(
        water=water,
        transmitter=mt.IsotropicSource(depth=2.0),
        receiver=mt.Receiver(radius=0.5, fov_deg=60.0, height=2.0),
        physics=KILL,
    )
    agree(link, 600_000)


def test_light_from_the_bottom():
    """A bright bottom 1 m below a lamp that shines down as well."""
    link = mt.Link(
        water=mt.Water(bottom_depth=6.0, bottom_albedo=0.9),
        transmitter=mt.IsotropicSource(depth=5.0),
        receiver=mt.Receiver(radius=1.0),
        physics=KILL,
    )
    agree(link, 400_000)


def test_chains_end_at_a_black_bottom():
    """Chains that dive below the bottom and come up again bring nothing."""
    link = mt.Link(
        water=mt.Water(
            a=0.05, b=0.5, phase=mt.HenyeyGreenstein(g=0.0), bottom_depth=5.05, bottom_albedo=0.0
        ),
        transmitter=mt.IsotropicSource(depth=5.0),
        receiver=mt.Receiver(radius=1.0),
        physics=KILL,
    )
    agree(link, 600_000)


@pytest.mark.parametrize("normals", ["vertex", pytest.param("facet", marks=pytest.mark.slow)])
def test_large_facets(normals):
    """A plane is a plane, whatever its triangles: scattered light too."""
    fine = FlatSea().mesh(extent=9.0, spacing=0.5)
    large = FlatSea().mesh(extent=70.0, spacing=35.0)
    a, b = (mt.simulate(mt.Link(), m, photons=1000, seed=1, normals=normals) for m in (fine, large))
    np.testing.assert_allclose(b.gain_ballistic, a.gain_ballistic, rtol=1e-4)
    error = np.hypot(a.gain_stderr, b.gain_stderr)
    assert abs(a.gain_scattered - b.gain_scattered) < 5.0 * error


def test_a_wide_view_over_a_large_flat_sea():
    """Two facets of 320 m: parts that reflect all light are not cut down to centimetres."""
    link = mt.Link(
        transmitter=mt.Led(half_angle_deg=60.0),
        receiver=mt.Receiver(position=(20.0, 0.0), fov_deg=179.0),
    )
    arrays = ends.forced_link(link)
    wide, near = (
        aimed.AimedChains(arrays, sets.flat_mesh(np.full(2, -far), np.full(2, far)))
        for far in (160.0, 20.0)
    )
    near_gain = near.direct_gains(0, 0).sum()  # compiles
    start = time.process_time()
    gain = wide.direct_gains(0, 0).sum()
    assert time.process_time() - start < 1.0  # 13 s when all parts were cut
    # 0.02 m of the facets of either mesh are taken for planes of one image
    assert gain == pytest.approx(near_gain, rel=2e-3)
    assert gain == pytest.approx(8.750e-8, rel=1e-3)


UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
LAMP, ABOVE = mt.Led(depth=8.0), mt.AirLed()


@pytest.mark.parametrize(
    ("source", "b", "height", "axis", "warned"),
    [
        (mt.Sun(half_width=2.0), 0.0, -4.0, UP, "none of 20,000 photons"),
        (mt.Sun(half_width=2.0), 0.2, -4.0, UP, "0.0"),
        (mt.Sun(half_width=2.0), 0.2, -4.0, DOWN, None),
        (mt.Sun(half_width=2.0), 0.2, -4.0, (0.5, 0.0, 0.8), "0.0"),
        (mt.Sun(half_width=2.0), 0.2, -4.0, (0.5, 0.0, -0.8), None),
        (mt.Sun(half_width=2.0, zenith_deg=60.0), 0.2, -2.0, (0.9, 0.0, 0.1), None),
        (mt.Sun(half_width=2.0, zenith_deg=60.0), 0.2, -2.0, (-0.9, 0.0, 0.1), "0.0"),
        (mt.Sun(half_width=2.0), 0.2, 5.0, UP, None),
        (mt.Sun(half_width=2.0), 0.2, 5.0, DOWN, "none of 20,000 photons"),
        (ABOVE, 0.0, -4.0, UP, "none of 20,000 photons"),
        (ABOVE, 0.2, -4.0, UP, "0.0"),
        (ABOVE, 0.2, -4.0, DOWN, None),
        (LAMP, 0.2, 5.0, UP, None),
        (LAMP, 0.0, 5.0, DOWN, "none of 20,000 photons"),
        (LAMP, 0.2, -4.0, UP, None),
        (LAMP, 0.2, -4.0, DOWN, "0.0"),
        (LAMP, 0.2, -9.0, DOWN, None),  # light that the water or its surface has sent back
    ],
)
def test_a_map_that_looks_away_from_the_light_says_so(source, b, height, axis, warned):
    """The axis is the direction in which light arrives: upwards by default."""
    receiver = mt.Receiver() if source is LAMP else mt.WaterReceiver(depth=4.0)
    link = mt.Link(water=mt.Water(b=b), transmitter=source, receiver=receiver)
    grid = mt.IrradianceMap(height=height, extent=2.0, step=0.5, axis=axis)
    run = partial(mt.simulate, link, FlatSea(), "analog", photons=20_000, seed=1, record=[grid])
    if warned is None:
        assert run().map.irradiance.any()
        return
    with pytest.warns(mt.DomainWarning, match=f"received {warned}"):
        dark = run()
    assert dark.map.irradiance.any() == (warned == "0.0")


@pytest.mark.parametrize(
    "water",
    [mt.Water(a=0.1, b=1e30), mt.Water(layers=[(0.0, 0.1, 0.2), (9.0, 0.2, 1e30)])],
    ids=["uniform", "layers"],
)
def test_opaque_water_is_refused_instead_of_followed_without_end(water):
    link = mt.Link(water=water)
    with pytest.raises(mt.Refused, match="an optical depth of 1e"):
        joined.JoinedPhotons(link, 32, seed=1)
    with pytest.raises(mt.Refused, match='estimator="analog"'):
        mt.simulate(link, FlatSea(), photons=32, seed=1)


def test_the_deep_below_counts_by_the_collisions_that_it_lets_photons_try():
    water = mt.Water(layers=[(0.0, 0.1, 0.2), (50.0, 1e30, 0.1)])
    joined.JoinedPhotons(mt.Link(water=water), 32, seed=1)  # absorption along the way: none
    implicit = mt.Physics(absorption="implicit")
    with pytest.raises(mt.Refused, match="an optical depth of 1e"):
        joined.JoinedPhotons(mt.Link(water=water, physics=implicit), 32, seed=1)
