import math

import numpy as np
import pytest
import wavespectra
import xarray as xr

import meshtrace as mt
from meshtrace.surfaces import (
    Elfouhaily,
    MeasuredSea,
    directional,
    from_wavespectra,
    sea_from_config,
)
from meshtrace.surfaces.statistics import components_hs, components_slope_variance, cox_munk

SHORT = pytest.mark.filterwarnings("ignore:source. the spectrum ends:meshtrace.DomainWarning")
pytestmark = SHORT


def dataset(coming_from=270.0, extra=False):
    freq = np.geomspace(0.05, 0.8, 30)
    direction = np.arange(0.0, 360.0, 10.0)
    S = freq**-5.0 * np.exp(-1.25 * (0.2 / freq) ** 4) * 1e-4
    turn = np.radians(direction - coming_from)
    D = np.where(np.cos(turn) > 0, np.cos(turn) ** 2, 0.0)
    efth = S[:, None] * D / (D.sum() * 10.0)
    data = xr.Dataset({"efth": (("freq", "dir"), efth)}, coords={"freq": freq, "dir": direction})
    return data.expand_dims(time=2 if extra else 1, site=1)


def wavespectra_hs(data):
    """Hs as wavespectra sums it: end bins have the width of their only neighbour."""
    freq = data.freq.values
    df = np.hstack([freq[1] - freq[0], 0.5 * (freq[2:] - freq[:-2]), freq[-1] - freq[-2]])
    return 4.0 * math.sqrt(float((data.efth.isel(time=0, site=0).sum("dir") * 10.0 * df).sum()))


def test_height_and_direction():
    sea = from_wavespectra(dataset(), seed=5)
    assert isinstance(sea, MeasuredSea)
    assert components_hs(sea.components) == pytest.approx(wavespectra_hs(dataset()), rel=1e-12)
    waves = sea.components
    # Waves from the west run to the east, +x.
    power = waves.amplitude**2
    assert np.sum(power * waves.kx) > 0.5 * np.sum(power * np.hypot(waves.kx, waves.ky))
    assert np.sum(power * waves.ky) == pytest.approx(0.0, abs=1e-12)
    along, across = components_slope_variance(waves)
    assert along / across == pytest.approx(3.0, rel=1e-9)


def test_waves_from_the_north_run_to_minus_y():
    waves = from_wavespectra(dataset(coming_from=0.0)).components
    power = waves.amplitude**2
    assert np.sum(power * waves.ky) < -0.5 * np.sum(power * np.hypot(waves.kx, waves.ky))


@pytest.mark.parametrize(("engine", "needs"), [("scipy", "scipy"), ("h5netcdf", "h5py")])
def test_reads_netcdf_in_any_order(tmp_path, engine, needs):
    pytest.importorskip(needs)
    path = tmp_path / "spectrum.nc"
    shuffled = (
        dataset().isel(dir=np.roll(np.arange(36), 7)).transpose("dir", "time", "freq", "site")
    )
    shuffled.to_netcdf(path, engine=engine)
    sea = from_wavespectra(path, seed=2, depth=20.0)
    assert sea == from_wavespectra(dataset(), seed=2, depth=20.0)
    assert sea == from_wavespectra(str(path), seed=2, depth=20.0)
    assert sea_from_config(sea.to_config()) == sea


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.rename(efth="energy"), r"without \['efth'\]"),
        (lambda d: dataset(extra=True), r"efth: .*dimensions .*select one time and site"),
        (lambda d: d.isel(dir=slice(0, 30)), r"dir: steps of 10 to 70 deg, allowed: equal"),
        (lambda d: d * math.nan, "efth: .*finite variance"),
    ],
)
def test_refuses(change, message):
    with pytest.raises(ValueError, match=message):
        from_wavespectra(change(dataset()))


def record(**coords):
    """Return spectra at three times and two stations, whose heights tell them apart."""
    one = dataset().isel(time=0, site=0)
    factors = np.arange(1.0, 7.0).reshape(3, 2)
    times = np.array(["2024-05-01T00", "2024-05-01T01", "2024-05-01T02"], "datetime64[ns]")
    coords = {"lon": ("site", [-5.0, 3.0]), "lat": ("site", [48.0, 54.0]), **coords}
    data = one.efth * xr.DataArray(factors, dims=("time", "site"), coords={"time": times})
    return data.to_dataset(name="efth").assign_coords(coords)


@pytest.mark.parametrize(
    ("time", "site", "factor"),
    [
        ("2024-05-01T01:20", 1, 4.0),
        ("2024-05-01T00:00", (-5.4, 48.1), 1.0),
        (np.datetime64("2024-05-01T02:30"), (363.0, 54.0), 6.0),
    ],
)
def test_one_time_and_one_site(time, site, factor):
    sea = from_wavespectra(record(), time=time, site=site)
    assert components_hs(sea.components) == pytest.approx(
        math.sqrt(factor) * wavespectra_hs(dataset()), rel=1e-12
    )
    assert "time 2024-05-01T0" in sea.record


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time": "2024-05-01T03", "site": 0}, "time: .*allowed: within half a step of 2024-05-01"),
        ({"time": "soon", "site": 0}, "time: 'soon', allowed: a date from 2024-05-01"),
        ({"time": "2024-05-01", "site": 2}, "site: 2, allowed: 0 to 1, of 2 stations"),
        ({"time": "2024-05-01", "site": (0.0, 0.0)}, "site: .*allowed: within 1 deg"),
        ({"time": "2024-05-01"}, r"efth: .*'site'.*select one time and site"),
        ({"tail": "elfouhaily"}, "wind_speed: None, allowed: a wind speed"),
        ({"tail": "phillips"}, "tail: 'phillips', allowed: elfouhaily"),
        ({"mss": "cox-munk"}, "wind_speed"),
    ],
)
def test_refuses_selections_and_tails(options, message):
    source = record() if "time" in options else dataset()
    with pytest.raises(ValueError, match=message):
        from_wavespectra(source, **options)


