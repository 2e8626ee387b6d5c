"""Coverage maps: image of the unscattered light, and photons for all other light.

Independent means: the same cells one by one by `simulate`, analog maps, and the scatter of seeds.
"""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy import stats

import meshtrace as mt
from meshtrace.engine.chains import maps
from meshtrace.engine.setup import meshing
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.results import CoverageMap, series
from meshtrace.studies import coverage as room
from meshtrace.surfaces import FlatSea, JonswapSea

STEP, EXTENT = 0.2, 0.5
SMOOTH = mt.Physics(unresolved="none")
STILL = FlatSea().mesh(extent=60.0, spacing=5.0)
SEAS = {
    "flat": (FlatSea(), mt.Physics()),
    "random slopes": (JonswapSea(wind_speed=5.0, seed=7), mt.Physics()),
    "skewed slopes": (JonswapSea(wind_speed=5.0, seed=7, slope_law="cox-munk"), mt.Physics()),
    "smooth waves": (JonswapSea(wind_speed=5.0, seed=7, waves="paper"), SMOOTH),
}
# the lamp is moved instead of the map, which is centred on the origin
SITES = {"on axis": (0.0, 0.0), "aside": (-3.0, 1.5), "far off axis": (-3.8, -3.8)}
MURKY = mt.Water(a=0.1, b=0.5, phase=mt.HenyeyGreenstein(g=0.0))
LAYERS = ((0.0, 0.05, 0.3), (4.0, 0.1, 0.05), (12.0, 0.1, 0.05))


def link_at(site, **fields):
    lamp = mt.Led(position=SITES[site])
    return mt.Link(transmitter=lamp, **fields)


def mesh_of(link, sea):
    return meshing.mesh_for(link, sea, reach=crossing_reach(link) + 0.5)[0]


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("sea", SEAS)
@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.slow_but(
    "flat-aside",
    "random slopes-aside",
    "skewed slopes-on axis",
    "smooth waves-aside",
)
def test_cells_have_the_gain_of_a_receiver_there(sea, site):
    """Ten cells at each site; the second moments of disk and cell agree for R = step / sqrt(3)."""
    surface, physics = SEAS[sea]
    link = link_at(site, physics=physics)
    mesh = mesh_of(link, surface)
    found = mt.coverage_map(link, mesh, EXTENT, STEP, rtol=0.02, seed=5, threads=1)
    assert found.provenance["unscattered"] == "image"
    assert found.gain_bound is None
    assert (found.gain_stderr <= 0.02 * found.gain).all()
    cells = [divmod(k, 5) for k in range(0, 25, 2)][:10]
    disk = STEP / np.sqrt(3.0)
    receivers = tuple(mt.Receiver(position=(found.x[i], found.y[j]), radius=disk) for i, j in cells)
    one = mt.simulate(link.replace(receiver=receivers), mesh, rtol=0.01, seed=11, threads=1)
    area = (mt.Receiver().radius / disk) ** 2
    for (i, j), gain, error in zip(cells, area * one.gain, area * one.gain_stderr, strict=True):
        # 0.3 %: moments of the fourth order of disk and cell differ
        error = np.hypot(error, 3e-3 * gain)
        p = z_test(found.gain[i, j], found.gain_stderr[i, j], gain, error)
        assert p > sidak(ALPHA, 12 * len(cells)), (i, j, found.gain[i, j], gain)


@pytest.mark.filterwarnings("ignore::meshtrace.FewSamplesWarning")
@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.thorough
def test_cells_of_scattered_light_alone():
    """Corners beyond the field of view of unscattered light, against joined photons."""
    link = mt.Link(physics=mt.Physics(reflected="kill"))
    mesh = mesh_of(link.replace(receiver=mt.Receiver(position=(8.0, 8.0))), FlatSea())
    found = mt.coverage_map(link, mesh, 6.5, 1.0, rtol=0.03, seed=3, threads=1)
    disk = 1.0 / np.sqrt(3.0)
    places = [(6.0, 6.0), (-6.0, -6.0)]
    receivers = tuple(mt.Receiver(position=place, radius=disk) for place in places)
    one = mt.simulate(link.replace(receiver=receivers), mesh, photons=2**15, seed=4, threads=1)
    area = (mt.Receiver().radius / disk) ** 2
    assert {row.estimator for row in one.scattered} == {"joined photons"}
    assert (one.gain_ballistic == 0.0).all()
    for k, cell in enumerate([(-1, -1), (0, 0)]):
        gain, error = found.gain[cell], found.gain_stderr[cell]
        p = z_test(gain, error, area * one.gain[k], area * one.gain_stderr[k])
        assert p > sidak(ALPHA, 2), (k, gain, error, area * one.gain, area * one.gain_stderr)


