"""Seas from records of gauges in a known JONSWAP sea: every record has its own phases."""

import math

import numpy as np
import pytest
from scipy import stats

from meshtrace.scenario import Scenario
from meshtrace.surfaces import (
    Band,
    Cos2sSpreading,
    Jonswap,
    SpectralSea,
    from_gauge,
    gauge_spectrum,
    sea_from_config,
)
from meshtrace.surfaces.statistics import components_hs

TIME = np.arange(0.0, 1200.0, 0.25)
AROUND = np.radians(np.arange(0.0, 360.0, 72.0))
PENTAGON = [(0.0, 0.0), *zip(1.5 * np.cos(AROUND), 1.5 * np.sin(AROUND), strict=True)]
DEPTH = 6.0
COS2S = {"kind": "cos2s", "s": 15.0}


def tank(direction_deg=0.0, seed=1, d_theta=5.0):
    return SpectralSea(
        spectrum=Jonswap(hs=1.0, tp=4.0, wind_speed=8.0),
        spreading=Cos2sSpreading(s=15.0),
        wind_direction_deg=direction_deg,
        mss="band",
        depth=DEPTH,
        seed=seed,
        waves=Band(
            omega_min=0.9, omega_max=6.0, d_theta=math.radians(d_theta), d_omega=0.1 * d_theta / 5.0
        ),
    )


def record(sea, positions=((0.0, 0.0),)):
    """Return times and elevations at places, by the sum over the waves of a sea."""
    waves, (x, y) = sea.components, np.transpose(positions)
    phase = waves.phase[:, None] - np.outer(waves.kx, x) - np.outer(waves.ky, y)
    turned = waves.amplitude[:, None] * np.exp(1j * phase)
    rows = [(np.exp(1j * np.outer(t, waves.omega)) @ turned).real for t in np.split(TIME, 6)]
    return np.column_stack([TIME, np.concatenate(rows)])


def direction(sea):
    """Return the mean direction and the circular spread about the peak [deg]."""
    waves = sea.components
    peak = (waves.omega > 1.2) & (waves.omega < 2.2)
    power = waves.amplitude[peak] ** 2
    turn = np.exp(1j * np.arctan2(waves.ky, waves.kx)[peak])
    mean = (power * turn).sum() / power.sum()
    return np.degrees(np.angle(mean)), np.degrees(math.sqrt(2.0 * (1.0 - abs(mean))))


@pytest.mark.thorough
@pytest.mark.statistical
def test_one_gauge_gives_height_period_and_spectrum_within_their_errors():
    """Significance 1e-4 each; the limits of 65 of 75 bins, above the foot of the peak."""
    seas = [tank(seed=seed) for seed in range(6)]
    found = [
        gauge_spectrum(record(sea), DEPTH, spreading=COS2S, f_min=0.17, f_max=0.9) for sea in seas
    ]
    omega = 2.0 * np.pi * found[0].freq.values
    expected = 2.0 * np.pi * seas[0].spectrum(omega)
    inside = [(f.spectrum_low < expected) & (f.spectrum_high > expected) for f in found]
    # neighbouring bins share the taper: a third of the number is independent
    share, n = float(np.mean(inside)), sum(x.size for x in inside) / 3
    assert stats.binomtest(round(share * n), round(n), 0.95).pvalue > 1e-4
    # sum of S^2 df over (sum of S df)^2 is the squared relative error of the variance, over T
    S = np.array([f.spectrum.values for f in found])
    df = found[0].freq.values[1] - found[0].freq.values[0]
    error = math.sqrt((expected**2).sum() * df / TIME[-1]) / (expected.sum() * df)
    ratio = S.sum(axis=1) / expected.sum()
    assert abs(ratio.mean() - 1.0) < 3.9 * error / math.sqrt(len(S))
    assert ratio.std(ddof=1) < 3.0 * error
    assert [f.attrs["tp"] for f in found] == pytest.approx([4.0] * 6, rel=0.08)  # one bin: 5 %
    assert found[0].attrs["hs"] == pytest.approx(1.0, abs=0.06)
    assert found[0].attrs["degrees_of_freedom"] == pytest.approx(58.8, abs=0.1)


