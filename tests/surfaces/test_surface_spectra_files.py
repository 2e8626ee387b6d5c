"""Directional spectra in files of other people: read right, or refused.

The numbers are those of one spectrum, written with other units, conventions, labels and formats.
"""

import gzip
import json
import math
import warnings
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr

from meshtrace import InputWarning
from meshtrace.errors import Refused
from meshtrace.surfaces import from_wavespectra, spectra_files, spectral_grid

FREQ, DIR = np.geomspace(0.05, 0.6, 25), np.arange(0.0, 360.0, 10.0)
HEIGHT = FREQ**-5 * np.exp(-1.25 * (0.15 / FREQ) ** 4) * 2e-5
EFTH = HEIGHT[:, None] * np.maximum(np.cos(np.radians(DIR - 240.0)), 0.0) ** 2 / 180.0
HS = 4.0 * math.sqrt((EFTH.sum(axis=1) * 10.0 * np.gradient(FREQ)).sum())
MEAN_DIR = 240.0  # [deg] that the waves come from
TIMES = pd.date_range("2024-05-01", periods=4, freq="h")
AXES = ("freq", "dir")


def numbers(spectrum):
    """Return Hs [m], and the mean direction waves come from [deg], by sums of this file."""
    frequency, direction, density = spectrum
    variance = density * np.gradient(frequency)[:, None] * 360.0 / density.shape[1]
    moment = (variance @ np.exp(1j * np.radians(direction))).sum()
    return 4.0 * math.sqrt(variance.sum()), math.degrees(np.angle(moment)) % 360.0


def check(source, hs=HS, direction=MEAN_DIR, reader=None, rel=1e-6, degrees=1e-3, **selection):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        found = numbers(
            spectra_files.read_spectrum(
                source, reader, selection.get("time"), selection.get("site")
            )[0]
        )
    assert found[0] == pytest.approx(hs, rel=rel)
    assert abs((found[1] - direction + 180.0) % 360.0 - 180.0) < degrees


def refuse(source, match, reader=None, time=None, site=None):
    with warnings.catch_warnings(action="ignore", category=InputWarning):
        with pytest.raises(Refused, match=match):
            spectra_files.read_spectrum(source, reader, time, site)


def dataset(density=EFTH, frequency=FREQ, direction=DIR, **attributes):
    data = xr.Dataset({"efth": (AXES, density)}, {"freq": frequency, "dir": direction})
    for name, attrs in attributes.items():
        data["dir" if name == "dir_" else name].attrs = attrs
    return data


def stations(**coords):
    """Return four times of two stations, whose variances are 1 to 8 times that of the spectrum."""
    factors = xr.DataArray(np.arange(1.0, 9.0).reshape(4, 2), {"time": TIMES}, ("time", "site"))
    data = (dataset().efth * factors).to_dataset(name="efth")
    return data.assign_coords({"site": [1, 2], **coords})


@pytest.mark.parametrize("unit", ["m2 s rad-1", "m^2/Hz/rad", "m2.s.rad-1", "m**2 s radian**-1",
                                  "m2/(Hz rad)", "m² s rad⁻¹", "m^{2}.s.rad^{-1}", "m2 Hz-1 radian-1"])  # fmt: skip
def test_densities_per_radian(unit):
    check(dataset(np.degrees(1.0) * EFTH, efth={"units": unit}))


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("m2 s degree-1", 1.0), ("m^{2}.s.degree^{-1}", 1.0), ("m2/Hz/deg", 1.0), ("m2 Hz-1 degrees-1", 1.0),
     ("cm2 s degree-1", 1e4), ("cm^2/Hz/deg", 1e4), ("mm2 s deg-1", 1e6), ("m2 mHz-1 deg-1", 1e-3),
     ("cm2 s rad-1", 1e4 * 180.0 / math.pi), ("ft2/Hz/deg", 0.3048**-2)],
)  # fmt: skip
def test_densities_per_degree(unit, factor):
    check(dataset(factor * EFTH, efth={"units": unit}))


def test_a_conversion_is_said_in_one_line():
    with pytest.warns(InputWarning, match=r"^efth: cm2 s degree-1 converted to m2 Hz-1 deg-1$"):
        spectra_files.read_spectrum(
            dataset(1e4 * EFTH, efth={"units": "cm2 s degree-1"}), None, None, None
        )


