"""Series, ensembles and maps: the same numbers as single runs, in the right order."""

import numpy as np
import psutil
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy import stats
from typer.testing import CliRunner

import meshtrace as mt
from meshtrace.cli import app
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.setup import ends, meshing
from meshtrace.results import CoverageMap, GainSeries, tallies
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea, resolved_sea

SEA = JonswapSea(wind_speed=13.0, seed=3, mss="band", waves="paper")
TILTED = JonswapSea(wind_speed=13.0, seed=3, waves="paper")
OPTIONS = {"photons": 1024, "seed": 5, "mesh": mt.Meshing(extent=8.0, spacing=0.2)}
TIMES = (0.0, 0.7, 1.9, 2.0, 6.5)


def meshes(link, sea, times):
    reach = ends.crossing_reach(link)
    still = OPTIONS["mesh"]
    return [meshing.mesh_for(link, sea, still.replace(time=t), reach)[0] for t in times]


@pytest.fixture(scope="module")
def series():
    return mt.time_series(mt.Link(), SEA, TIMES, threads=1, **OPTIONS)


def test_each_time_is_the_run_over_that_mesh_with_the_same_chains(series):
    link = mt.Link()
    all_meshes = meshes(link, SEA, TIMES)
    crest = 1.5 * max(float(m.bounds[1, 2]) for m in all_meshes[:4])
    forced = ForcedDetection(link, 1024, 5, "vertex", sea=TypicalSea(crest))
    for i, mesh in enumerate(all_meshes):
        parts = forced.evaluate(mesh)
        assert series.gain[i] == parts.gain[0]
        # without the error of the quadrature, which all frames share, 1e-6 of this one
        assert series.gain_stderr[i] == tallies.error_of_groups(parts.shifts[0])
        assert series.gain_ballistic[i] == parts.ballistic[0]


def test_each_time_agrees_with_a_run_of_its_own(series):
    for i, t in enumerate(TIMES):
        r = mt.simulate(mt.Link(), SEA, time=t, photons=4096, seed=77 + i, extent=8.0, spacing=0.2)
        assert r.gain_ballistic == pytest.approx(series.gain_ballistic[i], rel=1e-12)
        p = z_test(series.gain[i], series.gain_stderr[i], r.gain, r.gain_stderr)
        assert p > sidak(ALPHA, len(TIMES))


def test_times_may_come_in_any_order_and_number(series):
    """More than four, backwards: the first four meshes only set the expected crest."""
    again = mt.time_series(mt.Link(), SEA, TIMES[::-1], threads=2, **OPTIONS)
    np.testing.assert_array_equal(again.gain_ballistic, series.gain_ballistic[::-1])
    # the chains differ if the expected crest does; the light does not
    np.testing.assert_allclose(again.gain, series.gain[::-1], rtol=0.02)
    one = mt.time_series(mt.Link(), SEA, 0.7, threads=1, **OPTIONS)
    assert one.gain.shape == (1,)
    assert one.gain_ballistic[0] == series.gain_ballistic[1]


def test_common_chains_make_smooth_series():
    """A wave that moves by millimetres changes the gain by far less than its error."""
    wave = SinusoidalSea(amplitude=0.2, wavelength=8.0)
    times = np.arange(4) * 1e-4
    s = mt.time_series(mt.Link(), wave, times, threads=1, **OPTIONS)
    noise = s.gain_stderr.mean()
    assert noise > 0.0
    assert np.abs(np.diff(s.gain, n=2)).max() < 0.05 * noise
    # the mean of common chains is no better than one of them
    assert s.mean_stderr == pytest.approx(noise, rel=0.01)