LINKS = {
    "flat": (mt.Link(), STILL),
    "smooth waves": (mt.Link(physics=SMOOTH), SEAS["smooth waves"][0]),
    "two lamps": (
        mt.Link(
            transmitter=(
                mt.Led(position=(1.0, 0.5)),
                mt.Led(position=(-2.0, -1.0), depth=6.0, power_mw=2000.0),
            )
        ),
        STILL,
    ),
    "light reflected first": (
        mt.Link(transmitter=mt.Led(depth=3.0), water=MURKY, receiver=mt.Receiver(fov_deg=170.0)),
        STILL,
    ),
    "bottom": (mt.Link(water=mt.Water(a=0.05, b=0.1, bottom_depth=12.0)), STILL),
    "layers": (mt.Link(water=mt.Water(layers=LAYERS)), STILL),
    "implicit": (mt.Link(physics=mt.Physics(absorption="implicit")), STILL),
    "paper": (mt.Link(physics=mt.Physics(absorption="paper", fresnel="paper_both")), STILL),
}


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.parametrize("name", LINKS)
@pytest.mark.slow_but("light reflected first", "layers", "paper")
@pytest.mark.thorough_but("paper")
def test_image_and_photons_against_photons_alone(name):
    """Chi-square over 64 cells. Chains once left out the light that is reflected first."""
    link, sea = LINKS[name]
    options = {"extent": 2.0, "step": 0.5, "threads": 1}
    both = mt.coverage_map(link, sea, rtol=0.05, seed=1, **options)
    alone = mt.coverage_map(link, sea, photons=1_000_000, seed=2, **options)
    assert both.provenance["unscattered"] == "image"
    assert alone.provenance["unscattered"] == "photons"
    z = (both.gain - alone.gain) / np.hypot(both.gain_stderr, alone.gain_stderr)
    assert stats.chi2.sf(np.sum(z**2), z.size) > sidak(ALPHA, len(LINKS))
    error = np.sqrt(np.sum(both.gain_stderr**2) + np.sum(alone.gain_stderr**2))
    assert z_test(both.gain.sum(), error, alone.gain.sum()) > sidak(ALPHA, len(LINKS))


@pytest.mark.parametrize("sea", ["flat", "random slopes"])
@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.thorough
@pytest.mark.slow_but("flat")
def test_errors_of_cells_are_true(sea, monkeypatch):
    """Scatter of three cells over 64 seeds by the errors that they state."""
    surface, physics = SEAS[sea]
    link = link_at("aside", physics=physics)
    mesh, images = mesh_of(link.replace(receiver=mt.Receiver(radius=3.0)), surface), []

    def once(*inputs):
        images.append(images[0] if images else kept(*inputs))
        return images[0]

    kept = room.unscattered_map
    monkeypatch.setattr(room, "unscattered_map", once)
    runs = [
        mt.coverage_map(link, mesh, 2.0, 0.8, photons=2**16, rtol=1.0, seed=s, threads=1)
        for s in range(64)
    ]
    assert len({r.provenance["run"]["photons"] for r in runs}) == 1
    for cell in ((2, 2), (0, 3), (4, 4)):
        gains, errors = np.array([(r.gain[cell], r.gain_stderr[cell]) for r in runs]).T
        chi2 = np.sum((gains - gains.mean()) ** 2 / errors**2)
        assert 42.0 < chi2 < 90.0, (cell, chi2)


