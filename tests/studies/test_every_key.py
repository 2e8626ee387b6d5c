"""Keys of detector, daylight and aircraft in sensitivities, optimisation and inference."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.comms.budget import required_gain
from meshtrace.comms.capacity import capacity
from meshtrace.errors import Refused
from meshtrace.studies import Variant
from meshtrace.studies.keys import parameters

pytestmark = pytest.mark.filterwarnings(
    "ignore::meshtrace.DaylightWarning", "ignore::meshtrace.FewSamplesWarning"
)
FILE = """
wind_speed = 0.0
[transmitter]
depth = 24.0
[receiver]
fov_deg = 20.0
[detector]
optics = {filter_width_nm = 2.0}
[daylight]
direct = 1.42
diffuse = 0.295
"""
WIDTH = "detector.optics.filter_width_nm"
DAY = mt.Daylight(direct=1.42, diffuse=0.295)


def scenario(**changes):
    changes = {name.replace("__", "."): value for name, value in changes.items()}
    return mt.Scenario.from_toml(FILE, changes=changes)


def margin(key, value):
    """Return the margin by day of a run of its own [dB]."""
    at = mt.link_performance(scenario(**{key: value}), photons=64, realizations=2)
    return at.at().margin_optical_db.value


@pytest.mark.parametrize(
    ("key", "base"),
    [
        pytest.param(WIDTH, 2.0, marks=pytest.mark.slow),
        pytest.param("detector.bit_rate", 1e6, marks=pytest.mark.slow),
        pytest.param("detector.sipm.pde", 0.3, marks=pytest.mark.thorough),
        pytest.param("daylight.direct", 1.42, marks=pytest.mark.slow),
    ],
)
def test_margins_by_day_have_the_slopes_of_runs_of_their_own(key, base):
    s = mt.sensitivities(scenario(), wrt=[key], quantity="margin", photons=64)
    low, high = (margin(key, base * (1.0 + step)) for step in (-0.01, 0.01))
    assert s.derivative(key).value == pytest.approx((high - low) / (0.02 * base), rel=1e-3)
    assert abs(low - high) > 1e-3


@pytest.mark.slow
def test_tilts_of_an_aircraft_count_as_in_a_performance():
    def at(mass):
        changes = {"uav.mass": mass, "wind_speed": 13.0, "sea.spectrum": "flat"}
        return mt.Scenario.from_toml(FILE, changes=changes)

    options = {"photons": 64}
    s = mt.sensitivities(at(8.37), wrt=["uav.mass"], quantity="margin", **options)
    rates = [
        mt.link_performance(at(m), realizations=40, daylight=DAY, **options).at().gain.value
        for m in (8.37 * 0.99, 8.37 * 1.01)
    ]
    expected = 10.0 * math.log10(rates[1] / rates[0]) / (0.02 * 8.37)
    assert s.derivative("uav.mass").value == pytest.approx(expected, rel=0.1)
    assert expected > 0.0  # a heavier aircraft leans less


@pytest.mark.slow
def test_the_margin_of_a_filter_and_a_view_is_best_where_a_scan_says():
    views, widths = (8.0, 16.0, 32.0), (1.0, 4.0)
    o = mt.optimize(
        scenario(), bounds={"receiver.fov_deg": (8.0, 32.0), WIDTH: (1.0, 4.0)},
        objective="margin", realizations=1, photons=64,
    )  # fmt: skip
    scan = {
        (view, width): mt.link_performance(
            scenario(receiver__fov_deg=view, detector__optics__filter_width_nm=width),
            photons=64, realizations=2,
        ).at().margin_optical_db.value
        for view in views for width in widths
    }  # fmt: skip
    best = max(scan, key=scan.get)
    assert o.values == pytest.approx(best, rel=0.02)
    assert o.value == pytest.approx(scan[best], abs=0.1)  # dB; other rays and chains
    assert o.changes == {"receiver.fov_deg": o.values[0], WIDTH: o.values[1]}
    assert f"{o.changes[WIDTH]:g} nm" in o.notes[-1]  # the light is that of the best candidate


@pytest.mark.slow
def test_the_bit_rate_of_most_capacity_is_that_of_a_scan():
    key = "detector.bit_rate"
    o = mt.optimize(
        scenario(), bounds={key: (1e6, 1e8)}, objective="capacity", realizations=1, photons=64
    )
    lit = scenario()
    found = mt.background(lit.link, lit.surface, DAY, photons=2048)
    gain = mt.simulate(lit.link, lit.surface, photons=2048).gain
    rates = np.geomspace(1e6, 1e8, 41)
    carried = []
    for rate in rates:
        ook = lit.detector.replace("bit_rate", float(rate))
        ook = ook.replace(background_rate=found.count_rate(ook))
        carried.append(capacity(ook, [gain]).hard)
    best = int(np.argmax(carried))
    assert o.values[0] == pytest.approx(rates[best], rel=0.15)
    assert o.value == pytest.approx(carried[best], rel=0.03)


@pytest.mark.thorough
def test_the_cost_of_a_user_sees_detector_and_background():
    seen = []

    def cost(at, gains, weights):
        seen.append(at.detector)
        short = max(required_gain(at.detector, 1e-3) / float(gains @ weights) - 1.0, 0.0)
        return at.detector.optics.filter_width_nm**-1 + 100.0 * short

    o = mt.optimize(
        scenario(detector__bit_rate=4e6), bounds={WIDTH: (0.5, 40.0)}, objective=cost,
        realizations=1, photons=64, constraints=[lambda at: 30.0 - at.link.receiver.fov_deg],
    )  # fmt: skip
    widest = mt.link_performance(
        scenario(detector__bit_rate=4e6), photons=64, realizations=2
    ).at().widest_filter_nm  # fmt: skip
    assert o.values[0] == pytest.approx(widest, rel=0.1)
    rates = {ook.optics.filter_width_nm: ook.background_rate for ook in seen}
    per_nm = [rate / width for width, rate in rates.items()]
    assert min(per_nm) > 0.0
    assert np.ptp(per_nm) < 1e-9 * max(per_nm)


def rows(truth, **stderr):
    """Return received powers and error rates of a link at several depths by day."""
    found = []
    for depth in (20.0, 24.0, 28.0):
        at = truth.model_copy(update={"link": truth.link.at_depth(depth)})
        point = mt.link_performance(at, photons=4096, realizations=2).at()
        for name, value in (("power", point.received_power.value), ("ber", point.ber.value)):
            if name in stderr and value > 1e-12:
                row = {"transmitter.depth": depth, name: value, "stderr": stderr[name] * value}
                found.append(row)
    return found


@pytest.mark.slow
def test_detection_and_water_are_inferred_from_powers_and_error_rates():
    truth = scenario(detector__bit_rate=4e6, detector__sipm__pde=0.4)
    given = rows(truth, power=0.01, ber=0.05)
    start = scenario(detector__bit_rate=4e6, water__a=0.12)
    f = mt.infer(given, start, ["water.a", "detector.sipm.pde"], photons=4096)
    assert f.value["water.a"] == pytest.approx(0.114, abs=3.0 * f.stderr["water.a"])
    assert f.value["detector.sipm.pde"] == pytest.approx(
        0.4, abs=3.0 * f.stderr["detector.sipm.pde"]
    )
    assert f.stderr["detector.sipm.pde"] < 0.02


def test_keys_of_the_light_are_none_of_those_by_default():
    at = scenario()
    variant = Variant(at.link, at.surface, at.detector, at.daylight, mt.Uav())
    known = [p.name for p in parameters(variant, None, None, "vertex")]
    assert "water.a" in known
    assert not [name for name in known if name.startswith(("daylight", "detector", "uav"))]


def test_unknown_keys_are_refused_with_those_allowed():
    for study, field, options in (
        (mt.sensitivities, "wrt", {"wrt": ["detector.optics.filter"], "quantity": "margin"}),
        (mt.optimize, "bounds", {"bounds": {"detector.optics.filter": (1.0, 2.0)}}),
    ):
        with pytest.raises(Refused) as refused:
            study(scenario(), photons=64, realizations=1, **options)
        assert refused.value.field == field
        for key in (WIDTH, "detector.bit_rate", "daylight.*", "receiver.*", "n_air"):
            assert key in refused.value.allowed.split(", ")
        assert "detector.led.power" not in refused.value.allowed  # follows the lamp
    with pytest.raises(Refused, match=r"a transmission, for capacity"):
        mt.optimize(
            mt.Link(), bounds={"receiver.fov_deg": (5.0, 9.0)}, objective="capacity", ook=None
        )
    with pytest.raises(Refused, match=r"measurements\[0\]\.ber"):
        mt.infer([{"ber": 1e-3, "stderr": 1e-4}], mt.Link(), ["water.a"], photons=64)
    lit = [{"ber": 1e-3, "stderr": 1e-4, "daylight.model_": 3.0}]
    with pytest.raises(Refused, match=r"measurements.*daylight"):
        mt.infer(lit, scenario(), ["water.a"], photons=64)
