"""Every statistic of a gain is a sum of the rows of its light."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.results import impulse_response, load
from meshtrace.surfaces import FlatSea

pytestmark = pytest.mark.filterwarnings("ignore::meshtrace.FewSamplesWarning")

LINK = mt.Link(
    water=mt.Water(a=0.1, b=0.3),
    receiver=(mt.Receiver(radius=0.5, fov_deg=120.0), mt.Receiver(position=(1.0, 0.0))),
)
TILTED = mt.Link(receiver=mt.Receiver(tilt_deg=80.0))  # rests on joined photons
PHOTONS = {"chains": 1024, "joined": 128, "analog": 50_000}
CASES = {
    "chains": lambda: mt.simulate(LINK, FlatSea(), record=["arrivals"], **few("chains")),
    "joined": lambda: mt.simulate(TILTED, FlatSea(), record=["arrivals"], **few("joined")),
    "analog": lambda: mt.simulate(LINK, FlatSea(), "analog", record=["arrivals"], **few("analog")),
}


def few(name):
    return {"photons": PHOTONS[name], "seed": 3, "threads": 1}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    return request.param, CASES[request.param]()


def by_receiver(result):
    """Yield index, rows and the gain of each receiver."""
    rows = result.arrivals.to_dataframe()
    for i, gain in enumerate(result.gains):
        yield i, rows[rows.receiver == i], gain


def test_weights_add_up_to_the_gain(case):
    for _, rows, gain in by_receiver(case[1]):
        assert rows.weight.sum() == pytest.approx(gain, rel=1e-12)


def test_standard_errors_follow_from_groups_or_samples(case):
    name, result = case
    for i, rows, gain in by_receiver(result):
        if name == "analog":
            n = result.photons
            score = n * rows.groupby("sample").weight.sum()
            error = math.sqrt(((score**2).sum() / n - gain**2) / (n - 1))
        else:
            chance = rows[rows.group >= 0]
            groups = 32.0 * np.bincount(chance.group, chance.weight, 32)
            error = groups.std(ddof=1) / math.sqrt(32)
        assert error == pytest.approx(result.stderrs[i], rel=1e-10)


@pytest.mark.parametrize("name", ["chains", "joined"])
def test_parts_orders_and_effective_samples_are_sums(name):
    result = CASES[name]()
    for i, rows, _ in by_receiver(result):
        scattered, reflected = (rows[rows.part == k] for k in (1, 2))
        expected = np.atleast_1d(result.gain_scattered)[i]
        assert scattered.weight.sum() == pytest.approx(expected, rel=1e-12)
        expected = 0.0
        if result.gain_reflected is not None:
            expected = np.atleast_1d(result.gain_reflected)[i]
        assert reflected.weight.sum() == pytest.approx(expected, rel=1e-12)
        orders = np.bincount(scattered.order, scattered.weight)[1:]
        np.testing.assert_allclose(orders, result.gain_order[i][: len(orders)], rtol=1e-12)
        sample = scattered.groupby("sample").weight.sum()
        assert len(sample) == result.scattered[i].scored
        effective = sample.sum() ** 2 / (sample**2).sum()
        assert effective == pytest.approx(result.scattered[i].effective, rel=1e-10)


def test_the_impulse_response_is_a_histogram_of_times(case):
    for i, rows, _ in by_receiver(case[1]):
        response = impulse_response(case[1], 1e-9, i)
        edges = response.first_arrival + response.edges
        h, _ = np.histogram(rows.time, edges, weights=rows.weight / 1e-9)
        np.testing.assert_allclose(h, response.h, rtol=1e-9, atol=1e-9 * response.h.max())


def test_angles_cut_off_are_those_of_a_narrower_view():
    """Of the same photons: the angle decides whether an aperture takes them."""
    link = LINK.replace("receiver", LINK.receivers[0])
    wide, narrow = (
        mt.simulate(
            link.replace("receiver.fov_deg", fov),
            FlatSea(),
            "analog",
            record=record,
            **few("analog"),
        )
        for fov, record in ((120.0, ["arrivals"]), (12.0, []))
    )
    rows = wide.arrivals.to_dataframe()
    inside = rows[rows.angle <= math.radians(6.0)]
    assert 0.0 < narrow.gain < 0.99 * wide.gain
    assert inside.weight.sum() == pytest.approx(narrow.gain, rel=1e-12)


def test_columns_have_units(case):
    data = case[1].arrivals.to_dataset()
    units = {str(name): data[name].attrs["units"] for name in data}
    assert units["time"] == "s"
    assert units["water_path"] == units["air_path"] == "m"
    assert units["angle"] == units["azimuth"] == "rad"
    assert len(units) == 11


def test_tables_survive_a_file(case, tmp_path):
    arrivals = case[1].arrivals
    case[1].save(tmp_path / "gain.nc")
    loaded = load(tmp_path / "gain.nc").arrivals
    for name in arrivals.to_dataset():
        np.testing.assert_array_equal(getattr(loaded, name), getattr(arrivals, name))