def test_ensemble_has_other_phases_each_and_is_reproducible():
    first = mt.ensemble(mt.Link(), 6, SEA, threads=1, **OPTIONS)
    again = mt.ensemble(mt.Link(), 6, SEA, threads=2, **OPTIONS)
    np.testing.assert_array_equal(first.gain, again.gain)
    np.testing.assert_array_equal(first.coordinate, again.coordinate)
    assert len(set(first.gain_ballistic)) == 6
    assert len(set(first.coordinate)) == 6
    # a longer ensemble continues the shorter one
    longer = mt.ensemble(mt.Link(), 8, SEA, threads=1, **OPTIONS)
    np.testing.assert_array_equal(longer.coordinate[:6], first.coordinate)
    np.testing.assert_array_equal(longer.gain_ballistic[:6], first.gain_ballistic)
    other = mt.ensemble(mt.Link(), 6, SEA, threads=1, **{**OPTIONS, "seed": 6})
    assert not set(other.coordinate) & set(first.coordinate)


def test_realization_is_the_sea_of_its_seed():
    ensemble = mt.ensemble(mt.Link(), 3, SEA, threads=1, **OPTIONS)
    for seed, ballistic in zip(ensemble.coordinate, ensemble.gain_ballistic, strict=True):
        mesh = meshes(mt.Link(), SEA.with_seed(int(seed)), [0.0])[0]
        assert ForcedDetection(mt.Link(), 32, 1).evaluate(mesh).ballistic[0] == ballistic


def test_several_receivers_in_a_series():
    rx = (mt.Receiver(), mt.Receiver(position=(0.5, 0.0)))
    both = mt.time_series(mt.Link(receiver=rx), SEA, TIMES[:2], threads=1, **OPTIONS)
    assert both.gain.shape == (2, 2)
    assert both.mean_stderr.shape == (2,)
    alone = mt.time_series(mt.Link(receiver=rx[1]), SEA, TIMES[:2], threads=1, **OPTIONS)
    np.testing.assert_allclose(both.gain_ballistic[:, 1], alone.gain_ballistic, rtol=1e-12)
    np.testing.assert_allclose(both.gain[:, 1], alone.gain, rtol=0.02)


def test_series_round_trip(series, tmp_path):
    series.save(tmp_path / "s.nc")
    back = GainSeries.load(tmp_path / "s.nc")
    for name in ("gain", "gain_stderr", "gain_ballistic", "coordinate", "mean_stderr"):
        np.testing.assert_array_equal(getattr(back, name), getattr(series, name))
    assert back.along == "time"
    assert back.provenance == series.provenance
    with pytest.raises(ValueError, match=r"along: .realization., allowed: time"):
        _ = mt.ensemble(mt.Link(), 1, SEA, threads=1, **OPTIONS).time


def test_slopes_beyond_the_mesh_share_the_chains_too():
    """Unscattered light is then drawn as well: its error is part of the mean's."""
    s = mt.ensemble(mt.Link(), 4, TILTED, threads=1, **OPTIONS)
    again = mt.ensemble(mt.Link(), 4, TILTED, threads=2, **OPTIONS)
    np.testing.assert_array_equal(s.gain, again.gain)
    assert 0.0 < s.mean_stderr <= s.gain_stderr.mean()
    r = mt.simulate(
        mt.Link(), TILTED.with_seed(int(s.coordinate[0])), photons=4096, extent=8.0, spacing=0.2
    )
    assert z_test(s.gain[0], s.gain_stderr[0], r.gain, r.gain_stderr) > ALPHA


def synthetic(own, common, spread, rng, n=50):
    """Return an ensemble whose shifts have independent and common errors of known size."""
    gain = 1.0 + spread * rng.standard_normal(n)
    noise = np.sqrt(32.0) * (own * rng.standard_normal((n, 32)) + common * rng.standard_normal(32))
    stderr = noise.std(axis=1, ddof=1) / np.sqrt(32.0)
    mean_stderr = noise.mean(axis=0).std(ddof=1) / np.sqrt(32.0)
    return GainSeries(
        "realization",
        np.arange(n),
        gain + noise.mean(axis=1),
        stderr,
        np.zeros(n),
        float(mean_stderr),
    )