def test_a_cell_without_photons_has_an_error():
    """The image alone would be 0 % wrong by its photons: they have one typical photon's error."""
    found = mt.coverage_map(mt.Link(), STILL, 0.5, 0.1, photons=1000, rtol=50.0, threads=1)
    assert found.provenance["run"]["photons"] == 1000
    least = found.gain_stderr.min()
    # to which the error of the image, far smaller, is joined
    assert np.count_nonzero(np.isclose(found.gain_stderr, least, rtol=1e-6)) > 50
    assert least > 0.1 * found.gain.max()
    # the image is all that they have received
    assert found.gain.min() > 0.5 * np.median(found.gain)


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
def test_result_does_not_depend_on_threads_or_rounds():
    link = link_at("aside")
    options = {"extent": 1.0, "step": 0.5, "seed": 2}
    one = mt.coverage_map(link, STILL, photons=20_000, rtol=0.1, threads=1, **options)
    two = mt.coverage_map(link, STILL, photons=20_000, rtol=0.1, threads=2, **options)
    photons = one.provenance["run"]["photons"]
    assert photons > 20_000
    whole = mt.coverage_map(link, STILL, photons=photons, rtol=10.0, threads=2, **options)
    assert whole.provenance["run"]["photons"] == photons
    for other in (two, whole):
        np.testing.assert_array_equal(one.gain, other.gain)
        np.testing.assert_array_equal(one.gain_stderr, other.gain_stderr)


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.thorough
def test_a_map_of_times_is_the_mean_of_its_maps():
    sea = JonswapSea(wind_speed=5.0, seed=3)
    options = {"extent": 1.0, "step": 0.4, "rtol": 0.01, "threads": 1}
    link = link_at("on axis")
    both = mt.coverage_map(link, sea, times=(0.0, 2.0), **options)
    parts = [mt.coverage_map(link, sea, times=(t,), **options) for t in (0.0, 2.0)]
    mean = 0.5 * (parts[0].gain + parts[1].gain)
    error = np.hypot(both.gain_stderr, 0.5 * (parts[0].gain_stderr + parts[1].gain_stderr))
    assert (np.abs(both.gain - mean) < 4.6 * error).all()
    assert np.abs(parts[0].gain - parts[1].gain).max() > 3.0 * error.max()


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
def test_cells_without_light_have_a_bound(tmp_path):
    """Without scattering a narrow field of view leaves the cells aside dark."""
    link = mt.Link(water=mt.Water(a=0.1, b=0.0), receiver=mt.Receiver(fov_deg=10.0, radius=0.25))
    found = mt.coverage_map(link, STILL, 4.0, 1.0, photons=2**17, rtol=0.01, threads=1)
    dark = found.gain == 0.0
    assert dark.any()
    assert not dark.all()
    assert np.isnan(found.gain_bound[~dark]).all()
    # no weight is above exp(-a d); of 2^17 photons none arrived
    most = np.exp(-0.1 * 10.0) * np.pi * 0.25**2
    np.testing.assert_allclose(found.gain_bound[dark], 3.0 * most / 2**17, rtol=1e-6)
    assert "bound where dark" in found.summary()
    found.save(tmp_path / "map.nc")
    back = CoverageMap.load(tmp_path / "map.nc")
    np.testing.assert_array_equal(back.gain_bound, found.gain_bound)


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.parametrize(
    "link",
    [
        mt.Link(receiver=mt.Receiver(tilt_deg=20.0, radius=0.5)),
        mt.Link(
            transmitter=mt.AirLed(height=5.0), receiver=mt.WaterReceiver(depth=5.0, radius=0.5)
        ),
        mt.Link(physics=mt.Physics(fov="paper_position"), receiver=mt.Receiver(radius=0.5)),
    ],
    ids=["tilted", "down", "view by position"],
)
def test_links_without_an_image_take_photons_for_all_light(link):
    found = mt.coverage_map(link, FlatSea(), 1.0, 1.0, photons=50_000, rtol=0.3, threads=1)
    assert found.provenance["unscattered"] == "photons"
    assert found.provenance["run"]["photons"] == 50_000


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.parametrize("physics", [mt.Physics(), mt.Physics(fov="paper_position")])
def test_cells_above_the_tolerance_warn(physics, monkeypatch):
    monkeypatch.setattr(mt.Analog, "most_photons", 4096)
    link = mt.Link(receiver=mt.Receiver(radius=0.5), physics=physics)
    text = "rtol: 4 of 4 cells have not reached 1e-06"
    with pytest.warns(mt.FewSamplesWarning, match=text) as caught:
        mt.coverage_map(link, STILL, 1.0, 1.0, photons=64, rtol=1e-6, threads=1)
    assert {warning.filename for warning in caught} == {__file__}