@pytest.mark.parametrize(
    "unit", ["m2 s", "m2/Hz", "m2", "J m-2 s deg-1", "m s deg-1", "furlong", "1", "dB"]
)
def test_units_of_other_kinds_are_refused(unit):
    refuse(
        dataset(efth={"units": unit}),
        r"^efth: in .*, allowed: (a unit of a density|units that name)",
    )


@pytest.mark.parametrize(
    ("unit", "density", "factor"),
    [("rad/s", "m2 s rad-2", 2 * math.pi * math.pi / 180.0), ("rad s-1", "m2 s rad-1 deg-1", 2 * math.pi),
     ("rad/s", "m2/(rad/s)/rad", 2 * math.pi * math.pi / 180.0), ("rad/s", "m2 Hz-1 deg-1", 1.0)],
)  # fmt: skip
def test_angular_frequencies_with_their_jacobian(unit, density, factor):
    angular = dataset(
        EFTH / factor, 2.0 * math.pi * FREQ, freq={"units": unit}, efth={"units": density}
    )
    check(angular)


@pytest.mark.parametrize("density", [None, "m2 s rad-1", "m2 s deg-1"])
def test_densities_over_angular_frequencies_have_to_say_which(density):
    data = dataset(freq={"units": "rad/s"}, efth={"units": density} if density else {})
    refuse(data, "efth: .* over rad/s, allowed: units with Hz-1 or s rad-1")


@pytest.mark.parametrize(
    ("unit", "factor"), [("s-1", 1.0), ("1/s", 1.0), ("mHz", 1e3), ("kHz", 1e-3), ("", 1.0)]
)
def test_frequencies(unit, factor):
    check(dataset(frequency=factor * FREQ, freq={"units": unit}))


@pytest.mark.parametrize("unit", ["s", "m", "deg"])
def test_periods_are_no_frequencies(unit):
    refuse(dataset(freq={"units": unit}), r"freq: in |efth: ")


@pytest.mark.parametrize(
    ("attributes", "direction"),
    [({"standard_name": "sea_surface_wave_from_direction"}, 240.0),
     ({"standard_name": "sea_surface_wave_to_direction"}, 60.0),
     ({"long_name": "sea surface wave to direction"}, 60.0),
     ({"long_name": "direction waves are going to"}, 60.0),
     ({"long_name": "direction towards which waves travel, clockwise from north"}, 60.0),
     ({"long_name": "direction of propagation"}, 60.0),
     ({"long_name": "coming from, clockwise from true north"}, 240.0),
     ({"long_name": "direction from which waves are travelling"}, 240.0),
     ({"comment": "nautical: clockwise relative to north"}, 240.0),
     ({"convention": "oceanographic"}, 60.0),
     ({"convention": "cartesian"}, 30.0),  # travel at 240 deg from east is to the bearing 210
     ({"long_name": "wave direction (mathematical)"}, 30.0),
     ({"long_name": "direction waves come from, counter-clockwise from east"}, 210.0),
     ({"units": "degrees_true"}, 240.0), ({"units": "degree_T"}, 240.0), ({"units": "°"}, 240.0)],
)  # fmt: skip
def test_conventions_of_directions(attributes, direction):
    check(dataset(dir_=attributes), direction=direction)


def test_the_convention_of_a_dataset():
    check(dataset().assign_attrs(Directional_convention="cartesian"), direction=30.0)
    check(dataset().assign_attrs(directional_convention="nautical"))


@pytest.mark.parametrize(
    ("attributes", "match"),
    [({"standard_name": "sea_surface_wave_from_direction", "long_name": "direction of propagation"}, "attributes that agree"),
     ({"long_name": "direction relative to magnetic north"}, "magnetic north"),
     ({"units": "degrees magnetic"}, "dir: in degrees magnetic"), ({"units": "m"}, "dir: in m")],
)  # fmt: skip
def test_directions_that_are_not_understood(attributes, match):
    refuse(dataset(dir_=attributes), match)


def test_directions_in_radians():
    radians = dataset(np.degrees(1.0) * EFTH, direction=np.radians(DIR), dir_={"units": "radian"})
    refuse(radians, "efth: without units over radians")
    radians.efth.attrs["units"] = "m2 s rad-1"
    check(radians)
    refuse(dataset(direction=np.radians(DIR)), "dir: steps of .*radians need units = radian")