@pytest.mark.parametrize(("own", "common"), [(0.05, 0.0), (0.0, 0.05), (0.04, 0.03)])
def test_scintillation_index_is_free_of_what_realizations_do_not_share(own, common):
    rng = np.random.default_rng(31)
    options = {"resamples": 50, "test_resamples": 0}
    index, raw = [], []
    for _ in range(150):
        s = synthetic(own, common, 0.1, rng)
        found = s.fading(**options)
        index.append(found.scintillation_index.value * s.gain.mean() ** 2)
        raw.append(s.gain.var(ddof=1))
    error = np.std(index, ddof=1) / np.sqrt(150.0)
    assert z_test(np.mean(index), error, 0.01) > sidak(ALPHA, 3)
    if own:  # the same test sees what was left in
        assert z_test(np.mean(raw), error, 0.01) < sidak(ALPHA, 3)
    # the common error is the mean's in full
    assert found.mean_stderr >= s.mean_stderr


@pytest.mark.slow
def test_what_chains_do_not_share_is_the_scatter_about_many_chains():
    """Few chains against many over the same seas: what differs from sea to sea."""
    seas = [SEA.with_seed(k) for k in range(16)]
    all_meshes = [meshes(mt.Link(), sea, [0.0])[0] for sea in seas]
    crest = 1.5 * max(float(m.bounds[1, 2]) for m in all_meshes)
    many = ForcedDetection(mt.Link(), 4096, 99, sea=TypicalSea(crest))
    truth = np.array([many.evaluate(m).gain[0] for m in all_meshes])
    ratio = []
    for seed in range(12):
        few = ForcedDetection(mt.Link(), 128, seed, sea=TypicalSea(crest))
        parts = [few.evaluate(m) for m in all_meshes]
        s = GainSeries(
            "realization",
            np.arange(16),
            np.array([p.gain[0] for p in parts]),
            np.array([p.stderr[0] for p in parts]),
            np.zeros(16),
            float(np.mean([p.shifts[0] for p in parts], axis=0).std(ddof=1) / np.sqrt(32.0)),
        )
        stated = s.fading(resamples=50, test_resamples=0).noise_share * s.gain.var(ddof=1)
        ratio.append((s.gain - truth).var(ddof=1) / stated)
    error = np.std(ratio, ddof=1) / np.sqrt(len(ratio))
    assert 2.0 * stats.t.sf(abs(np.mean(ratio) - 1.0) / error, len(ratio) - 1) > ALPHA, ratio


def test_share_of_noise_is_that_of_the_variance():
    """Errors of one size that scatter the gains alone are all of their variance, n / (n - 1)."""
    time, error = np.arange(5.0), 0.01
    gain = 1.0 + error * np.array([1.0, -1.0, 0.0, 1.0, -1.0]) / np.sqrt(0.8)
    series = GainSeries("time", time, gain, np.full(5, 0.5 * error), 0.0 * gain, 0.0)
    (note,) = (n for n in series.fading(resamples=50, test_resamples=0).notes if "Carlo" in n)
    assert note.startswith("Monte Carlo noise is 25 % of the variance")


def test_series_says_when_noise_counts():
    time = np.arange(40.0)
    gain = 1.0 + 0.01 * np.sin(time)
    quiet, loud = (
        GainSeries("time", time, gain, np.full(40, error), 0.0 * gain, 0.0)
        for error in (1e-4, 5e-3)
    )
    options = {"resamples": 50, "test_resamples": 0}
    assert not any("Monte Carlo" in note for note in quiet.fading(**options).notes)
    assert any("increase photons" in note for note in loud.fading(**options).notes)
    with pytest.raises(ValueError, match="receiver: 1, allowed"):
        quiet.fading(1)


@pytest.mark.parametrize("bad", [[np.nan], [np.inf, 0.0], [[0.0, 1.0]], []])
def test_times_must_be_finite_and_flat(bad):
    with pytest.raises(ValueError, match="times"):
        mt.time_series(mt.Link(), SEA, bad, **OPTIONS)


def test_ensemble_refuses_what_has_no_phases():
    with pytest.raises(ValueError, match="random phases"):
        mt.ensemble(mt.Link(), 3, FlatSea(), **OPTIONS)
    with pytest.raises(ValueError, match="realizations"):
        mt.ensemble(mt.Link(), 0, SEA, **OPTIONS)


