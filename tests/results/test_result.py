"""Results: standard errors, round trips, merging and its refusals."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import stored
from meshtrace.results import Fate, tallies
from meshtrace.results.gain import FATE_MEANING, FateTally
from meshtrace.surfaces import FlatSea

FLAT = FlatSea().mesh(extent=80.0, spacing=40.0)
LINK = mt.Link(receiver=mt.Receiver(radius=1.0))


def run(link=LINK, photons=8192, **options):
    return mt.simulate(link, FLAT, estimator="analog", photons=photons, **options)


@pytest.fixture(scope="module")
def rich():
    """Return a result with everything in it."""
    link = mt.Link(
        receiver=(mt.Receiver(radius=1.0), mt.WaterAperture(depth=2.0, radius=1.0)),
        planes=mt.IrradiancePlanes(depths=(1.0, 4.0), n_cosines=5, n_azimuths=3),
    )
    return run(link, record=[mt.IrradianceMap(height=5.0, extent=2.0, step=0.5), mt.Arrivals()])


def assert_same(a, b):
    np.testing.assert_array_equal(a.gain, b.gain)
    assert type(a.gain) is type(b.gain)
    np.testing.assert_array_equal(a.gain_stderr, b.gain_stderr)
    for name in (
        "photons",
        "fates",
        "provenance",
        "rays_recast",
        "rays_lost",
        "gain_ballistic",
        "gain_scattered",
    ):
        assert getattr(a, name) == getattr(b, name), name
    for name in ("arrivals", "planes", "map"):
        assert (getattr(a, name) is None) == (getattr(b, name) is None)
        if getattr(a, name) is not None:
            one, other = (
                stored.variables_of(getattr(a, name)),
                stored.variables_of(getattr(b, name)),
            )
            assert one.keys() == other.keys()
            for key, (dims, values) in one.items():
                assert other[key][0] == dims
                np.testing.assert_array_equal(other[key][1], values, err_msg=key)


# ---- standard error ------------------------------------------------------------------------


def test_standard_error_is_that_of_a_mean():
    x = np.random.default_rng(1).exponential(size=(5000, 3))
    expected = x.std(axis=0, ddof=1) / math.sqrt(len(x))
    got = tallies.standard_error(x.sum(axis=0), (x**2).sum(axis=0), len(x))
    np.testing.assert_allclose(got, expected, rtol=1e-10)


def test_standard_error_of_hits_is_binomial():
    hits, n = 40, 10**6
    expected = math.sqrt(hits / n * (1 - hits / n) / (n - 1))
    assert tallies.standard_error(np.array(hits), np.array(hits), n) == pytest.approx(expected)


def test_standard_error_of_equal_scores_is_zero_and_of_one_unknown():
    assert tallies.standard_error(np.array(3.0), np.array(3.0), 3) == 0.0
    assert np.isnan(tallies.standard_error(np.array(0.4), np.array(0.16), 1))


def test_standard_error_covers_the_truth():
    """Gains of 200 runs over their standard errors have unit variance."""
    link = LINK.model_copy(update={"water": mt.Water(b=0.3)})
    runs = [run(link, photons=4096, first_photon=4096 * k) for k in range(200)]
    gains = np.array([r.gain for r in runs])
    pulls = (gains - gains.mean()) / np.array([r.gain_stderr for r in runs])
    # chi-square of 199 degrees of freedom: 199 +- 20; the errors themselves are noisy
    assert 130.0 < (pulls**2).sum() < 290.0
    merged = mt.merge(runs)
    assert merged.gain_stderr == pytest.approx(gains.std(ddof=1) / math.sqrt(200), rel=0.25)


# ---- values and round trips ----------------------------------------------------------------


def test_decibels():
    r = replace(run(photons=4096), gain=1e-3)
    assert r.gain_db == pytest.approx(-30.0)
    assert replace(r, gain=0.0).gain_db == -math.inf
    many = replace(r, gain=np.array([1.0, 0.1, 0.0]))
    np.testing.assert_allclose(many.gain_db, [0.0, -10.0, -np.inf])


def test_fates_have_names_and_meanings():
    assert set(FATE_MEANING) == set(Fate)
    assert sorted(Fate) == list(range(len(Fate)))


@pytest.mark.parametrize("which", ["scalar", "rich"])
def test_dataset_round_trip(rich, which):
    r = rich if which == "rich" else run()
    assert_same(r, mt.GainResult.from_dataset(r.to_dataset()))


@pytest.mark.parametrize("which", ["scalar", "rich"])
def test_file_round_trip(rich, which, tmp_path):
    r = rich if which == "rich" else run()
    r.save(tmp_path / "gain.nc")
    assert_same(r, mt.GainResult.load(tmp_path / "gain.nc"))


def test_a_single_photon_and_an_empty_receiver_list_survive_the_file(tmp_path):
    for k, r in enumerate((run(photons=1), run(mt.Link(receiver=())))):
        r.save(tmp_path / f"{k}.nc")
        assert_same(r, mt.GainResult.load(tmp_path / f"{k}.nc"))


def test_dataset_carries_fates_and_format(rich):
    ds = rich.to_dataset()
    assert ds.attrs["format_version"] == stored.FORMAT_VERSION
    assert ds["fate"].attrs["flag_meanings"].split() == [f.name.lower() for f in Fate]
    assert ds["fate"].values.tolist() == [int(f) for f in Fate]
    assert int(ds["fate_photons"].sum()) == rich.photons
    assert float(ds["fate_weight"].sum()) == pytest.approx(1.0, abs=1e-12)


def test_other_formats_are_refused(rich):
    ds = rich.to_dataset()
    for key, value in (("format_version", stored.FORMAT_VERSION + 1), ("kind", "series")):
        other = ds.copy()
        other.attrs = {**ds.attrs, key: value}
        with pytest.raises(ValueError, match="format_version"):
            mt.GainResult.from_dataset(other)


def test_provenance_loads_back_and_repeats_the_run(rich):
    origin = json.loads(json.dumps(rich.provenance))
    link = mt.Link.model_validate(origin["link"])
    again = mt.simulate(link, FLAT, **origin["run"])
    np.testing.assert_array_equal(again.gain, rich.gain)
    assert again.fates == rich.fates
    for name in ("meshtrace", "git_commit", "numpy", "numba", "embreex"):
        assert origin["environment"][name]


# ---- merge ---------------------------------------------------------------------------------


def parts(*bounds, **options):
    return [run(photons=b - a, first_photon=a, **options) for a, b in bounds]


def test_merge_of_one_is_itself():
    r = run()
    assert_same(replace(mt.merge([r]), provenance=r.provenance), r)


def test_merge_in_stages_is_merge_at_once():
    a, b, c = parts((0, 4096), (4096, 5000), (5000, 9000))
    staged, once = mt.merge([mt.merge([a, b]), c]), mt.merge([c, a, b])
    assert staged.photons == once.photons == 9000
    assert staged.gain == pytest.approx(once.gain, rel=1e-13)
    assert staged.gain_stderr == pytest.approx(once.gain_stderr, rel=1e-13)


def test_merge_refuses_overlap_and_other_configurations():
    a, b = parts((0, 4096), (4000, 8000))
    with pytest.raises(ValueError, match="overlap"):
        mt.merge([a, b])
    (far,) = parts((10_000, 14_096))
    (seeded,) = parts((10_000, 14_096), seed=2)
    wide = run(mt.Link(receiver=mt.Receiver(radius=2.0)), first_photon=10_000)
    for other in (seeded, wide):
        with pytest.raises(ValueError, match="configurations differ"):
            mt.merge([a, other])
    with pytest.raises(ValueError, match=r"results: \[\], allowed"):
        mt.merge([])
    assert mt.merge([a, far]).photons == 8192


def test_merge_remembers_which_photons_it_holds():
    """Merged runs may leave a gap: the gap may be filled, but nothing be counted twice."""
    a, b, c = parts((0, 4096), (8192, 12_288), (4096, 8192))
    gap = mt.merge([a, c]), mt.merge([a, b])
    with pytest.raises(ValueError, match="overlap"):
        mt.merge([gap[1], b])
    assert mt.merge([gap[1], c]).photons == 3 * 4096
    assert gap[0].photons == 8192


def test_merge_keeps_arrivals_of_every_part():
    """A part that received nothing is a part like the others."""
    link = mt.Link()
    dark = run(link, photons=1, record=[mt.Arrivals()])
    lit = run(link, photons=300_000, first_photon=1, record=[mt.Arrivals()])
    assert dark.gain == 0.0
    assert lit.gain > 0.0
    merged = mt.merge([dark, lit])
    assert merged.arrivals.weight.sum() == pytest.approx(merged.gain, rel=1e-9)


def test_merge_refuses_maps_of_different_places():
    a = run(record=[mt.IrradianceMap(height=5.0, extent=5.0, step=1.0)])
    b = run(record=[mt.IrradianceMap(height=5.0, extent=10.0, step=2.0)], first_photon=8192)
    with pytest.raises(ValueError, match="configurations differ"):
        mt.merge([a, b])


def test_merge_refuses_meshes_that_differ_in_their_normals_only():
    tilted = mt.TriangleMesh(
        FLAT.vertices, FLAT.faces, np.tile((0.6, 0.0, 0.8), (len(FLAT.vertices), 1))
    )
    a = run()
    b = mt.simulate(LINK, tilted, estimator="analog", photons=8192, first_photon=8192)
    with pytest.raises(ValueError, match="configurations differ"):
        mt.merge([a, b])


def test_relative_tolerance_is_met_or_not_claimed():
    """No hit yet is no result: a gain of 0 +- 0 does not meet a relative tolerance."""
    lucky = run(rtol=0.05, photons=4096)
    assert lucky.gain_stderr <= 0.05 * lucky.gain
    rare = mt.Link(receiver=mt.Receiver(radius=0.2))
    r = run(rare, rtol=0.2, photons=16)
    assert r.gain > 0.0
    assert r.gain_stderr <= 0.2 * r.gain


def test_fate_tally_is_a_pair():
    assert FateTally(3, 0.5) == (3, 0.5)