def test_grids_of_few_digits_and_doubles():
    three = [float(f"{angle:.2e}") for angle in np.radians(DIR)]
    check(dataset(direction=np.degrees(three)), degrees=0.1)
    fine = np.arange(0.0, 360.0, 7.5)
    check(dataset(np.repeat(HEIGHT[:, None] / 360.0, 48, 1), direction=np.round(fine)),
          4.0 * math.sqrt((HEIGHT * np.gradient(FREQ)).sum()), 0.0, degrees=361.0)  # fmt: skip
    closed = xr.concat([dataset(), dataset().isel(dir=[0]).assign_coords(dir=[360.0])], "dir")
    check(closed)
    check(dataset(direction=DIR - 180.0), direction=60.0)
    refuse(
        closed.assign(
            efth=closed.efth * xr.where(closed.dir == 360.0, 2.0, 1.0)
            + 1e-6 * (closed.dir == 360.0)
        ),
        "0 deg twice",
    )
    refuse(dataset().isel(dir=slice(0, 30)), "dir: steps of 10 to 70 deg")
    refuse(dataset(direction=np.where(DIR == 0.0, np.nan, DIR)), "dir: not finite")
    refuse(dataset(direction=DIR + 2.0 * np.sin(DIR)), "dir: steps of")
    refuse(dataset().drop_vars("dir"), "dir: missing")


def test_missing_and_packed_values():
    packed = dataset(EFTH / 1e-4, efth={"scale_factor": 1e-4, "units": "m2 s degree-1"})
    check(packed)
    check(dataset((EFTH + 1.0) / 1e-5, efth={"scale_factor": 1e-5, "add_offset": -1.0}), rel=1e-6)
    gaps = np.where(EFTH < 1e-6, -999.0, EFTH)
    refuse(dataset(gaps, efth={"_FillValue": -999.0}), r"efth: \d+ of \d+ values missing")
    refuse(dataset(gaps, efth={"missing_value": -999.0}), "values missing")
    refuse(dataset(gaps), "efth: negative")
    refuse(dataset(np.where(EFTH < 1e-6, 9.96921e36, EFTH)), "values missing")
    refuse(dataset(np.where(EFTH < 1e-6, 999.0, EFTH), efth={"valid_max": 100.0}), "values missing")
    refuse(dataset(np.full_like(EFTH, np.nan)), "900 of 900 values missing")
    refuse(dataset(0.0 * EFTH), "efth: zero everywhere, allowed: a record with waves")
    edge = np.where((FREQ > 0.3)[:, None], np.nan, EFTH)
    kept = FREQ <= 0.3
    check(dataset(edge), numbers_of(EFTH[kept], FREQ[kept]))


def numbers_of(density, freq):
    return 4.0 * math.sqrt((density.sum(axis=1) * 10.0 * np.gradient(freq)).sum())


def test_frequencies_that_are_not_understood():
    refuse(dataset(frequency=np.r_[-0.1, FREQ[1:]]), "freq: not positive")
    refuse(dataset(frequency=np.r_[FREQ[1], FREQ[1:]]), "freq: a frequency twice")
    refuse(dataset().isel(freq=[3]), "freq|efth")
    mean = xr.concat(
        [dataset(np.zeros_like(EFTH)).isel(freq=[0]).assign_coords(freq=[0.0]), dataset()], "freq"
    )
    check(mean)  # without energy at 0 Hz, as TRIAXYS buoys write it


@pytest.mark.parametrize(
    ("time", "factor"),
    [("2024-05-01T01", 3.0), ("2024-05-01T01:20", 3.0), ("2024-05-01 01:00Z", 3.0), ("2024-05-01T03:00+02:00", 3.0),
     (np.datetime64("2024-05-01T02"), 5.0), (pd.Timestamp("2024-05-01T02", tz="UTC"), 5.0), ("20240501T03", 7.0)],
)  # fmt: skip
def test_times(time, factor):
    check(stations(), math.sqrt(factor) * HS, time=time, site=1)
    check(stations().isel(time=[2, 0, 3, 1]), math.sqrt(factor) * HS, time=time, site=1)


@pytest.mark.parametrize(
    "time", [np.datetime64("NaT"), "nat", "NaT", "", pd.NaT, "now", "today", 5, 5.0, True, "01/05/2024", "9999-01-01", "2024-05-02", "soon", [1], b"2024"]
)  # fmt: skip
def test_times_that_are_none(time):
    refuse(stations(), "^time: ", time=time, site=1)


