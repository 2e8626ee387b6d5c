"""Coverage maps by chains common to all cells.

Independent means: the same cells one by one by `simulate`, analog maps, and the scatter of seeds.
"""

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.results.coverage import CoverageMap, place_of_highest
from meshtrace.surfaces import FlatSea, JonswapSea
from meshtrace.transport import coverage as room
from meshtrace.transport.coverage import ForcedMap, Grid, levels_lacking, mean_and_error, square_of
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.meshing import mesh_for
from meshtrace.transport.options import Analog, Forced
from meshtrace.transport.outcome import warn_of_omitted

STEP, EXTENT = 0.1, 0.25
SMOOTH = mt.Physics(unresolved="none")
SEAS = {
    "flat": (FlatSea(), mt.Physics()),
    "random slopes": (JonswapSea(wind_speed=5.0, seed=7), mt.Physics()),
    "smooth waves": (JonswapSea(wind_speed=5.0, seed=7, band="paper"), SMOOTH),
}
# the lamp is moved instead of the map, which is centred on the origin
SITES = {"on axis": (0.0, 0.0), "aside": (-3.0, 1.5), "far off axis": (-3.8, -3.8)}


def link_at(site, **fields):
    lamp = mt.Led(position=SITES[site])
    return mt.Link(transmitter=lamp, **fields)


def mesh_of(link, sea):
    return mesh_for(link, sea, reach=crossing_reach(link) + 0.5)[0]


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("sea", SEAS)
@pytest.mark.thorough
def test_cells_have_the_gain_of_a_receiver_there(sea, site):
    """Ten cells at each site; the second moments of disk and cell agree for R = step / sqrt(3)."""
    surface, physics = SEAS[sea]
    link = link_at(site, physics=physics)
    mesh = mesh_of(link, surface)
    found = mt.coverage_map(link, mesh, EXTENT, STEP, rtol=0.01, seed=5, threads=1)
    assert "chains" in found.provenance
    assert found.gain_bound is None
    assert (found.gain_stderr <= 0.01 * found.gain).all()
    cells = [divmod(k, 5) for k in range(0, 25, 2)][:10]
    disk = STEP / np.sqrt(3.0)
    receivers = tuple(mt.Receiver(position=(found.x[i], found.y[j]), radius=disk) for i, j in cells)
    one = mt.simulate(link.replace(receiver=receivers), mesh, rtol=0.01, seed=11, threads=1)
    area = (mt.Receiver().radius / disk) ** 2
    for (i, j), gain, error in zip(cells, area * one.gain, area * one.gain_stderr, strict=True):
        # 0.1 %: moments of the fourth order of disk and cell differ
        error = np.hypot(error, 1e-3 * gain)
        p = z_test(found.gain[i, j], found.gain_stderr[i, j], gain, error)
        assert p > sidak(ALPHA, 9 * len(cells)), (i, j, found.gain[i, j], gain)


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.thorough
def test_cells_of_scattered_light_alone():
    """Corners beyond the field of view of unscattered light, against joined photons."""
    link = mt.Link()
    mesh = mesh_of(link.replace(receiver=mt.Receiver(position=(7.0, 7.0))), FlatSea())
    grid = Grid(5.1, 0.2)
    cells = np.array([grid.n**2 - 1, 0])
    gain, error = mean_and_error(ForcedMap(link, [mesh], grid, 3)._evaluate(8, cells))
    disk = 0.2 / np.sqrt(3.0)
    places = [(5.0, 5.0), (-5.0, -5.0)]
    receivers = tuple(mt.Receiver(position=place, radius=disk) for place in places)
    one = mt.simulate(link.replace(receiver=receivers), mesh, photons=2**17, seed=4, threads=1)
    area = (mt.Receiver().radius / disk) ** 2
    assert {row.estimator for row in one.scattered} == {"joined photons"}
    assert (one.gain_ballistic == 0.0).all()
    assert (error < 0.05 * gain).all()
    for k in range(2):
        p = z_test(gain[k], error[k], area * one.gain[k], area * one.gain_stderr[k])
        assert p > sidak(ALPHA, 2), (k, gain, error, area * one.gain, area * one.gain_stderr)


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.parametrize("sea", ["flat", "random slopes"])
def test_forced_map_against_analog_photons(sea):
    surface, physics = SEAS[sea]
    link = mt.Link(receiver=mt.Receiver(radius=0.25), physics=physics)
    mesh = mesh_of(link.replace(receiver=mt.Receiver(radius=3.0)), surface)
    forced = mt.coverage_map(link, mesh, 2.0, 0.5, rtol=0.01, threads=1)
    analog = mt.coverage_map(link, mesh, 2.0, 0.5, photons=2_000_000, threads=1)
    assert "chains" in forced.provenance
    assert "chains" not in analog.provenance
    z = (forced.gain - analog.gain) / np.hypot(forced.gain_stderr, analog.gain_stderr)
    assert np.median(analog.gain_stderr / analog.gain) < 0.05
    assert np.abs(z).max() < 4.6  # sidak(1e-4, 64)
    total = np.hypot(analog.gain_stderr.sum() / 8.0, 0.01 * forced.gain.sum())
    assert abs(forced.gain.sum() - analog.gain.sum()) < 4.0 * total