@pytest.mark.parametrize(
    "bad", [{"photons": 0}, {"photons": 2.5}, {"seed": -1}, {"normals": "smooth"}]
)
def test_options_out_of_range_are_named(bad):
    with pytest.raises(ValueError, match=f"{next(iter(bad))}: .*, allowed"):
        mt.ensemble(mt.Link(), 3, SEA, **{**OPTIONS, **bad})
    with pytest.raises(ValueError, match=f"{next(iter(bad))}: .*, allowed"):
        mt.time_series(mt.Link(), SEA, TIMES, **{**OPTIONS, **bad})


# ---- coverage --------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
def test_map_over_a_disk_is_the_gain_of_a_receiver_there():
    """Sum of the cells whose centres lie on a disk against forced detection, away from the axis."""
    link, sea, step = mt.Link(), JonswapSea(wind_speed=5.0, seed=2, waves="paper"), 0.05
    m = mt.coverage_map(link, sea, extent=1.6, step=step, photons=600_000, seed=3)
    assert m.gain.shape == (len(m.x), len(m.y)) == (64, 64)
    np.testing.assert_allclose(m.x[[0, -1]], [-1.575, 1.575])
    area = np.pi * 0.05**2
    for place, radius in (((0.0, 0.0), 0.6), ((0.7, -0.4), 0.6)):
        gx, gy = np.meshgrid(m.x - place[0], m.y - place[1], indexing="ij")
        # share of each cell on the disk, by 8 x 8 points
        o = step * ((np.arange(8) + 0.5) / 8 - 0.5)
        share = np.mean([(gx + a) ** 2 + (gy + b) ** 2 <= radius**2 for a in o for b in o], axis=0)
        total = (share * m.gain).sum() * step**2 / area
        error = np.sqrt(((share * m.gain_stderr) ** 2).sum()) * step**2 / area
        receiver = mt.Receiver(position=place, radius=radius)
        r = mt.simulate(mt.Link(receiver=receiver), sea, photons=4096, seed=4)
        # light that the surface sends back first is in the map only: some 1e-4 of all
        allowed = np.hypot(r.gain_stderr, 1e-3 * r.gain)
        assert error / total < 0.03
        assert z_test(total, error, r.gain, allowed) > sidak(ALPHA, 2)


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
def test_map_over_times_is_the_mean_of_the_maps():
    link = mt.Link(receiver=mt.Receiver(radius=0.25))
    options = {"extent": 2.0, "step": 0.5, "photons": 40_960, "seed": 3}
    whole = mt.coverage_map(link, SEA, times=(0.0, 1.0), **options)
    first = mt.coverage_map(link, SEA, times=(0.0,), **options)
    assert not np.array_equal(first.gain, whole.gain)
    two = mt.coverage_map(link, FlatSea(), times=(0.0, 9.0), **options)
    one = mt.coverage_map(link, FlatSea(), times=(0.0,), **options)
    ratio = two.gain_stderr.sum() / one.gain_stderr.sum()
    assert ratio == pytest.approx(np.sqrt(0.5), rel=0.05)
    assert two.to_dataset()["gain"].attrs["units"] == "1"


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
def test_map_round_trip_and_refusals(tmp_path):
    options = {"extent": 1.0, "step": 0.5, "photons": 8192}
    m = mt.coverage_map(mt.Link(), FlatSea(), **options)
    m.save(tmp_path / "map.nc")
    back = CoverageMap.load(tmp_path / "map.nc")
    for name in ("x", "y", "gain", "gain_stderr"):
        np.testing.assert_array_equal(getattr(back, name), getattr(m, name))
    assert back.provenance == m.provenance
    with pytest.raises(ValueError, match="a coverage of format_version 2, allowed: series"):
        GainSeries.load(tmp_path / "map.nc")
    for bad in ({"step": 0.0}, {"step": 3.0}, {"extent": np.nan}, {"times": ()}):
        with pytest.raises(ValueError, match=f"{next(iter(bad))}: .*, allowed|step: "):
            mt.coverage_map(mt.Link(), FlatSea(), **{**options, **bad})


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
def test_a_map_reaches_its_tolerance_with_photons_of_its_own():
    """Merged rounds are one run of all photons; the wanted error holds where there is light."""
    # the image of a tilted receiver is not known: photons carry all its light
    link = mt.Link(receiver=mt.Receiver(radius=0.5, fov_deg=120.0, tilt_deg=0.1))
    options = {"extent": 2.0, "step": 1.0, "seed": 3}
    m = mt.coverage_map(link, FlatSea(), photons=20_000, rtol=0.05, **options)
    n = m.provenance["run"]["photons"]
    assert n > 20_000
    error = m.gain_stderr / np.maximum(m.gain, 0.01 * m.gain.max())
    assert 0.02 < error.max() <= 0.05
    whole = mt.coverage_map(link, FlatSea(), photons=n, **options)
    np.testing.assert_allclose(m.gain, whole.gain, rtol=1e-12)
    loose = mt.coverage_map(link, FlatSea(), photons=20_000, rtol=10.0, **options)
    assert loose.provenance["run"]["photons"] == 20_000
    with pytest.raises(ValueError, match=r"rtol: 0.*allowed"):
        mt.coverage_map(link, FlatSea(), rtol=0.0, **options)