def test_records_of_a_time():
    refuse(stations().isel(time=[0, 0, 1]), "2024-05-01T00:00 twice", time="2024-05-01", site=1)
    hours = [*pd.date_range("2024-05-01", periods=3, freq="h"), pd.Timestamp("2024-05-20")]
    refuse(stations().assign_coords(time=hours), "within half a step", time="2024-05-10", site=1)
    no_dates = stations().assign_coords(time=np.full(4, np.datetime64("NaT", "ns")))
    refuse(no_dates, "no dates in the record", time="2024-05-01", site=1)
    refuse(dataset(), "a record with times", time="2024-05-01")
    refuse(stations().assign_coords(time=range(4)), "time: no units", time="2024-05-01", site=1)


@pytest.mark.parametrize(
    ("calendar", "read"),
    [("standard", True), ("noleap", False), ("360_day", False), ("martian", False)],
)
def test_calendars(calendar, read, tmp_path):
    path = tmp_path / "record.nc"
    attributes = {"units": "hours since 2024-02-28", "calendar": calendar}
    stations().assign_coords(time=("time", np.arange(4.0), attributes)).to_netcdf(
        path, engine="h5netcdf"
    )
    if read:
        check(path, math.sqrt(3.0) * HS, time="2024-02-28T01", site=1)
    else:
        refuse(path, f"time: calendar {calendar}", time="2024-02-28T01", site=1)


def test_dates_of_cftime():
    cftime = pytest.importorskip("cftime")
    for kind, read in ((cftime.DatetimeGregorian, True), (cftime.DatetimeNoLeap, False)):
        data = stations().assign_coords(time=[kind(2024, 5, 1, hour) for hour in range(4)])
        check(data.isel(time=1), math.sqrt(3.0) * HS, site=1)
        if read:
            check(data, math.sqrt(3.0) * HS, time="2024-05-01T01", site=1)
        else:
            refuse(data, "calendar noleap", time="2024-05-01T01", site=1)


@pytest.mark.parametrize(("site", "factor"), [(1, 1.0), (2, 2.0), ("2", 2.0), (np.int64(2), 2.0)])
def test_stations_by_label(site, factor):
    check(stations(), math.sqrt(factor) * HS, time="2024-05-01", site=site)
    check(stations(site=[2, 1]), math.sqrt(3.0 - factor) * HS, time="2024-05-01", site=site)


@pytest.mark.parametrize(
    "site", [0, 3, True, 2.5, "x", None, [1], {}, (1, 2), ("a", "b"), -1, 10**30, math.nan, b"1x"]
)
def test_stations_that_are_none(site):
    refuse(stations(), "^(site|efth): ", time="2024-05-01", site=site)


def test_labels_of_stations():
    check(stations(site=["44097", "A1"]), math.sqrt(2.0) * HS, time="2024-05-01", site="A1")
    check(stations(site=["44097", "A1"]), HS, time="2024-05-01", site=44097)
    check(stations(site=[b"44097  ", b"A1\0"]), math.sqrt(2.0) * HS, time="2024-05-01", site="A1")
    refuse(stations(site=[1, 1]), "2 stations of this label", time="2024-05-01", site=1)
    check(stations().rename(site="station"), math.sqrt(2.0) * HS, time="2024-05-01", site=2)
    # numbers count from 0 where there are no labels
    check(stations().drop_vars("site"), math.sqrt(2.0) * HS, time="2024-05-01", site=1)
    refuse(stations().drop_vars("site"), "0 to 1, of 2 stations", time="2024-05-01", site=2)
    refuse(dataset(), "a label of a record with stations", site=0)


@pytest.mark.parametrize("label", [0, 7, "44097"])
def test_a_station_without_a_dimension(label):
    """As AWAC, Obscape and stations of WW3 have it: once a traceback."""
    check(dataset().assign_coords(site=label), site=0)
    check(dataset().assign_coords(site=label), site=label)
    check(dataset().assign_coords(site=("site", [label])), site=0)
    refuse(dataset().assign_coords(site=label), "site: 5", site=5)


def test_places():
    there = stations(lon=("site", [-5.0, 3.0]), lat=("site", [48.0, 54.0]))
    check(there, math.sqrt(2.0) * HS, time="2024-05-01", site=(363.2, 54.1))
    refuse(there, "within 1 deg", time="2024-05-01", site=(0.0, 0.0))
    refuse(
        there.assign_coords(lon=("site", [3.0, 3.0]), lat=("site", [54.0, 54.0])),
        "one station there",
        time="2024-05-01",
        site=(3.0, 54.0),
    )
    refuse(
        there.assign_coords(lon=("site", [np.nan] * 2)),
        "within 1 deg",
        time="2024-05-01",
        site=(3.0, 54.0),
    )
    metres = there.assign_coords(lon=("site", [3.0, 4.0], {"units": "m"}))
    refuse(metres, "lon: in m", time="2024-05-01", site=(3.0, 54.0))
    # 1.5 deg of longitude are .52 deg of a great circle at 70 deg north
    north = there.assign_coords(lon=("site", [0.0, 90.0]), lat=("site", [70.0, 70.0]))
    check(north, HS, time="2024-05-01", site=(1.5, 70.0))