@pytest.mark.parametrize(("sea", "site"), [("flat", "aside"), ("random slopes", "far off axis")])
@pytest.mark.thorough
def test_errors_of_cells_are_true(sea, site):
    """Scatter over 64 seeds of a 5 x 5 map over the errors that it states."""
    surface, physics = SEAS[sea]
    link = link_at(site, physics=physics)
    mesh = mesh_of(link, surface)
    runs = [
        mean_and_error(ForcedMap(link, [mesh], Grid(EXTENT, STEP), s)._evaluate(0, np.arange(25)))
        for s in range(64)
    ]
    gains, errors = (np.array(rows) for rows in zip(*runs, strict=True))
    ratio = gains.std(axis=0, ddof=1) / np.sqrt((errors**2).mean(axis=0))
    # neighbouring cells share their chains: the mean has the uncertainty of one cell, 9 %
    assert 0.8 < ratio.mean() < 1.2, ratio.mean()
    assert (np.abs(ratio - 1.0) < 0.45).all(), ratio


def test_result_does_not_depend_on_threads_or_batches(monkeypatch):
    link = link_at("aside")
    mesh = mesh_of(link, SEAS["random slopes"][0])
    options = {"extent": EXTENT, "step": STEP, "rtol": 0.05, "seed": 2}
    one = mt.coverage_map(link, mesh, threads=1, **options)
    two = mt.coverage_map(link, mesh, threads=2, **options)
    for name in ("gain", "gain_stderr"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert one.provenance["chains"] == two.provenance["chains"]
    monkeypatch.setattr(room, "_AT_ONCE", 7)
    monkeypatch.setattr(room, "_ROWS", 5)
    other = mt.coverage_map(link, mesh, threads=1, **options)
    np.testing.assert_array_equal(other.gain, one.gain)


def test_a_map_of_times_is_the_mean_of_its_maps():
    sea = JonswapSea(wind_speed=5.0, seed=3)
    options = {"extent": EXTENT, "step": STEP, "rtol": 0.01, "threads": 1}
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
    found = mt.coverage_map(link, FlatSea(), 4.0, 1.0, rtol=0.01, threads=1)
    dark = found.gain == 0.0
    assert dark.any()
    assert not dark.all()
    assert np.isnan(found.gain_bound[~dark]).all()
    # no weight is above exp(-a d); of 2^20 photons none arrived
    most = np.exp(-0.1 * 10.0) * np.pi * 0.25**2
    np.testing.assert_allclose(found.gain_bound[dark], 3.0 * most / 2**20, rtol=1e-6)
    assert "bound where dark" in found.summary()
    found.save(tmp_path / "map.nc")
    back = CoverageMap.load(tmp_path / "map.nc")
    np.testing.assert_array_equal(back.gain_bound, found.gain_bound)


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.parametrize(
    "link",
    [
        mt.Link(receiver=mt.Receiver(tilt_deg=20.0, radius=0.5)),
        mt.Link(water=mt.Water(bottom_depth=30.0), receiver=mt.Receiver(radius=0.5)),
        mt.Link(
            transmitter=mt.AirLed(height=5.0), receiver=mt.WaterReceiver(depth=5.0, radius=0.5)
        ),
    ],
    ids=["tilted", "bottom", "down"],
)
def test_links_that_chains_do_not_follow_take_analog_photons(link):
    found = mt.coverage_map(link, FlatSea(), 1.0, 1.0, photons=50_000, rtol=0.3, threads=1)
    assert "chains" not in found.provenance
    assert found.provenance["run"]["estimator"] == "analog"


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.parametrize(
    ("options", "physics"), [(Forced, mt.Physics()), (Analog, mt.Physics(snell="paper"))]
)
@pytest.mark.thorough
def test_cells_above_the_tolerance_warn(options, physics, monkeypatch):
    monkeypatch.setattr(options, "most_photons", 4096)
    link = mt.Link(receiver=mt.Receiver(radius=0.5), physics=physics)
    with pytest.warns(mt.FewSamplesWarning, match="rtol: (4|2) of 4 cells have not reached 1e-06"):
        mt.coverage_map(link, FlatSea(), 1.0, 1.0, photons=64, rtol=1e-6, threads=1)


def test_points_of_a_cell_are_uniform():
    rng = np.random.default_rng(1)
    u, v = rng.random((2, 100_000))
    disk = np.sqrt(u)[:, None] * np.stack([np.cos(2 * np.pi * v), np.sin(2 * np.pi * v)], axis=1)
    points = square_of(disk, 2.0)
    counts = np.histogram2d(*points.T, bins=8, range=[[-1.0, 1.0]] * 2)[0].ravel()
    assert counts.sum() == 100_000
    chi2 = np.sum((counts - 100_000 / 64) ** 2) / (100_000 / 64)
    assert chi2 < 125.0  # 63 degrees of freedom, p = 5e-6


def test_cells_of_few_samples_take_more_chains():
    sums = room.Sums(np.ones((32, 2)), np.array([0.5, 0.5]), np.array([0.25 / 10.0, 0.25 / 1e4]))
    assert levels_lacking(sums, 0.01).tolist() == [3, 0]
    weak = sums._replace(scattered=np.array([1e-3, 1e-3]))
    assert levels_lacking(weak, 0.01).tolist() == [0, 0]


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
def test_the_place_of_the_highest_gain_takes_more_chains():
    """Still water above a lamp at (0.5, -0.3): without more chains noise of 2 % hides the place."""
    link = mt.Link(transmitter=mt.Led(position=(0.5, -0.3)))
    found = mt.coverage_map(link, FlatSea(), 1.4, 0.2, rtol=0.02, seed=1, threads=1)
    place = place_of_highest(found.gain, found.gain_stderr)
    assert place is not None
    assert np.hypot(found.x[place[0]] - 0.5, found.y[place[1]] + 0.3) < 0.3
    assert (found.gain_stderr[place] < 0.005 * found.gain[place]).all()


def test_the_share_of_returned_light_is_at_most_all(monkeypatch):
    monkeypatch.setattr("meshtrace.transport.outcome.returned_gain", lambda link: np.array([1e-9]))
    for gain, percent in ((1e-129, "100"), (1e-9, "50"), (1e-7, "1")):
        with pytest.warns(mt.DomainWarning, match=f"about {percent} % of the light leaves"):
            warn_of_omitted(mt.Link(), np.array([gain]))
