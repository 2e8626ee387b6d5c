"""Profiles of temperature and salinity: their files, and the rays that layers bend."""

import math

import numpy as np
import pytest
import xarray as xr

from meshtrace.optics.pure_water import quan_fry
from paper.water import (
    WaterProfile,
    depth_of_pressure,
    load_profiles,
    ray_deflection,
)

PRESSURE = np.array([2.0, 10.0, 20.0, 30.0, 50.0])
WARM = np.array([26.0, 25.9, 25.5, 24.0, 22.0])
SALT = np.array([35.1, 35.1, 35.2, 35.3, 35.4])


def write_argo(path, mode="R"):
    """Write two profiles as Argo files hold them: the second deeper, with a bad sample."""
    levels = ("N_PROF", "N_LEVELS")
    flags = np.full((2, 5), b"1", dtype="S1")
    flags[1, 2] = b"4"
    fields = {"PRES": PRESSURE, "TEMP": WARM, "PSAL": SALT}
    variables = {k: (levels, np.stack([v, v + 1.0]).astype("f4")) for k, v in fields.items()}
    adjusted = {f"{k}_ADJUSTED": (d, v + 0.5) for k, (d, v) in variables.items()}
    flagged = {f"{k}_QC": (levels, flags) for k in (*variables, *adjusted)}
    places = {
        "LATITUDE": ("N_PROF", [-21.17, -22.11]),
        "LONGITUDE": ("N_PROF", [165.91, 167.33]),
        "DATA_MODE": ("N_PROF", np.array([mode, "R"], dtype="S1")),
    }
    data = xr.Dataset({**variables, **adjusted, **flagged, **places})
    data.to_netcdf(path, engine="h5netcdf")


def write_imos(path):
    """Write one profile as the AODN's files of moorings and casts hold it."""
    good = {"flag_values": np.array([1, 2, 4], "i1")}
    flags = np.array([1, 2, 1, 1, 4], "i1")
    dims = ("TIME", "DEPTH")
    xr.Dataset(
        {
            "TEMP": (dims, WARM[None], {"standard_name": "sea_water_temperature"}),
            "TEMP_quality_control": (dims, flags[None], good),
            "PSAL": (dims, SALT[None], {"standard_name": "sea_water_practical_salinity"}),
            "LATITUDE": ("TIME", [-20.51]),
            "LONGITUDE": ("TIME", [165.45]),
        },
        {"DEPTH": ("DEPTH", PRESSURE, {"units": "m", "positive": "down"}), "TIME": [0.0]},
    ).to_netcdf(path, engine="h5netcdf")


def test_argo_file_gives_its_good_samples_over_depth(tmp_path):
    write_argo(tmp_path / "argo.nc")
    first, second = load_profiles(tmp_path / "argo.nc")
    assert (first.latitude, second.longitude) == (-21.17, 167.33)
    np.testing.assert_allclose(first.temperature, WARM, rtol=1e-6)
    np.testing.assert_allclose(first.depth, depth_of_pressure(PRESSURE, -21.17), rtol=1e-6)
    np.testing.assert_allclose(second.salinity, np.delete(SALT + 1.0, 2), rtol=1e-6)


def test_argo_file_of_delayed_mode_gives_its_adjusted_values(tmp_path):
    write_argo(tmp_path / "argo.nc", mode="D")
    first, second = load_profiles(tmp_path / "argo.nc")
    np.testing.assert_allclose(first.temperature, WARM + 0.5, rtol=1e-6)
    np.testing.assert_allclose(second.temperature, np.delete(WARM + 1.0, 2), rtol=1e-6)


def test_aodn_file_gives_depths_as_they_are_without_flagged_samples(tmp_path):
    write_imos(tmp_path / "imos.nc")
    (profile,) = load_profiles(tmp_path / "imos.nc")
    np.testing.assert_array_equal(profile.depth, PRESSURE[:4])
    np.testing.assert_allclose(profile.salinity, SALT[:4])
    assert profile.latitude == -20.51