def test_a_moving_buoy_is_where_it_was_at_the_time():
    moving = stations().isel(site=0, drop=True)
    moving = moving.assign_coords(lon=("time", [0.0, 1.0, 5.0, 9.0]), lat=("time", [10.0] * 4))
    check(moving, math.sqrt(5.0) * HS, time="2024-05-01T02", site=(5.0, 10.0))
    refuse(moving, "within 1 deg", time="2024-05-01T02", site=(0.0, 10.0))


def test_spectra_without_directions():
    match = 'efth: no directions, allowed: directions, or spectrum = "tabulated" with a spreading'
    refuse(dataset().sum("dir"), match)
    refuse(stations().sum("dir"), match, time="2024-05-01", site=1)
    refuse(dataset().isel(dir=[0]), match)
    refuse(stations(), "select one time and site first")


# Files of the forms of wavespectra


def ndbc(n=2):
    """Return spectra in the form of NDBC's netCDF files, and their Fourier coefficients."""
    r1, r2 = np.linspace(0.95, 0.3, len(FREQ)), np.linspace(0.85, 0.1, len(FREQ))
    alpha = 200.0 + 80.0 * np.arange(len(FREQ)) / len(FREQ)
    rows = np.arange(1.0, n + 1.0)[:, None]
    names = {"spectral_wave_density": rows * HEIGHT, "mean_wave_dir": alpha + 0.0 * rows,
             "principal_wave_dir": alpha + 5.0 * rows, "wave_spectrum_r1": r1 + 0.0 * rows,
             "wave_spectrum_r2": r2 + 0.0 * rows}  # fmt: skip
    data = {name: (("time", "frequency"), values) for name, values in names.items()}
    coords = {"time": TIMES[:n], "frequency": FREQ}
    hs = 4.0 * math.sqrt((HEIGHT * np.gradient(FREQ)).sum())
    moment = (HEIGHT * np.gradient(FREQ) * r1 * np.exp(1j * np.radians(alpha))).sum()
    return xr.Dataset(data, coords), hs, math.degrees(np.angle(moment)) % 360.0


def test_fourier_coefficients_of_a_buoy(tmp_path):
    """Their series is negative in places: once 238 of 238 spectra of a buoy were refused."""
    data, hs, direction = ndbc()
    theta = np.radians(DIR)[:, None]
    series = 0.5 + 0.95 * np.cos(theta - 1.0) + 0.85 * np.cos(2.0 * (theta - 1.0))
    assert (series < 0.0).any()
    path = tmp_path / "41010w2024.nc"
    data.to_netcdf(path, engine="h5netcdf")
    check(path, hs, direction, "ndbc", degrees=0.1, time="2024-05-01T00")
    check(path, math.sqrt(2.0) * hs, direction, "ndbc", degrees=0.1, time="2024-05-01T01")
    with pytest.warns(InputWarning, match="maximum entropy form"):
        sea = from_wavespectra(
            path, reader="ndbc", time="2024-05-01", tail="elfouhaily", wind_speed=5.0
        )
    assert sea.record.startswith("time 2024-05-01T00:00")
    going = data.copy()
    going["mean_wave_dir"] = going.mean_wave_dir.assign_attrs(
        standard_name="sea_surface_wave_to_direction"
    )
    check(going, hs, direction + 180.0, "ndbc", degrees=0.1, time="2024-05-01")
    calm = data.where(data.frequency > 0.08).fillna({"spectral_wave_density": 0.0})
    check(
        calm,
        numbers_1d(np.where(FREQ > 0.08, HEIGHT, 0.0)),
        direction,
        "ndbc",
        degrees=5.0,
        time="2024-05-01",
    )
    gap = data.copy()
    gap["wave_spectrum_r1"] = gap.wave_spectrum_r1.where(gap.frequency > 0.2)
    refuse(gap, r"efth: no directions at \d+ of 25 frequencies with waves", "ndbc", "2024-05-01")
    refuse(data.drop_vars("wave_spectrum_r2"), "efth: no directions", "ndbc", "2024-05-01")
    cm = data.assign(
        spectral_wave_density=(1e4 * data.spectral_wave_density).assign_attrs(units="cm2/Hz")
    )
    check(cm, hs, direction, "ndbc", degrees=0.1, time="2024-05-01")