def test_a_map_without_any_light_is_given_up():
    """The narrow view does not reach down to a lamp aside."""
    view, lamp = mt.Receiver(fov_deg=10.0), mt.Led(position=(20.0, 0.0))
    link = mt.Link(transmitter=lamp, water=mt.Water(a=0.1, b=0.0), receiver=view)
    with pytest.warns(mt.FewSamplesWarning, match="4 of 4 cells"):
        found = mt.coverage_map(link, STILL, 1.0, 1.0, photons=4096, rtol=0.1, threads=1)
    assert found.provenance["run"]["photons"] == 4096
    assert (found.gain_bound > 0.0).all()


def test_noise_has_no_place():
    """Equal cells with noise of 5 %: the highest of 400 is 3 standard errors above the mean."""
    noise = np.random.default_rng(3).standard_normal((20, 20))
    gain, axis = 1e-5 * (1.0 + 0.05 * noise), np.arange(20.0)
    found = CoverageMap(axis, axis, gain, np.full_like(gain, 5e-7))
    assert "place not resolved: " in found.summary()
    gain[4, 7] *= 2.0
    assert found.summary().count(" at (4, 7) m") == 1


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.thorough
def test_the_place_of_the_highest_gain_is_that_above_the_lamp():
    link = mt.Link(transmitter=mt.Led(position=(0.8, -0.4)))
    found = mt.coverage_map(link, STILL, 1.4, 0.4, rtol=0.005, seed=1, threads=1)
    place = series.place_of_highest(found.gain, found.gain_stderr)
    assert place is not None
    assert np.hypot(found.x[place[0]] - 0.8, found.y[place[1]] + 0.4) < 0.3


def test_errors_of_dark_cells_are_relative_to_a_hundredth_of_the_highest_gain():
    gain, stderr = np.array([[1.0, 0.1], [0.001, 0.0]]), np.full((2, 2), 1e-3)
    np.testing.assert_allclose(series.relative_errors(gain, stderr), [[0.001, 0.01], [0.1, 0.1]])
    assert np.isinf(series.relative_errors(0.0 * gain, stderr)).all()


@pytest.mark.parametrize("sea", [FlatSea(), JonswapSea(wind_speed=5.0, seed=1)])
def test_cells_of_unscattered_light_have_the_error_of_the_quadrature(sea):
    """Once a stated error of 0; parts of a quarter of the length are the reference."""
    link = mt.Link(
        water=mt.Water(a=0.114, b=0.0),
        transmitter=mt.Led(depth=10.0, half_angle_deg=2.0),
        receiver=mt.Receiver(height=20.0, radius=0.3, fov_deg=10.0),
    )
    grid = mt.IrradianceMap(height=20.0, extent=1.0, step=0.5, fov_deg=10.0)
    coverage = mt.coverage_map(link, sea, extent=1.0, step=0.5, rtol=0.05)
    assert (coverage.gain_stderr > 0.0).all()
    assert (coverage.gain_stderr < 1e-3 * coverage.gain.max()).all()
    ends = tuple(link.receiver.replace(position=(x, y)) for x in (-1.0, 1.0) for y in (-1.0, 1.0))
    mesh = meshing.mesh_for(link.replace(receiver=ends), sea, reach=math.inf)[0]
    finer, _ = maps.unscattered_map(link, mesh, grid, lengths=(0.25, 0.5))
    z = (coverage.gain - finer[:, :, 0]) / coverage.gain_stderr
    assert np.abs(z).max() < 4.0
