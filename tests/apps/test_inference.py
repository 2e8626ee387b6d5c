"""Inference: planted water is found, degenerate measurements are reported, priors, files."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.apps import inference
from meshtrace.surfaces import FlatSea

DEPTHS = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)
START = mt.Link().replace("water.a", 0.125).replace("water.b", 0.032)
CHAINS = 1024


@pytest.fixture(scope="module")
def truth():
    """Return gains of the planted water by depth and field of view, with other chains."""
    found = {}
    for depth in DEPTHS:
        for fov in (60.0, 6.0):
            link = mt.Link().replace("transmitter.depth", depth).replace("receiver.fov_deg", fov)
            found[depth, fov] = mt.simulate(link, FlatSea(), photons=8192, seed=77).gain
    return found


def rows(truth, fovs, rng=None, scale=1.0, error=0.02):
    found = []
    for (depth, fov), gain in truth.items():
        if fov in fovs:
            noise = 1.0 if rng is None else math.exp(error * rng.standard_normal())
            found.append(
                {
                    "transmitter.depth": depth,
                    "receiver.fov_deg": fov,
                    "gain": scale * gain * noise,
                    "stderr": error * scale * gain,
                }
            )
    return found


@pytest.mark.statistical
@pytest.mark.thorough
@pytest.mark.parametrize(
    ("draws", "least"), [(3, 2), pytest.param(20, 15, marks=pytest.mark.slow)], ids=str
)
def test_planted_water_is_found_from_two_fields_of_view(truth, draws, least):
    """Both unknowns lie within 2 standard errors in 91 % of the draws; significance 1 %."""
    rng, inside = np.random.default_rng(5), 0
    unknown = ["water.a", "water.b", "scale"]
    for _ in range(draws):
        f = mt.infer(rows(truth, (60.0, 6.0), rng, scale=2.5), START, unknown, photons=CHAINS)
        off = [
            abs(f.value[n] - v) / f.stderr[n] for n, v in (("water.a", 0.114), ("water.b", 0.037))
        ]
        inside += max(off) < 2.0
    assert inside >= least
    assert f.stderr["water.a"] / 0.114 == pytest.approx(0.0067, rel=0.3)
    assert f.stderr["water.b"] / 0.037 == pytest.approx(0.0515, rel=0.4)
    assert f.value["scale"] == pytest.approx(2.5, rel=0.05)
    assert f.degrees == 13
    assert f.chi2 < 30.0


@pytest.mark.thorough
def test_depth_alone_reports_the_weak_direction(truth):
    f = mt.infer(rows(truth, (60.0,)), START, ["water.a", "water.b"], photons=CHAINS)
    assert math.isnan(f.value["water.b"])
    assert math.isnan(f.stderr["water.b"])
    assert f.free_error[1] > 1.0
    assert f.correlation[0, 1] < -0.99
    assert f.weakest.startswith("water.b +10 % with water.a -0.")
    assert f.singular_values[0] > 300.0 * f.singular_values[1]
    assert "not determined" in f.summary()


@pytest.mark.thorough
def test_a_prior_adds_information(truth):
    data = rows(truth, (60.0, 6.0))
    free = mt.infer(data, START, ["water.a", "water.b"], photons=CHAINS)
    tied = mt.infer(
        data, START, ["water.a", "water.b"], {"water.b": (0.04, 0.0004)}, photons=CHAINS
    )
    assert tied.stderr["water.b"] < 0.5 * free.stderr["water.b"]
    assert abs(tied.value["water.b"] - 0.04) < abs(free.value["water.b"] - 0.04)
    assert tied.degrees == free.degrees + 1


def test_counts_and_columns_are_read_alike(truth):
    depths = DEPTHS[:3]
    counts = [round(1e9 * truth[d, 60.0]) for d in depths]
    columns = {"transmitter.depth": depths, "counts": counts}
    by_columns = mt.infer(columns, START, ["water.a", "scale"], photons=256)
    by_rows = mt.infer(
        [{"transmitter.depth": d, "counts": c} for d, c in zip(depths, counts, strict=True)],
        START, ["water.a", "scale"], photons=256,
    )  # fmt: skip
    assert by_columns.value == by_rows.value
    assert by_rows.value["scale"] == pytest.approx(1e9, rel=0.1)


def test_counts_of_zero_follow_the_law_of_poisson(truth):
    """One unknown factor of Poisson counts: the exact estimate is sum n / sum gain."""
    counts = {5.0: 7, 10.0: 2, 20.0: 0, 40.0: 0}
    rows_ = [{"transmitter.depth": d, "counts": n} for d, n in counts.items()]
    link = mt.Link()
    f = mt.infer(rows_, link, ["scale"], photons=1024)
    exact = sum(counts.values()) / sum(truth[d, 60.0] for d in counts)
    assert f.value["scale"] == pytest.approx(exact, rel=0.01)
    assert f.stderr["scale"] / f.value["scale"] == pytest.approx(1.0 / 3.0, rel=0.02)
    with pytest.raises(mt.Refused, match=r"measurements.counts: all 0"):
        mt.infer([{"counts": 0}], link, ["scale"], photons=64)
    with pytest.raises(mt.Refused, match=r"measurements\[0\].counts: -1"):
        mt.infer([{"counts": -1}], link, ["scale"], photons=64)


@pytest.mark.slow
@pytest.mark.statistical
def test_intervals_cover():
    """60 sets of their own chains and noise: intervals of few chains are as wide as they say."""
    keys = [(d, fov) for d in (5.0, 10.0, 20.0, 30.0) for fov in (60.0, 6.0)]
    gains = {}
    for d, fov in keys:
        link = mt.Link().replace("transmitter.depth", d).replace("receiver.fov_deg", fov)
        gains[d, fov] = mt.simulate(link, FlatSea(), photons=65_536, seed=77).gain
    rng, z, start = np.random.default_rng(18), [], START.replace("water.b", 0.037)  # as it is
    for seed in range(60):
        f = mt.infer(
            rows(gains, (60.0, 6.0), rng), start, ["water.a", "scale"], photons=256, seed=seed
        )
        z += [(f.value[n] - v) / f.stderr[n] for n, v in (("water.a", 0.114), ("scale", 1.0))]
    assert np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.mean(np.abs(z) < 1.96) > 0.87


@pytest.mark.thorough
def test_geometry_is_inferred_by_differences(truth):
    gains = {d: g for (d, fov), g in truth.items() if fov == 60.0 and d <= 15.0}
    data = [{"transmitter.depth": d, "gain": g, "stderr": 0.001 * g} for d, g in gains.items()]
    link = mt.Link().replace("receiver.height", 4.5)
    f = mt.infer(data, link, ["receiver.height"], photons=512)
    assert f.value["receiver.height"] == pytest.approx(5.0, abs=0.1)


@pytest.mark.slow
def test_items_of_lists_are_named_in_either_way(truth):
    data = rows(truth, (60.0,))[:1]
    found = [
        mt.infer(data, START, [name], {name: (0.3, 0.5)}, photons=64)
        for name in ("receiver.position.0", "receiver.position[0]")
    ]
    assert found[0].estimate == found[1].estimate
    assert found[0].unit == found[1].unit == ("m",)


def test_reweighting_is_a_new_run():
    """The gain at other a and b from the same chains is that of a simulation."""
    from meshtrace.apps.predictions import Predictor, read_measurements
    from meshtrace.studies import Variant
    from meshtrace.studies.campaign import campaign_of
    from meshtrace.studies.keys import parameters

    sea, link = FlatSea(), mt.Link()
    start = Variant(link, sea)
    unknowns = parameters(start, ["water.a", "water.b"], None, "vertex")
    data = read_measurements([{"gain": 1e-5, "stderr": 1e-7}])
    model = Predictor(
        campaign_of(link, sea, run={"photons": 4096, "threads": 1}), start, data, unknowns
    )
    x = np.log([1.3, 0.7])
    new = link.replace("water.a", 1.3 * 0.114).replace("water.b", 0.7 * 0.037)
    expected = mt.simulate(new, sea, photons=16384)
    assert math.exp(model.at(x).log[0]) == pytest.approx(expected.gain, rel=4e-3)
    h = 1e-3
    for i in range(2):
        sides = [model.at(x + s * h * np.eye(2)[i]).log[0] for s in (-1.0, 1.0)]
        assert model.at(x).slope[0, i] == pytest.approx((sides[1] - sides[0]) / (2 * h), rel=1e-4)


def test_file(truth, tmp_path):
    f = mt.infer(rows(truth, (60.0,)), START, ["water.a"], photons=64)
    f.save(tmp_path / "f.nc")
    assert mt.Inference.load(tmp_path / "f.nc").summary() == f.summary()


@pytest.mark.parametrize(
    ("data", "unknown", "prior", "message"),
    [
        ([], ["water.a"], None, "measurements: empty"),
        ([{"gain": 1e-5}], ["water.a"], None, r"measurements\[0\].stderr"),
        ([{"gain": -1.0, "stderr": 1.0}], ["water.a"], None, r"measurements\[0\].gain"),
        ([{"gain": 1e-5, "stderr": 1e-6}], ["water.aa"], None, "did you mean water.a"),
        ([{"gain": 1e-5, "stderr": 1e-6}], ["water.a", "water.b"], None, "at most 1"),
        ([{"gain": 1e-5, "stderr": 1e-6, "lamp": 3}], ["water.a"], None, "no such key"),
        ([{"gain": 1e-5, "stderr": 1e-6}], ["water.a"], {"water.b": (1, 1)}, r"prior\.'water\.b'"),
    ],
)
def test_refusals(data, unknown, prior, message):
    with pytest.raises(mt.Refused, match=message):
        mt.infer(data, mt.Link(), unknown, prior, photons=64)


@pytest.mark.slow
def test_fits_over_a_mesh_keep_its_digest_and_do_not_depend_on_kept_chains(monkeypatch):
    mesh = FlatSea().mesh(extent=20.0, spacing=2.0)
    rows = [{"transmitter.depth": d, "gain": g, "stderr": 0.05 * g}
            for d, g in ((8.0, 1e-4), (12.0, 3.5e-5))]  # fmt: skip
    kept = mt.infer(rows, mt.Link(), ["water.a"], surface=mesh, photons=256, threads=2)
    assert len(kept.provenance["surface"]["sha256"]) == 64
    monkeypatch.setattr(inference, "_LARGEST", 0)
    dropped = mt.infer(rows, mt.Link(), ["water.a"], surface=mesh, photons=256, threads=1)
    assert dropped.value == kept.value