def test_one_gauge_has_the_stated_directions(tmp_path):
    path = tmp_path / "gauge.csv"
    rows = record(tank(d_theta=15.0)) * [1.0, 1000.0]
    np.savetxt(path, rows, fmt="%.3f", delimiter=",", header="t [s],eta [mm]", comments="")
    sea = from_gauge(path, 2, DEPTH, spreading=COS2S, direction_deg=120.0, mss="band")
    assert sea.depth == DEPTH
    assert sea.waves == "drawn"
    assert sea.record == "gauge.csv, 1200 s of 1 gauge"
    assert components_hs(sea.components) == pytest.approx(1.0, abs=0.06)
    mean, spread = direction(sea)
    assert mean == pytest.approx(120.0, abs=0.5)
    assert spread == pytest.approx(direction(tank())[1], abs=0.5)
    assert sea_from_config(sea.to_config()) == sea
    text = '[sea]\nspectrum = "gauge"\nfile = "gauge.csv"\nseed = 2\ndepth = 6.0\nmss = "band"\n'
    text += 'direction_deg = 120.0\nspreading = { kind = "cos2s", s = 15.0 }\n'
    (tmp_path / "link.toml").write_text(text, encoding="utf-8")
    again = Scenario.load(tmp_path / "link.toml").surface
    assert again.wind_direction_deg == pytest.approx(120.0)
    assert again.omega == sea.omega
    assert again.variance == sea.variance


@pytest.mark.thorough
@pytest.mark.parametrize("direction_deg", [0.0, 40.0, 200.0])
def test_an_array_sees_direction_and_spreading(direction_deg):
    """The method's own error over 20 minutes: 1 deg of direction and 1.5 deg of spread."""
    pytest.importorskip("diwasp")
    sea = tank(direction_deg)
    found = from_gauge(record(sea, PENTAGON), 1, DEPTH, positions=PENTAGON, mss="band")
    mean, spread = direction(found)
    true_mean, true_spread = direction(sea)
    assert (mean - true_mean + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=2.0)
    assert spread == pytest.approx(true_spread, abs=3.0)
    assert components_hs(found.components) == pytest.approx(1.0, abs=0.06)


def plain(gauges=1):
    return np.column_stack([TIME] + [np.cos(1.5 * TIME)] * gauges)


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        (plain(), {}, "spreading: None, allowed: a spreading: one gauge does not see"),
        (plain(), {"spreading": "itc"}, "kind: 'itc', did you mean ittc"),
        (plain(), {"spreading": "elfouhaily"}, "wind_speed: None, allowed: a wind speed"),
        (plain(), {"spreading": "ittc", "unit": "kPa"}, "unit: kPa, allowed: .*pressures as"),
        (plain(), {"spreading": "ittc", "segments": 1000}, "segments: 1000, allowed: .* 300"),
        (plain(), {"spreading": "ittc", "segments": 300}, "peak: .* fewer segments"),
        (plain(), {"spreading": "ittc", "f_max": 3.0}, "f_max: 3.0, allowed: .* 2"),
        (plain(), {"spreading": "ittc", "depth": -1.0}, "depth: -1.0"),
        (plain(), {"spreading": "ittc", "confidence": 1.0}, "confidence: 1.0"),
        (plain() * [1.0, 0.0], {"spreading": "ittc"}, "source: a gauge that does not vary"),
        (np.delete(plain(), 2000, axis=0), {"spreading": "ittc"}, "unequal steps in time"),
        (TIME, {"spreading": "ittc"}, "source: shape"),
        (plain(3), {}, r"positions: shape \(0,\), allowed: 3 pairs"),
        (plain(3), {"positions": [(0, 0), (1, 1), (2, 2)]}, "three or more not on a line"),
        (plain(2), {"positions": [(0, 0), (1, 1)]}, "three or more"),
    ],
)
def test_refuses(source, options, message):
    with pytest.raises(ValueError, match=message) as error:
        gauge_spectrum(source, **options)
    assert "\n" not in str(error.value)


def test_gauges_too_far_apart_are_refused():
    pytest.importorskip("diwasp")
    with pytest.raises(ValueError, match="positions: 100 m at least between gauges, allowed"):
        gauge_spectrum(plain(3), positions=[(0, 0), (100, 0), (0, 100)], f_min=0.1)


@pytest.mark.parametrize(
    ("header", "message"),
    [("t [ms],eta [m]", "time in ms"), ("t,p [dbar]", "unit: dbar"), ("t,a [m],b [cm]", "cm, m")],
)
def test_refuses_units(tmp_path, header, message):
    path = tmp_path / "gauge.csv"
    gauges = header.count(",")
    np.savetxt(path, plain(gauges)[:600], delimiter=",", header=header, comments="")
    with pytest.raises(ValueError, match=message):
        gauge_spectrum(path, spreading="ittc")


def test_a_link_file_refuses_other_keys(tmp_path):
    with pytest.raises(ValueError, match=r"sea\.file: missing, allowed: a path"):
        Scenario.from_toml('[sea]\nspectrum = "gauge"')
    with pytest.raises(ValueError, match=r"sea\.segment: 8, no such key, did you mean segments"):
        Scenario.from_toml('[sea]\nspectrum = "gauge"\nfile = "g.csv"\nsegment = 8')