@pytest.mark.parametrize(("name", "values"), [("r1", 1.5), ("r2", 90.0), ("r1", -0.2)])
def test_coefficients_above_one(name, values):
    """Of other units, or of files in another order."""
    data = ndbc()[0]
    variable = f"wave_spectrum_{name}"
    data[variable] = xr.full_like(data[variable], values)
    refuse(data, rf"{name}: .*, allowed: 0 <= {name} <= 1", "ndbc", "2024-05-01")


def test_storms_are_not_missing(tmp_path):
    """Densities of waves of 10 m exceed 99 m2/Hz."""
    paths, hs, direction = ndbc_text(tmp_path, True)
    text = gzip.decompress(Path(paths[0]).read_bytes()).decode().splitlines()
    rows = [line.split() for line in text[1:]]
    high = [" ".join(row[:5] + [f"{2e4 * float(v):.3f}" for v in row[5:]]) for row in rows]
    assert max(float(v) for v in high[0].split()[5:]) > 99.0
    Path(paths[0]).write_bytes(gzip.compress("\n".join([text[0], *high, ""]).encode()))
    check(
        paths,
        math.sqrt(2e4) * hs,
        direction,
        "ndbc_ascii",
        rel=5e-3,
        degrees=1.0,
        time="2024-05-01",
    )


def numbers_1d(density):
    return 4.0 * math.sqrt((density * np.gradient(FREQ)).sum())


@pytest.mark.parametrize(
    ("r1", "r2", "turn"), [(0.2, 0.1, 0.0), (0.6, 0.3, 0.4), (0.9, 0.7, 0.05), (0.0, 0.5, 0.0)]
)
def test_maximum_entropy_keeps_the_coefficients(r1, r2, turn):
    c1, c2 = np.array([r1 * np.exp(1j)]), np.array([r2 * np.exp(2j * (1.0 + turn))])
    theta = np.radians(np.arange(0.0, 360.0, 2.0))
    shares = spectral_grid.maximum_entropy(c1, c2, theta)[0]
    assert (shares > 0.0).all()
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)
    # means over bins of 2 deg lower the second coefficient by 2e-4
    assert shares @ np.exp(1j * theta) == pytest.approx(c1[0], abs=3e-4)
    assert shares @ np.exp(2j * theta) == pytest.approx(c2[0], abs=3e-4)


def test_coefficients_that_no_density_has_keep_their_direction():
    shares = spectral_grid.maximum_entropy(
        np.array([0.9 + 0j, 1.2j]), np.array([-0.9 + 0j, 0.5j]), np.radians(DIR)
    )
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-12)
    moments = shares @ np.exp(1j * np.radians(DIR))
    np.testing.assert_allclose(np.degrees(np.angle(moments)), [0.0, 90.0], atol=3.0)


def ndbc_text(folder, past, missing=False):
    """Write the five files of a buoy, as NDBC keeps them for past years or for some weeks."""
    data, hs, direction = ndbc()
    names = [
        "spectral_wave_density",
        "mean_wave_dir",
        "principal_wave_dir",
        "wave_spectrum_r1",
        "wave_spectrum_r2",
    ]
    paths = []
    for name in names:
        values = data[name].values
        digits = 5 if name == names[0] else 2 if name.endswith(("r1", "r2")) else 0
        if past and digits == 2:
            values, digits = 100.0 * values, 0
        lines = []
        for time, row in zip(data.time.to_index(), values, strict=True):
            cells = [f"{value:.{digits}f}" for value in row]
            cells[0] = ("0.00" if name == names[0] else "999.0") if missing else cells[0]
            if not past:
                cells = [f"{cell} ({f:.3f})" for cell, f in zip(cells, FREQ, strict=True)]
                cells = ["9.999", *cells] if name == names[0] else cells
            lines.append(f"{time:%Y %m %d %H %M}  {' '.join(cells)}")
        heading = "#YY  MM DD hh mm "
        heading += (
            " ".join(f"{f:.4f}".lstrip("0") for f in FREQ)
            if past
            else "x_1 (freq_1) x_2 (freq_2) ... >"
        )
        if not past and name == names[0]:
            heading = heading.replace("mm ", "mm Sep_Freq < ")
        path = folder / f"{name}.{'txt.gz' if past else 'data'}"
        text = "\n".join([heading, *(lines if past else lines[::-1])]) + "\n"
        path.write_bytes(gzip.compress(text.encode()) if past else text.encode())
        paths.append(str(path))
    return paths, hs, direction


