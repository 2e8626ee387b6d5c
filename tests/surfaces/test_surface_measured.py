import math

import numpy as np
import pytest
import xarray as xr

from meshtrace.surfaces import MeasuredSea, from_wavespectra, sea_from_config
from meshtrace.surfaces.statistics import components_hs, components_slope_variance


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
        (lambda d: d * math.nan, "variance"),
    ],
)
def test_refuses(change, message):
    with pytest.raises(ValueError, match=message):
        from_wavespectra(change(dataset()))