# ---- command line ----------------------------------------------------------------------------


def command(*arguments):
    result = CliRunner().invoke(app, [*arguments, "--photons", "64", "--threads", "1"])
    return result.exit_code, result.output


def test_commands_write_what_they_print(tmp_path):
    code, said = command("series", "--times", "0:1:0.5", "-o", str(tmp_path / "s.nc"))
    assert code == 0
    written = GainSeries.load(tmp_path / "s.nc")
    np.testing.assert_allclose(written.time, [0.0, 0.5, 1.0])
    assert f"mean gain            {written.gain.mean():.6g}" in said
    code, said = command("ensemble", "-n", "3", "-o", str(tmp_path / "e.nc"))
    assert code == 0
    assert GainSeries.load(tmp_path / "e.nc").along == "realization"
    assert "3 independent gains" in said


@pytest.mark.parametrize(
    ("arguments", "lines"),
    [
        (("--times", "0"), ["0 s", "no fading statistics: gain: shape (1,)"]),
        (("--times", "0,1,5"), ["5 s", "no fading statistics: time: not equally spaced"]),
        (
            (
                "--times",
                "0,1",
                "--photons",
                "64",
                "--set",
                "receiver.tilt_deg=89",
                "--set",
                "receiver.fov_deg=1",
            ),
            ["0.0000e+00", "no fading statistics: gain: all 0"],
        ),
    ],
)
def test_gains_without_statistics_are_printed(arguments, lines):
    code, said = command("series", *arguments)
    assert code == 0
    for line in lines:
        assert line in said


@pytest.mark.parametrize(
    "arguments",
    [
        ("series", "--times", "1:0:1"),
        ("series", "--times", "now"),
        ("ensemble", "-n", "1"),
        ("ensemble", "-n", "3", "--seed", "-1"),
        ("ensemble", "-n", "3", "-o", "/no/such/folder/e.nc"),
    ],
)
def test_bad_arguments_are_one_line(arguments):
    code, said = command(*arguments)
    assert code == 2
    assert said.startswith("error: ")
    assert said.count("\n") == 1


@pytest.mark.slow
def test_memory_of_an_ensemble_of_resolved_seas_is_flat():
    sea, process, used = resolved_sea(5.0, fetch=30e3), psutil.Process(), []
    options = {
        "photons": 64,
        "seed": 1,
        "progress": lambda _: used.append(process.memory_info().rss),
    }
    mt.ensemble(mt.Link(), 100, sea, **options)
    # half a megabyte for each sea were 35 MB
    assert max(used[90:]) - max(used[30:40]) < 12e6