@pytest.mark.parametrize("past", [True, False])
@pytest.mark.parametrize("missing", [True, False])
def test_text_files_of_a_buoy(past, missing, tmp_path):
    """Files of past years have r1 and r2 in hundredths; 999 is missing, where there are no waves."""
    paths, hs, direction = ndbc_text(tmp_path, past, missing)
    check(paths, hs, direction, "ndbc_ascii", rel=5e-3, degrees=1.0, time="2024-05-01")
    check(
        paths,
        math.sqrt(2.0) * hs,
        direction,
        "ndbc_ascii",
        rel=5e-3,
        degrees=1.0,
        time="2024-05-01T01",
    )
    refuse(paths[0], "efth: no directions", "ndbc_ascii", "2024-05-01")
    refuse(paths[:3], "3 files", "ndbc_ascii", "2024-05-01")


def station_of_ww3(directions, stations=1):
    """Return text in the form of WW3, whose directions and frequencies have three digits."""
    angles = np.mod(0.5 * math.pi - np.radians(directions), 2.0 * math.pi)  # of travel, from east
    going = np.mod(np.radians(directions + 180.0), 2.0 * math.pi)
    del angles
    lines = [
        f"'WAVEWATCH III SPECTRA'     {len(FREQ)}    {len(DIR)}     {stations} 'spectral resolution'"
    ]
    lines += [" ".join(f"{f:.2E}" for f in FREQ), " ".join(f"{a:.2E}" for a in going)]
    lines.append("20220912 060000")
    for i in range(stations):
        lines.append(f"'4409{i}     '  {40.98 + i} -71.12      46.6   1.45 225.6   0.18  94.1")
        lines.append(" ".join(f"{e:.5E}" for e in np.degrees(EFTH.T).ravel()))
    return "\n".join(lines) + "\n"


def test_directions_of_three_digits(tmp_path):
    path = tmp_path / "ww3.spec"
    path.write_text(station_of_ww3(DIR))
    check(path, reader="ww3_station", rel=5e-3, degrees=0.3, time="2022-09-12T06:00")
    check(path, reader="ww3_station", rel=5e-3, degrees=0.3, site=0)
    check(path, reader="ww3_station", rel=5e-3, degrees=0.3, site="44090")
    path.write_text(station_of_ww3(DIR, 2))
    refuse(path, "source|a file that read_ww3_station reads", "ww3_station", site=0)


def test_a_closed_circle_of_a_triaxys_buoy(tmp_path):
    path = tmp_path / "a.DIRSPEC"
    freq = np.arange(0.0, 0.65, 0.01)
    row = 1e-3 * np.exp(-(((freq - 0.2) / 0.05) ** 2)) * (freq > 0.05)
    spread = 1.0 + np.cos(np.radians(np.arange(0.0, 361.0, 3.0) - 90.0))
    head = ["TRIAXYS BUOY DATA REPORT - TAS", "TYPE\t= DIRECTIONAL SPECTRUM", "DATE    = 2018-01-31 21:00(UTC)",
            f"NUMBER OF FREQUENCIES = {len(freq)}", "INITIAL FREQUENCY (Hz) = 0.000", "FREQUENCY SPACING (Hz) = 0.010",
            "RESOLVABLE FREQUENCY RANGE (Hz) = 0.060 TO 0.390", "NUMBER OF DIRECTIONS = 121",
            "DIRECTION SPACING (DEG) = 3", "COLUMNS = 0.00 TO 360.00 DEG", "ROWS\t= 0.00 TO 0.64 Hz"]  # fmt: skip
    lines = [" ".join(f"{v:.8E}" for v in r * spread) for r in row]
    path.write_text("\n".join([*head, *lines]) + "\n")
    hs = 4.0 * math.sqrt(row.sum() * 0.01 * 360.0)
    check(path, hs, 90.0, "triaxys", time="2018-01-31T21:00")


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("m2 s rad-1", 1.0), ("m2 s degree-1", math.pi / 180.0), ("cm2 s rad-1", 1e4)],
)
@pytest.mark.parametrize(("name", "turn"), [("to", 180.0), ("from", 0.0)])
def test_ww3_with_units_of_its_own(unit, factor, name, turn):
    """Wavespectra takes m2 s rad-1 and directions of travel for granted."""
    data = stations().rename(freq="frequency", dir="direction", site="station")
    data["efth"] = (np.degrees(1.0) * factor * data.efth).assign_attrs(units=unit)
    data = data.assign_coords(direction=(data.direction + turn) % 360.0)
    data.direction.attrs["standard_name"] = f"sea_surface_wave_{name}_direction"
    check(data, math.sqrt(4.0) * HS, reader="ww3", time="2024-05-01T01", site=2)