def test_x_axis():
    north = from_wavespectra(dataset(coming_from=180.0), x_axis_deg=0.0).components
    power = north.amplitude**2
    assert np.sum(power * north.kx) > 0.5 * np.sum(power * np.hypot(north.kx, north.ky))


def test_split_and_drawn_bins_keep_their_variance():
    plain = from_wavespectra(dataset())
    fine = from_wavespectra(dataset(), waves="drawn")
    bins = fine.components.amplitude.reshape(30, 36, 2) ** 2 / 2.0
    # directions of the fine table run from 0 to 2 pi, those of the record clockwise from north
    order = np.argsort(np.mod(plain.theta, 2.0 * math.pi))
    expected = np.array(plain.variance)[:, order]
    np.testing.assert_allclose(bins.sum(axis=2), expected, rtol=1e-12, atol=1e-18)
    # linear in direction: the half of a bin next to the higher neighbour holds more
    peak = expected[10].argmax()
    assert bins[10, peak - 2, 1] > bins[10, peak - 2, 0]
    # drawn frequencies stay within bins that meet half-way
    omega = fine.components.omega.reshape(30, 72)
    centers = np.array(plain.omega)
    middle = 0.5 * (centers[1:] + centers[:-1])
    assert (omega[1:] >= middle[:, None]).all()
    assert (omega[:-1] <= middle[:, None]).all()
    assert len(np.unique(omega)) == omega.size
    assert fine.with_seed(3) == fine.model_copy(update={"seed": 3})
    np.testing.assert_array_equal(
        fine.with_seed(3).mesh(extent=1.0).vertices,
        fine.model_copy(update={"seed": 3}).mesh(extent=1.0).vertices,
    )


def test_tail_meets_the_record_and_then_the_spectrum():
    sea = from_wavespectra(dataset(coming_from=200.0), tail="elfouhaily", wind_speed=7.0)
    omega, variance = np.array(sea.omega), np.array(sea.variance)
    tail = omega > 2.0 * math.pi * 0.8 * 1.0001
    edges = np.sqrt(omega[tail][1:] * omega[tail][:-1])
    density = variance[tail].sum(axis=1)[1:-1] / np.diff(edges)
    far = omega[tail][1:-1] > 4.0 * math.pi * 0.8 * 1.05
    expected = Elfouhaily(wind_speed=7.0)(omega[tail][1:-1])
    np.testing.assert_allclose(density[far], expected[far], rtol=0.002)
    # at the last frequency of the record the tail starts from its density
    last = float(dataset().efth.isel(time=0, site=0, freq=-1).sum() * 10.0 / (2.0 * math.pi))
    assert density[0] == pytest.approx(last, rel=0.35)
    assert omega.max() < directional.TAIL_OMEGA_MAX
    # waves from 200 deg run towards 20 deg east of north
    theta = np.array(sea.theta)
    row = variance[-1]
    heading = math.atan2(row @ np.sin(theta), row @ np.cos(theta))
    assert math.degrees(heading) == pytest.approx(70.0, abs=1e-6)
    assert sea.unresolved_slopes(0.01).direction_deg == pytest.approx(70.0, abs=1e-6)
    resolved = sum(components_slope_variance(sea.components))
    missing = sum(sea.unresolved_slopes(1e-4).vertex)
    assert missing == pytest.approx(sum(sea.slope_variance) - resolved, rel=0.02)


def test_missing_slopes_are_said_once():
    with pytest.warns(mt.DomainWarning, match=r"ends at 0.8 Hz, beyond which \d+ % of the") as seen:
        sea = from_wavespectra(dataset(), wind_speed=7.0)
    assert len(seen) == 1
    share = float(str(seen[0].message).split("which ")[1].split(" %")[0])
    resolved = sum(components_slope_variance(sea.components))
    assert share == pytest.approx(100.0 * (1.0 - resolved / sum(cox_munk(7.0))), abs=0.5)
    with pytest.warns(mt.DomainWarning, match="without any shorter waves"):
        from_wavespectra(dataset())


# the reader of wavespectra leaves its file to the garbage collector
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_reader_of_a_swan_file(tmp_path):
    path = tmp_path / "record.spec"
    data = record()
    data.spec.to_swan(str(path))
    sea = from_wavespectra(path, reader="swan", time="2024-05-01T01", site=1)
    # the label 1, which is that of the first station
    expected = float(wavespectra.read_swan(str(path)).isel(time=1).sel(site=1).spec.hs(tail=False))
    assert components_hs(sea.components) == pytest.approx(expected, rel=1e-6)
    with pytest.raises(ValueError, match=r"reader: 'swam', .*did you mean swan"):
        from_wavespectra(path, reader="swam")
    with pytest.raises(ValueError, match=r"missing.spec: .*, allowed: a file that read_swan reads"):
        from_wavespectra(tmp_path / "missing.spec", reader="swan")


def test_reader_needs_wavespectra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "wavespectra", None)
    with pytest.raises(ValueError, match=r"reader: 'swan', .*pip install .meshtrace\[measured\]"):
        from_wavespectra("record.spec", reader="swan")