def test_file_without_salinity_is_refused(tmp_path):
    xr.Dataset({"TEMP": ("DEPTH", WARM)}, {"DEPTH": PRESSURE}).to_netcdf(
        tmp_path / "a.nc", engine="h5netcdf"
    )
    with pytest.raises(ValueError, match=r"no salinity, allowed: PSAL"):
        load_profiles(tmp_path / "a.nc")


def test_file_without_good_samples_is_refused(tmp_path):
    xr.Dataset(
        {"TEMP": ("DEPTH", WARM), "PSAL": ("DEPTH", np.full(5, np.nan))}, {"DEPTH": PRESSURE}
    ).to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match="no good samples, allowed:"):
        load_profiles(tmp_path / "a.nc")


def test_file_that_is_no_netcdf_is_refused(tmp_path):
    (tmp_path / "a.nc").write_text("no netCDF")
    with pytest.raises(ValueError, match="allowed: an undamaged netCDF file"):
        load_profiles(tmp_path / "a.nc")


def test_depth_of_pressure_meets_the_published_check_value():
    assert depth_of_pressure(10_000.0, 30.0) == pytest.approx(9712.653, abs=5e-4)


def test_index_is_that_of_quan_and_fry_and_stays_linear_in_salinity():
    z = np.array([0.0, 50.0])
    fresher, saltier = (
        WaterProfile(z, np.array([25.0, 25.0]), np.full(2, s)) for s in (34.0, 36.0)
    )
    assert fresher.n(10.0) == pytest.approx(float(quan_fry(470.0, 25.0, 34.0)), abs=1e-12)
    middle = float(quan_fry(470.0, 25.0, 35.0))
    assert 0.5 * (fresher.n(10.0) + saltier.n(10.0)) == pytest.approx(middle, abs=1e-12)


@pytest.mark.parametrize("angle", [5.0, 30.0, 60.0])
def test_deflection_in_a_linear_layer_follows_the_closed_form(angle):
    """For n linear: x = p/g (arcosh(n(d)/p) - arcosh(n(0)/p)), with p = n(d) sin(theta)."""
    salinity = np.array([30.0, 36.0])  # the index is linear in it, so between two samples too
    profile = WaterProfile(np.array([0.0, 40.0]), np.array([25.0, 25.0]), salinity)
    theta = math.radians(angle)
    top, bottom = float(profile.n(0.0)), float(profile.n(40.0))
    gradient, p = (bottom - top) / 40.0, bottom * math.sin(theta)
    x = p / gradient * (math.acosh(bottom / p) - math.acosh(top / p))
    found = ray_deflection(profile, 40.0, theta)
    assert found.offset == pytest.approx(x - 40.0 * math.tan(theta), rel=1e-6)
    assert found.angle == pytest.approx(math.asin(p / top) - theta, rel=1e-9)
    assert found.offset > 0.0


def test_even_water_and_vertical_rays_are_not_bent():
    z = np.array([0.0, 20.0, 40.0])
    even = WaterProfile(z, np.full(3, 25.0), np.full(3, 35.0))
    layered = WaterProfile(z, np.array([26.0, 24.0, 20.0]), np.full(3, 35.0))
    assert ray_deflection(even, 30.0, 0.5).offset == pytest.approx(0.0, abs=1e-12)
    assert ray_deflection(layered, 30.0, 0.0) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("depth", "zenith", "field"), [(50.0, 0.1, "depth"), (0.0, 0.1, "depth"), (10.0, 1.5, "zenith")]
)
def test_rays_outside_of_the_profile_are_refused(depth, zenith, field):
    profile = WaterProfile(np.array([0.0, 40.0]), np.full(2, 25.0), np.full(2, 35.0))
    with pytest.raises(ValueError, match=rf"^{field}: .*allowed"):
        ray_deflection(profile, depth, zenith)


@pytest.mark.parametrize("depth", [[10.0, 5.0], [5.0, 5.0], [-1.0, 5.0]])
def test_depths_that_do_not_rise_are_refused(depth):
    with pytest.raises(ValueError, match=r"depth: .*, allowed: strictly increasing depths >= 0 m"):
        WaterProfile(np.array(depth), np.full(2, 25.0), np.full(2, 35.0))