@pytest.mark.parametrize(("convention", "direction"), [("nautical", 240.0), ("cartesian", 30.0)])
def test_swan_in_its_conventions(convention, direction, tmp_path):
    data = stations().rename(freq="frequency", dir="direction", site="points", efth="density")
    data["density"] = (np.degrees(1.0) * data.density).assign_attrs(units="m2 s rad-1")
    data = data.assign_coords(direction=("direction", np.radians(DIR), {"units": "radians"}))
    data = data.drop_vars("points").assign_attrs(Directional_convention=convention)
    path = tmp_path / "swan.nc"
    data.to_netcdf(path, engine="h5netcdf")
    check(
        path, math.sqrt(3.0) * HS, direction, "ncswan", time="2024-05-01T01", site=1
    )  # labels 1, 2


def test_era5_has_no_waves_on_land():
    shape = (1, 25, 36, 2, 1)
    values = np.log10(np.degrees(1.0) * np.maximum(EFTH, 1e-12))[None, :, :, None, None] * np.ones(
        shape
    )
    values[..., 1, :] = np.nan
    dims = ("time", "frequency", "direction", "latitude", "longitude")
    coords = {"time": TIMES[:1], "latitude": [50.0, 40.0], "longitude": [0.0]}
    coords |= {"frequency": range(1, 26), "direction": range(1, 37)}
    data = xr.Dataset({"d2fd": (dims, values, {"units": "m**2 s radian**-1"})}, coords)
    (*_, density), _ = spectra_files.read_spectrum(data, "era5", "2024-05-01", (0.0, 50.0))
    assert density.sum() == pytest.approx(EFTH.sum(), rel=1e-6)
    refuse(data, "900 of 900 values missing", "era5", "2024-05-01", (0.0, 40.0))
    refuse(
        data.assign(d2fd=data.d2fd.assign_attrs(units="m2 s degree-1")),
        "logarithms",
        "era5",
        "2024-05-01",
    )


@pytest.mark.parametrize("reader", ["netcdf", "wavespectra", "json"])
def test_readers_that_replace_units(reader, tmp_path):
    data = dataset(np.degrees(1.0) * EFTH, efth={"units": "m2 s rad-1"})
    path = tmp_path / "spectrum"
    if reader == "json":
        path.write_text(json.dumps(data.to_dict()))
    else:
        data.to_netcdf(path, engine="h5netcdf")
    check(path, reader=reader)


def test_zarr(tmp_path):
    pytest.importorskip("zarr")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        dataset(np.degrees(1.0) * EFTH, efth={"units": "m2 s rad-1"}).to_zarr(tmp_path / "a.zarr")
        data = xr.open_zarr(tmp_path / "a.zarr", chunks=None)
    check(data)
    refuse(
        tmp_path / "a.zarr", r"a folder, allowed: a file; a Zarr store as xarray.open_zarr\(path\)"
    )


def test_a_record_is_bounded():
    dask = pytest.importorskip("dask.array")
    huge = xr.Dataset(
        {"efth": (AXES, dask.zeros((30_000, 10_000)))},
        {"freq": np.arange(1.0, 30_001.0), "dir": np.arange(10_000.0)},
    )
    refuse(huge, "efth: arrays of 2.4 GB, allowed: at most")


def test_text_is_bounded(tmp_path, monkeypatch):
    """Compressed files count by their content."""
    monkeypatch.setattr("meshtrace.surfaces.spectra_files._MOST_TEXT", 2**24)
    path = tmp_path / "41010.txt.gz"
    path.write_bytes(gzip.compress(bytes(2**25)))
    assert path.stat().st_size < 2**16
    refuse(path, r"41010.txt.gz: arrays of 1[67].* MB, allowed: at most 16.8 MB", "ndbc_ascii")


def test_links_to_other_files_are_refused(tmp_path):
    dataset().to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with h5py.File(tmp_path / "b.nc", "w") as file:
        file["efth"] = h5py.ExternalLink("a.nc", "efth")
    refuse(tmp_path / "b.nc", "array efth in a.nc")
