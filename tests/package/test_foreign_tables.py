"""Tables as other programs write them: each is read with its right values, or refused.

The same numbers are written in many forms; what a form means is stated here, independent of the
readers.
"""

import io
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import meshtrace as mt
from meshtrace import InputWarning
from meshtrace.comms import Curve, SiPM
from meshtrace.errors import Refused
from meshtrace.optics import Water
from meshtrace.optics.water_files import read_spectrum
from meshtrace.surfaces import TabulatedSpectrum, from_gauge, from_wavespectra, gauge_spectrum

# ------------------------------------------------------------------------------ wave gauges

TIME = np.arange(0.0, 204.8, 0.05)
ETA = 0.01 * np.cos(2.0 * np.pi * 0.8 * TIME) + 0.006 * np.cos(2.0 * np.pi * 1.1 * TIME + 1.0)
HS = 4.0 * ETA.std()


def saved(header, *columns, **options):
    """Return the text that `numpy.savetxt` writes."""
    stream = io.StringIO()
    np.savetxt(stream, np.column_stack(columns), header=header, fmt="%.10g", **options)
    return stream.getvalue()


def framed(columns, **options):
    """Return the text that `DataFrame.to_csv` writes."""
    return pd.DataFrame(columns).to_csv(**options)


def rows(heading, *columns, delimiter=","):
    """Return a text with a heading line."""
    body = saved("", *columns, delimiter=delimiter, comments="").lstrip("\n")
    return f"{heading}\n{body}"


def hs(source):
    return gauge_spectrum(source, spreading="cos2s").hs


MM = 1e3 * ETA
GAUGES = {
    "savetxt": saved("time [s], eta [mm]", TIME, MM),
    "savetxt, spaces": saved("time [s] eta [mm]", TIME, MM),
    "savetxt, commas": saved("t (s),eta (mm)", TIME, MM, delimiter=","),
    "savetxt, tabs": saved("t/s\teta/mm", TIME, MM, delimiter="\t"),
    "savetxt, a title": saved("tank of 3 m\ntime [s], eta [mm]", TIME, MM),
    "savetxt, two lines": saved("time eta\ns mm", TIME, MM),
    "savetxt, no sign": saved("time,eta_mm", TIME, MM, delimiter=",", comments=""),
    "savetxt, matlab": saved("time [s], eta [mm]", TIME, MM, comments="% "),
    "underscore": rows("t,eta_mm", TIME, MM),
    "space": rows("t,eta mm", TIME, MM),
    "slash": rows("t,eta/mm", TIME, MM),
    "in": rows("t,eta in mm", TIME, MM),
    "units below": rows("time,eta\ns,mm", TIME, MM),
    "units below, brackets": rows("time,eta\n[s],[mm]", TIME, MM),
    "another order": framed({"WG1 [mm]": MM, "Time [s]": TIME}, index=False),
    "to_csv": framed({"time [s]": TIME, "eta [mm]": MM}),
    "to_csv, saved twice": framed({"Unnamed: 0": range(len(TIME)), "time [s]": TIME, "eta [mm]": MM}),
    "to_csv, index of times": pd.DataFrame({"eta [mm]": MM}, pd.Index(TIME, name="time [s]")).to_csv(),
    "to_csv, german": framed({"t [s]": TIME, "eta [mm]": MM}, sep=";", decimal=",", index=False),
    "to_csv, tabs and decimal commas": framed({"t [s]": TIME, "eta [mm]": MM}, sep="\t", decimal=",", index=False),
    "to_string": pd.DataFrame({"t_s": TIME, "eta_mm": MM}).to_string(),
    "quoted": framed({"t [s]": TIME, "eta [mm]": MM}, index=False, quoting=1),
    "crlf and a mark": "\ufeff" + framed({"t [s]": TIME, "eta [mm]": MM}, index=False, lineterminator="\r\n"),
    "trailing delimiters": re.sub(r"(?m)(?<=\d)$", ",", framed({"t": TIME, "eta_mm": MM}, index=False)),
    "trailing delimiters, heading too": re.sub(r"(?m)(?<=.)$", ",", framed({"t": TIME, "eta_mm": MM}, index=False)),
    "fortran": "time [s] eta [m]\n" + "\n".join(f"{t:.5f}D0 {e:.8E}".replace("E", "D") for t, e in zip(TIME, ETA, strict=True)),
    "no heading": saved("", TIME, ETA, comments=""),
    "no heading, a remark": saved("run 7", TIME, ETA),
    "cm": framed({"time": TIME, "elevation (cm)": 100.0 * ETA}, index=False),
    "ft": framed({"time": TIME, "elevation_ft": ETA / 0.3048}, index=False),
    "um": framed({"time": TIME, "probe 1 [µm]": 1e6 * ETA}, index=False),
    "numbered": rows("t,wg_2_mm", TIME, MM),
    "numbered, spaces": rows("Time sec\tProbe 2 in mm", TIME, MM, delimiter="\t"),
    "masked ends": framed({"time": TIME, "eta": np.where(abs(TIME - 102.0) < 102.0, ETA, np.nan)}, index=False),
}  # fmt: skip


@pytest.mark.parametrize("text", GAUGES.values(), ids=GAUGES)
def test_gauges(tmp_path, text):
    (tmp_path / "gauge.csv").write_text(text, encoding="utf-8", newline="")
    assert hs(tmp_path / "gauge.csv") == pytest.approx(HS, rel=2e-3)


def test_gauges_agree_in_all_digits(tmp_path):
    (tmp_path / "m.txt").write_text(saved("time [s], eta [m]", TIME, ETA))
    (tmp_path / "mm.txt").write_text(saved("time [s], eta [mm]", TIME, MM))
    assert hs(tmp_path / "mm.txt") == pytest.approx(hs(tmp_path / "m.txt"), rel=1e-8)


ARRAYS = {
    "array": np.column_stack([TIME, ETA]),
    "unmasked": np.ma.array(np.column_stack([TIME, ETA]), mask=False),
    "frame": pd.DataFrame({"time": TIME, "eta": ETA}),
    "frame, units": pd.DataFrame({"eta_mm": MM, "time_s": TIME}),
    "frame, named index": pd.DataFrame({"eta [mm]": MM}, pd.Index(TIME, name="t")),
    "frame, dates": pd.DataFrame({"eta": ETA}, pd.Timestamp("2026-01-01") + pd.to_timedelta(TIME, "s")),
    "frame, durations": pd.DataFrame({"eta": ETA}, pd.to_timedelta(TIME, "s")),
    "frame without labels": pd.DataFrame(np.column_stack([TIME, ETA])),
    "frame, nullable": pd.DataFrame({"time": TIME, "eta": ETA}).convert_dtypes(),
    "structured": np.rec.fromarrays([MM, TIME], names="eta_mm,time"),
    "list": np.column_stack([TIME, ETA]).tolist(),
    "single precision": np.column_stack([TIME, ETA]).astype("f4"),
}  # fmt: skip


@pytest.mark.parametrize("source", ARRAYS.values(), ids=ARRAYS)
def test_arrays_of_gauges(source):
    assert hs(source) == pytest.approx(HS, rel=2e-3)


def masked(share):
    record = np.ma.array(np.column_stack([TIME, ETA]), mask=False)
    record[:: round(1.0 / share), 1] = np.ma.masked
    return record


class Quantity(np.ndarray):
    units = "mm"


BAD_ARRAYS = {
    "masked": (masked(1 / 6), "row 7, column 2: missing"),
    "nan": (masked(1 / 6).filled(np.nan), "row 7, column 2: missing"),
    "infinite": (np.column_stack([TIME, np.where(TIME == 5.0, np.inf, ETA)]), "row 101, column 2: inf"),
    "complex": (np.column_stack([TIME, ETA]) + 1j, "complex"),
    "attributes": (np.column_stack([TIME, MM]).view(Quantity), "attributes"),
    "xarray": (gauge_spectrum(ARRAYS["array"], spreading="cos2s").efth, "attributes"),
    "pressure": (pd.DataFrame({"t": TIME, "p_dbar": ETA}), "dbar|p_dbar"),
    "named pressure": (pd.DataFrame({"t": TIME, "pressure": ETA}), "pressure"),
    "volts": (pd.DataFrame({"t": TIME, "eta [V]": ETA}), "unit: V"),
    "words": (pd.DataFrame({"t": TIME, "eta": "x"}), "row 1, column eta: 'x'"),
    "no time": (pd.DataFrame({"eta": ETA, "wg2": ETA}), "one column time"),
    "unnamed index": (pd.DataFrame({"eta": ETA}, TIME), "an index without name"),
    "twice": (pd.DataFrame(np.column_stack([TIME, ETA, ETA]), columns=["t", "eta", "eta"]), "different headings"),
    "millimetres without unit": (np.column_stack([TIME, 1e4 * ETA]), "a heading with the unit"),
    "an index beside": (np.column_stack([np.arange(len(TIME)), 0.01 * TIME, ETA]), "rises in all rows"),
    "bytes": (b"\x93NUMPY\x01", "source"),
    "None": (None, "source"),
    "dictionary": ({"t": TIME, "eta": ETA}, "source"),
}  # fmt: skip


@pytest.mark.parametrize(("source", "message"), BAD_ARRAYS.values(), ids=BAD_ARRAYS)
def test_arrays_that_are_refused(source, message):
    with pytest.raises(Refused, match=message):
        gauge_spectrum(source, spreading="cos2s")


BAD_GAUGES = {
    "pressure": (rows("t,pressure_dbar", TIME, ETA), "pressure"),
    "pressure in brackets": (rows("t,p [kPa]", TIME, ETA), "unit: kPa"),
    "pressure in a remark": (saved("time and pressure in dbar", TIME, ETA), "# time and pressure in dbar"),
    "unit in a remark": (saved("elevations in mm", TIME, MM), "# elevations in mm"),
    "volts": (rows("t,eta (V)", TIME, ETA), "unit: V"),
    "unknown unit": (rows("t,eta [counts2]", TIME, ETA), "unit: counts2"),
    "unknown name": (rows("t,u", TIME, ETA), "a column u"),
    "more names": (rows("t,eta,x", TIME, ETA), "t,eta,x over 2 columns"),
    "mixed units": (rows("t,a [mm],b [cm]", TIME, MM, MM), "cm, mm"),
    "dates": ("time,eta\n2026-01-01T00:00,0.1\n2026-01-01T00:01,0.2\n", "line 2, column time"),
    "short row": ("t,eta\n0,1\n1\n2,1\n", "line 3: 1 columns, line 2: 2"),
    "long row": ("t,eta\n0,1\n1,2,3\n2,1\n", "line 3: 3"),
    "a word": ("t,eta\n0,1\n1,bad\n2,1\n", "line 3, column eta: 'bad'"),
    "empty cell": ("t,eta\n0,1\n1,\n2,1\n", "line 3, column eta: missing"),
    "overflow": ("t,eta\n0,1\n1,*****\n2,1\n", "line 3, column eta"),
    "underscores": ("t,eta\n0,1\n1,1_0\n2,1\n", "line 3, column eta: '1_0'"),
    "thousands": ('t,eta\n0,"1,000.5"\n1,2\n2,1\n', "gauge.csv"),
    "both decimals": ("t;eta\n0,5;1.5\n1,0;2,5\n", "decimal commas alone"),
    "preamble": (f"Station 7\nDepth 12 m\nSerial 8\n{rows('t,eta', TIME, ETA)}", "gauge.csv"),
    "html": ("<html><body>404</body></html>", "gauge.csv"),
    "one column": (saved("", ETA), "1 column"),
    "empty": ("", "no rows"),
    "heading alone": ("t,eta\n", "no numbers"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD_GAUGES.values(), ids=BAD_GAUGES)
def test_files_of_gauges_that_are_refused(tmp_path, text, message):
    (tmp_path / "gauge.csv").write_text(text)
    with pytest.raises(Refused, match=message) as error:
        gauge_spectrum(tmp_path / "gauge.csv", spreading="cos2s")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "content",
    [b"\x93NUMPY\x01\x00v\x00", b"PK\x03\x04\x00\x00", b"\xff\xfet\x00,\x00", b"a\xb5,b\n1,2\n"],
)
def test_binary_files_are_refused(tmp_path, content):
    (tmp_path / "gauge.csv").write_bytes(content)
    for read in (
        hs,
        from_gauge,
        mt.TabulatedPhase.from_file,
        TabulatedSpectrum.from_file,
        read_spectrum,
    ):
        with pytest.raises(Refused, match=r"gauge.csv: no text"):
            read(tmp_path / "gauge.csv")


def test_a_unit_that_is_given_has_to_be_that_of_the_heading(tmp_path):
    (tmp_path / "a.csv").write_text(rows("t,eta [mm]", TIME, MM))
    assert gauge_spectrum(tmp_path / "a.csv", spreading="ittc", unit="mm").hs == pytest.approx(
        HS, rel=2e-3
    )
    with pytest.raises(Refused, match="unit: cm, mm"):
        gauge_spectrum(tmp_path / "a.csv", spreading="ittc", unit="cm")


# --------------------------------------------------------------------------- tabulated spectra

OMEGA = np.linspace(0.4, 3.0, 27)
DENSITY = 0.05 * np.exp(-8.0 * (OMEGA - 1.0) ** 2)  # m2 s rad-1
F, S_F = OMEGA / (2.0 * np.pi), 2.0 * np.pi * DENSITY

SPECTRA = {
    "savetxt": saved("f [Hz], S [m2/Hz]", F, S_F),
    "savetxt, spaces": saved("f [Hz] S(f) [m^2/Hz]", F, S_F),
    "savetxt, powers": saved("f [Hz], S [m² Hz⁻¹]", F, S_F),
    "savetxt, names": saved("f S", F, S_F),
    "savetxt, omega": saved("omega S", OMEGA, DENSITY),
    "savetxt, omega and units": saved("omega [rad/s], S [m2 s/rad]", OMEGA, DENSITY),
    "to_csv": framed({"f [Hz]": F, "S": S_F}),
    "to_csv, units": framed({"f [Hz]": F, "S [m2/Hz]": S_F}),
    "to_csv, index": pd.DataFrame({"S": S_F}, pd.Index(F, name="freq")).to_csv(),
    "units alone": rows("Hz,m2/Hz", F, S_F),
    "units below": rows("freq,psd\nHz,m2/Hz", F, S_F),
    "order": rows("S [m2/Hz],f [Hz]", S_F, F),
    "underscores": rows("f_Hz,S_m2_Hz-1", F, S_F),
    "more columns": rows("f [Hz],S [m2/Hz],dir [deg],spread [deg]", F, S_F, F, F),
    "cm": rows("f [Hz],S [cm2/Hz]", F, 1e4 * S_F),
    "seconds": rows("f [Hz],S [m2 s]", F, S_F),
    "1/s": rows("f [1/s],S [m2 s]", F, S_F),
    "omega over seconds": rows("omega [1/s],S [m2 s]", OMEGA, DENSITY),
    "underscored omega": rows("omega_rad_s,S", OMEGA, DENSITY),
    "mixed": rows("omega [rad/s],S [m2/Hz]", OMEGA, S_F),
    "mixed, otherwise": rows("f [Hz],S [m2 s rad-1]", F, DENSITY),
    "millihertz": rows("f [mHz],S [m2/Hz]", 1e3 * F, S_F),
    "degrees": rows("omega [deg/s],S [m2 s/deg]", np.degrees(OMEGA), np.radians(DENSITY)),
    "greek": rows("ω [rad/s],S(ω) [m2 s rad-1]", OMEGA, DENSITY),
    "no heading": rows("# from the model", OMEGA, DENSITY),
    "unit against name": rows("f [rad/s],S [m2 s/rad]", OMEGA, DENSITY),
    "Hz": rows("Hz,S", F, S_F),
    "savetxt, units below": saved("freq psd\n1/s cm2/Hz", F, 1e4 * S_F),
    "index of R": "E[m2 s rad-1]\tangular frequency[1/s]\n" + saved("", np.arange(27), DENSITY, OMEGA, delimiter="\t"),
    "frequency": rows("Frequency (Hz);Energy density (m^2/Hz)", F, S_F, delimiter=";"),
}  # fmt: skip


@pytest.mark.parametrize("text", SPECTRA.values(), ids=SPECTRA)
def test_tabulated_spectra(tmp_path, text):
    (tmp_path / "s.csv").write_text(text, encoding="utf-8")
    found = TabulatedSpectrum.from_file(tmp_path / "s.csv")
    np.testing.assert_allclose(found.omega, OMEGA, rtol=1e-8)
    np.testing.assert_allclose(found.density, DENSITY, rtol=1e-8, atol=1e-15)


BAD_SPECTRA = {
    "period": (rows("T [s],S [m2/Hz]", F, S_F), "T"),
    "amplitude": (rows("f [Hz],a [m]", F, S_F), "in m"),
    "variance": (rows("f [Hz],S [m2]", F, S_F), "in m2"),
    "direction": (rows("f [Hz],S [m2/Hz/deg]", F, S_F), "in m2/Hz/deg"),
    "wavenumber": (rows("k [rad/m],S [m3]", F, S_F), "k"),
    "unknown heading": (rows("x,y", F, S_F), "x, y, allowed: columns omega"),
    "unknown remark": (saved("period, power", F, S_F), "# period, power"),
    "remark with unit": (saved("frequencies in Hz", F, S_F), "# frequencies in Hz"),
    "half a remark": (saved("period, S", F, S_F), "period, S"),
    "contradiction": (rows("omega,S(f)", OMEGA, S_F), "a unit with Hz or rad"),
    "unit against name": (rows("f [rad/s],S", OMEGA, DENSITY), "a unit with Hz or rad"),
    "unit against name, without angle": (rows("omega [Hz],S [m2 s]", F, S_F), "a unit with Hz or rad"),
    "twice": (rows("f [Hz],omega [rad/s],S", F, OMEGA, S_F), r"f \[Hz\] and omega"),
    "two densities": (rows("f [Hz],S,psd", F, S_F, S_F), "S and psd"),
    "three columns": (rows("", np.arange(27), F, S_F).lstrip(), "3 columns without headings"),
    "decimal commas between commas": ("f,S\n0,1,0,5\n0,2,0,6\n", "over 4 columns"),
    "masked": (rows("f,S", F, np.where(F > 0.3, np.nan, S_F)), "missing"),
    "decibel": (rows("f [Hz],S [dB]", F, S_F), "in dB"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD_SPECTRA.values(), ids=BAD_SPECTRA)
def test_spectra_that_are_refused(tmp_path, text, message):
    (tmp_path / "s.csv").write_text(text)
    with pytest.raises(Refused, match=message):
        TabulatedSpectrum.from_file(tmp_path / "s.csv")


# ------------------------------------------------------------------------------ phase functions

THETA = np.linspace(0.0, np.pi, 91)
VSF = (1.0 - 0.9**2) / (1.0 + 0.9**2 - 1.8 * np.cos(THETA)) ** 1.5  # Henyey and Greenstein
BACK = (1.0 - 0.9) / 1.8 * ((1.0 + 0.9) / np.sqrt(1.0 + 0.9**2) - 1.0)  # its share backwards

PHASES = {
    "radians": rows("theta [rad],vsf", THETA, VSF),
    "radians, savetxt": saved("theta [rad], p", THETA, VSF),
    "radians, name": rows("theta_rad,p", THETA, VSF),
    "radians, words": rows("Scattering angle (radians),VSF (m^-1 sr^-1)", THETA, VSF),
    "degrees": rows("theta,vsf", np.degrees(THETA), VSF),
    "degrees, sign": rows("θ [°],β [1/sr]", np.degrees(THETA), VSF),
    "degrees, savetxt": saved("angle value", np.degrees(THETA), VSF),
    "order": rows("vsf,angle_deg", VSF, np.degrees(THETA)),
    "to_csv": framed({"theta [rad]": THETA, "p11": VSF}),
    "error": rows("theta [deg],vsf,vsf_sd", np.degrees(THETA), VSF, 0.1 * VSF),
    "scale": rows("angle [deg];intensity [a.u.]", np.degrees(THETA), 7.0 * VSF, delimiter=";"),
    "no heading": rows("", np.degrees(THETA), VSF).lstrip(),
    "a remark": rows("# measured at 532 nm", np.degrees(THETA), VSF),
}  # fmt: skip


@pytest.mark.parametrize("text", PHASES.values(), ids=PHASES)
def test_phase_tables(tmp_path, text):
    (tmp_path / "p.csv").write_text(text, encoding="utf-8")
    found = mt.TabulatedPhase.from_file(tmp_path / "p.csv")
    assert found.backscatter_fraction == pytest.approx(BACK, rel=2e-2)  # linear in log-log axes


BAD_PHASES = {
    "radians without unit": (rows("", THETA, VSF).lstrip(), "angles that end at 3.14"),
    "radians, names": (rows("theta,vsf", THETA, VSF), "angles that end at 3.14"),
    "remark": (saved("angles in radians", THETA, VSF), "# angles in radians"),
    "cosine": (rows("cos_theta,p", np.linspace(0.0, 1.0, 91), VSF), "cos_theta"),
    "density of angle": (rows("theta [deg],p [1/deg]", np.degrees(THETA), VSF), "per solid angle"),
    "length": (rows("theta [m],p", np.degrees(THETA), VSF), "in m, allowed: a unit of an angle"),
    "two values": (rows("theta,x,y", np.degrees(THETA), VSF, VSF), "theta, x, y"),
    "more": (rows("", np.degrees(THETA), VSF, VSF).lstrip(), "3 columns without headings"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD_PHASES.values(), ids=BAD_PHASES)
def test_phase_tables_that_are_refused(tmp_path, text, message):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(Refused, match=message):
        mt.TabulatedPhase.from_file(tmp_path / "p.csv")


# ------------------------------------------------------------------------------------ waters

NM = np.array([450.0, 500.0, 550.0])
A, B = np.array([0.12, 0.08, 0.20]), np.array([0.50, 0.45, 0.40])
LONG = {
    "depth [m]": np.repeat([0.0, 10.0], 3),
    "wavelength [nm]": np.tile(NM, 2),
    "a [1/m]": np.concatenate([A, 0.5 * A]),
    "b [1/m]": np.concatenate([B, 0.5 * B]),
}
WATERS = {
    "csv": framed(LONG, index=False),
    "to_csv": framed(LONG),
    "order": framed(dict(reversed(LONG.items())), index=False),
    "no heading": framed(LONG, index=False, header=False),
    "micrometres": framed({**LONG, "wavelength [nm]": 1e-3 * LONG["wavelength [nm]"]}, index=False).replace("[nm]", "[um]"),
    "metres": framed({**LONG, "wavelength [nm]": 1e-9 * LONG["wavelength [nm]"]}, index=False).replace("[nm]", "[m]"),
    "per cm": framed({**LONG, "a [1/m]": 0.01 * LONG["a [1/m]"]}, index=False).replace("a [1/m]", "a [cm-1]"),
    "cm": framed({**LONG, "depth [m]": 100.0 * LONG["depth [m]"]}, index=False).replace("depth [m]", "depth_cm"),
    "underscores": framed(LONG, index=False).replace(" [1/m]", "_1/m").replace(" [nm]", "_nm"),
    "units below": "depth,lambda,a,b\nm,nm,1/m,1/m\n" + framed(LONG, index=False, header=False),
    "savetxt": saved("depth [m], wavelength [nm], a [1/m], b [1/m]", *LONG.values()),
    "more columns": framed({**LONG, "c": 1.0, "bb": 0.01, "a_sd": 0.1, "station": "x 7"}, index=False),
}  # fmt: skip


@pytest.mark.parametrize("text", WATERS.values(), ids=WATERS)
def test_water_tables(tmp_path, text):
    (tmp_path / "w.csv").write_text(text)
    water = Water.from_file(tmp_path / "w.csv", 500.0)
    np.testing.assert_allclose(water.layers, [(0.0, 0.08, 0.45), (10.0, 0.04, 0.225)], rtol=1e-9)


BAD_WATERS = {
    "another depth": (framed(LONG, index=False).replace("depth [m]", "bin_depth"), "bin_depth"),
    "depth below": (framed(LONG, index=False).replace("depth [m]", "depth under water (m)"), "depth under"),
    "pressure": (framed(LONG, index=False).replace("depth [m]", "depth [dbar]"), "in dbar"),
    "wavenumber": (framed(LONG, index=False).replace("[nm]", "[cm-1]"), "in cm-1"),
    "backscattering": (framed(LONG, index=False).replace("b [1/m]", "b_b [1/m]"), "b_b"),
    "volume scattering": (framed(LONG, index=False).replace("b [1/m]", "b [1/m/sr]"), "in 1/m/sr"),
    "twice": (framed(LONG, index=False).replace("b [1/m]", "a [1/m]"), "and a"),
    "micrometres without unit": (framed({**LONG, "wavelength [nm]": 0.5}, index=False).replace(" [nm]", ""), "0.5 ... 0.5 without unit"),
    "no wavelengths": ("1 1 1\n2 4 8\n3 9 27\n", "wavelength 1 ... 3 without unit"),
    "index alone": (framed({k: v for k, v in LONG.items() if "depth" not in k}, header=False), "w.csv|rows"),
    "ragged": (framed(LONG, index=False) + "20,450,.1\n", "line 8: 3 columns"),
    "negative": (framed({**LONG, "a [1/m]": -1.0}, index=False), "rows of"),
    "infinite": (framed({**LONG, "a [1/m]": np.inf}, index=False), "line 2, column a"),
    "one wavelength less": (framed(LONG, index=False).rsplit("\n", 2)[0], "wavelengths at 2 depths"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD_WATERS.values(), ids=BAD_WATERS)
def test_water_tables_that_are_refused(tmp_path, text, message):
    (tmp_path / "w.csv").write_text(text)
    with pytest.raises(Refused, match=message):
        read_spectrum(tmp_path / "w.csv")


SCAN = """/begin_header
/missing=-9999
/below_detection_limit=-8888
/delimiter={delimiter}
! a remark
/fields={fields}
/units={units}
/end_header
{body}
"""


def seabass(rows, fields="wavelength,a,b", units="nm,1/m,1/m", delimiter="comma", **changes):
    sign = {"comma": ",", "space": "  ", "tab": "\t", "semicolon": ";"}[delimiter]
    body = "\n".join(sign.join(f"{x}" for x in row) for row in rows)
    text = SCAN.format(fields=fields, units=units, delimiter=delimiter, body=body)
    for old, new in changes.items():
        text = text.replace({"end": "\n", "head": "/units"}[old], new)
    return text


ROWS = list(zip(NM, A, B, strict=True))
DEEP = [(z, w, a / (1 + z), b / (1 + z)) for z in (1.0, 5.0) for w, a, b in ROWS]
SEABASS = {
    "commas": seabass(ROWS),
    "spaces": seabass(ROWS, delimiter="space"),
    "tabs": seabass(ROWS, delimiter="tab"),
    "semicolons": seabass(ROWS, delimiter="semicolon"),
    "trailing delimiter": seabass([(*row, "") for row in ROWS]),
    "trailing tab": seabass([(*row, "") for row in ROWS], delimiter="tab"),
    "trailing comma in fields": seabass([(*row, "") for row in ROWS], "wavelength,a,b,"),
    "no units": seabass(ROWS).replace("/units=nm,1/m,1/m\n", ""),
    "crlf": seabass(ROWS, end="\r\n"),
    "per cm": seabass([(w, a / 100.0, b) for w, a, b in ROWS], units="nm,1/cm,1/m"),
    "micrometres": seabass([(w / 1e3, a, b) for w, a, b in ROWS], units="um,1/m,1/m"),
    "words": seabass([("st_1", *row, "12:00:00") for row in ROWS], "station,wavelength,a,b,time", "none,nm,1/m,1/m,hh:mm:ss"),
    "a row without values": seabass([*ROWS, (600.0, -9999.0, "-9999")]),
    "capitals": seabass(ROWS, "Wavelength,A,B").replace("/delimiter", "/DELIMITER"),
    "upright": seabass([[*A, *B]], "a450,a500,a550,b450,b500,b550", ",".join(["1/m"] * 6)),
}  # fmt: skip


@pytest.mark.parametrize("text", SEABASS.values(), ids=SEABASS)
def test_seabass(tmp_path, text):
    (tmp_path / "w.sb").write_bytes(text.encode())
    found = np.array(read_spectrum(tmp_path / "w.sb").table)
    np.testing.assert_allclose(found, np.column_stack([np.zeros(3), NM, A, B]), rtol=1e-12)


def test_seabass_of_other_encodings(tmp_path):
    text = SEABASS["commas"].replace("! a remark", "/investigators=Jos\xe9_Mu\xf1oz")
    (tmp_path / "w.sb").write_bytes(text.encode("latin-1"))
    assert read_spectrum(tmp_path / "w.sb").table[0] == (0.0, 450.0, 0.12, 0.5)


@pytest.mark.parametrize("name", ["depth", "bin_depth"])
@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("cm", 100.0)])
def test_seabass_profiles(tmp_path, name, unit, factor):
    rows = [(factor * z, *row) for z, *row in DEEP]
    text = seabass(rows, f"{name},wavelength,a,b", f"{unit},nm,1/m,1/m")
    (tmp_path / "w.sb").write_text(text)
    np.testing.assert_allclose(read_spectrum(tmp_path / "w.sb").table, DEEP, rtol=1e-12)


BAD_SEABASS = {
    "ragged": (seabass([*ROWS, (600.0, 0.3)]), "line 12: 2 columns"),
    "long": (seabass([*ROWS, (600.0, 0.3, 0.2, 0.1)]), "line 12: 4"),
    "fewer fields": (seabass(ROWS, "wavelength,a", "nm,1/m"), "line 9: 3 columns, allowed: .*2 fields"),
    "field twice": (seabass(ROWS, "wavelength,a,a"), "fields a twice"),
    "wavelength twice": (seabass([(1, 2, 3)], "a440,a440.0,b440", "1/m,1/m,1/m"), "a440, a440.0"),
    "units": (seabass(ROWS, units="nm,1/m"), "3 fields and 2 units"),
    "kind of unit": (seabass(ROWS, units="nm,1/m/sr,1/m"), "field a: in 1/m/sr"),
    "pressure": (seabass(DEEP, "pressure,wavelength,a,b", "dbar,nm,1/m,1/m"), "pressure"),
    "two depths": (seabass([(0, *r) for r in DEEP], "depth,bin_depth,wavelength,a,b", "m,m,nm,1/m,1/m"), "depth, bin_depth"),
    "max_depth": (seabass(DEEP, "depth_max,wavelength,a,b", "m,nm,1/m,1/m"), "depth_max"),
    "a word": (seabass([*ROWS, (600.0, "bad", 1.0)]), "line 12, column a: 'bad'"),
    "other missing": (seabass([*ROWS, (600.0, -999.0, 1.0)]), "line 12, column a: -999"),
    "missing": (seabass(ROWS).replace("/missing=-9999", "/missing=x"), "missing: 'x'"),
    "delimiter": (seabass(ROWS).replace("=comma", "=pipe"), "delimiter: 'pipe'"),
    "no end": (seabass(ROWS).replace("/end_header", ""), "no /end_header"),
    "no rows": (seabass([]), "no rows"),
    "no fields": (seabass(ROWS).replace("/fields=wavelength,a,b", ""), "w.sb"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD_SEABASS.values(), ids=BAD_SEABASS)
def test_seabass_that_is_refused(tmp_path, text, message):
    (tmp_path / "w.sb").write_text(text)
    with pytest.raises(Refused, match=message):
        read_spectrum(tmp_path / "w.sb")


# ----------------------------------------------------------------------------------- devices

PDE = np.array([0.25, 0.40, 0.30])
CURVES = {
    "nm": rows("wavelength [nm],pde", NM, PDE),
    "um": rows("wavelength [um],pde", NM / 1e3, PDE),
    "µm": rows("lambda (µm),PDE", NM / 1e3, PDE),
    "m": rows("wavelength_m,pde", NM * 1e-9, PDE),
    "angstrom": rows("wavelength [angstrom],pde", NM * 10.0, PDE),
    "per cent": rows("wavelength [nm],PDE [%]", NM, 100.0 * PDE),
    "per cent, words": rows("Wavelength (nm);PDE (percent)", NM, 100.0 * PDE, delimiter=";"),
    "per cent, name": rows("wl_nm,pde_%", NM, 100.0 * PDE),
    "units": rows("nm,%", NM, 100.0 * PDE),
    "savetxt": saved("wavelength [um], PDE [%]", NM / 1e3, 100.0 * PDE),
    "to_csv": framed({"wavelength [nm]": NM, "pde": PDE}),
    "order": rows("pde [1],wavelength [nm]", PDE, NM),
    "no heading": rows("", NM, PDE).lstrip(),
    "another name": rows("wavelength,S14160 at 5 V", NM, PDE),
}  # fmt: skip


@pytest.mark.parametrize("text", CURVES.values(), ids=CURVES)
def test_curves_of_devices(tmp_path, text):
    file = tmp_path / "c.csv"
    file.write_text(text, encoding="utf-8")
    curve = SiPM(pde={"file": str(file)}).pde
    np.testing.assert_allclose(curve.wavelength_nm, NM, rtol=1e-12)
    np.testing.assert_allclose(curve.value, PDE, rtol=1e-12)


BAD_CURVES = {
    "um without unit": (rows("wavelength,pde", NM / 1e3, PDE), "0.45 ... 0.55 without unit"),
    "um, no heading": (rows("", NM / 1e3, PDE).lstrip(), "0.45 ... 0.55 without unit"),
    "wavenumber": (rows("wavelength [cm-1],pde", NM, PDE), "in cm-1"),
    "energy": (rows("E [eV],pde", NM, PDE), "E"),
    "responsivity": (rows("wavelength [nm],responsivity [A/W]", NM, PDE), "in A/W"),
    "responsivity, name": (rows("wavelength_nm,responsivity_A/W", NM, PDE), "A/W"),
    "responsivity, in": (rows("wavelength in nm;R in A/W", NM, PDE, delimiter=";"), "A/W"),
    "decibel": (rows("wavelength [nm],T [dB]", NM, PDE), "in dB"),
    "per cent without unit": (rows("wavelength [nm],PDE", NM, 100.0 * PDE), "shares"),
    "per cent, remark": (rows("# PDE in %", NM, PDE), "# PDE in %"),
    "two values": (rows("wavelength,T1,T2", NM, PDE, PDE), "wavelength, T1, T2"),
    "three columns": (rows("", NM, PDE, PDE).lstrip(), "3 columns without headings"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD_CURVES.values(), ids=BAD_CURVES)
def test_curves_that_are_refused(tmp_path, text, message):
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        SiPM(pde={"file": str(tmp_path / "c.csv")})


def test_spectra_of_lamps_have_any_scale(tmp_path):
    for heading in ("wavelength [nm],power [W/nm]", "nm,counts", "wavelength_nm,intensity [a.u.]"):
        (tmp_path / "c.csv").write_text(rows(heading, NM, 40.0 * PDE))
        curve = Curve.model_validate({"file": str(tmp_path / "c.csv")})
        np.testing.assert_allclose(curve.value, 40.0 * PDE)
    (tmp_path / "c.csv").write_text(rows("wavelength [nm],power [W/THz]", NM, PDE))
    with pytest.raises(ValueError, match="values over wavelength"):
        Curve.model_validate({"file": str(tmp_path / "c.csv")})


# ------------------------------------------------------------------------ directional tables

DIRECTIONS = np.arange(0.0, 360.0, 30.0)
FREQ = np.array([0.1, 0.15, 0.2, 0.25])
EFTH = np.outer([1.0, 3.0, 2.0, 1.0], 1.0 + np.cos(np.radians(DIRECTIONS - 90.0))) * 1e-3
WORDS = [f"{d:g}" for d in DIRECTIONS]
ALL = pd.DataFrame(EFTH, pd.Index(FREQ, name="f [Hz]"), WORDS)
DIRECTIONAL = {
    "csv": ALL.to_csv(),
    "unnamed index": ALL.rename_axis(None).to_csv(),
    "frequencies as a column": ALL.reset_index().to_csv(),
    "semicolons": ALL.to_csv(sep=";", decimal=","),
    "savetxt": saved("f [Hz] " + " ".join(WORDS), FREQ, EFTH),
    "degrees": ALL.add_suffix(" deg").to_csv(),
    "names": ALL.add_prefix("dir_").to_csv(),
    "spaces": "freq " + " ".join(WORDS) + "\n" + saved("", FREQ, EFTH).lstrip("#").lstrip(),
    "trailing delimiters": re.sub(r"(?m)(?<=.)$", ",", ALL.to_csv()),
}  # fmt: skip


@pytest.mark.parametrize("text", DIRECTIONAL.values(), ids=DIRECTIONAL)
def test_directional_tables(tmp_path, text):
    (tmp_path / "e.csv").write_text(text)
    sea = from_wavespectra(tmp_path / "e.csv", mss="band")
    np.testing.assert_allclose(sea.omega, 2.0 * np.pi * FREQ)
    np.testing.assert_allclose(np.sum(sea.variance), EFTH.sum() * 0.05 * 30.0)


BAD_DIRECTIONAL = {
    "angular frequency": ALL.rename_axis("omega [rad/s]").to_csv(),
    "angular, without unit": ALL.rename_axis("omega").to_csv(),
    "period": ALL.rename_axis("T [s]").to_csv(),
    "radians": ALL.add_suffix(" rad").to_csv(),
    "per radian": "# m2/Hz/rad\n" + ALL.to_csv(),
    "cm": "# density in cm2/Hz/deg\n" + ALL.to_csv(),
    "rows counted": ALL.reset_index(drop=True).to_csv(),
    "missing": ALL.mask(ALL > 5.5e-3).to_csv(),
    "no header": ALL.to_csv(header=False),
    "words": ALL.add_prefix("bin ").to_csv(),
}  # fmt: skip


@pytest.mark.parametrize("text", BAD_DIRECTIONAL.values(), ids=BAD_DIRECTIONAL)
def test_directional_tables_that_are_refused(tmp_path, text):
    (tmp_path / "e.csv").write_text(text)
    with pytest.raises(Refused, match=r"e\.csv"):
        from_wavespectra(tmp_path / "e.csv", mss="band")


# --------------------------------------------------------------------------- what is said


def test_a_conversion_is_said_in_one_line(tmp_path):
    cases = {
        "g.csv": (GAUGES["to_csv"], hs, "which counts the rows, left out; elevations in mm converted to m"),
        "s.csv": (SPECTRA["to_csv, units"], TabulatedSpectrum.from_file, "omega in Hz converted to rad s-1"),
        "p.csv": (PHASES["radians"], mt.TabulatedPhase.from_file, "theta in rad converted to deg"),
        "w.csv": (WATERS["per cm"], read_spectrum, "a in cm-1 converted to m-1"),
        "w.sb": (SEABASS["per cm"], read_spectrum, "a in 1/cm converted to m-1"),
        "c.csv": (CURVES["per cent"], lambda c: SiPM(pde={"file": str(c)}), r"value in % converted"),
    }  # fmt: skip
    for name, (text, read, message) in cases.items():
        (tmp_path / name).write_text(text)
        with pytest.warns(InputWarning, match=message) as told:
            read(tmp_path / name)
        assert len(told) == 1
        assert Path(told[0].filename) == Path(__file__), name


def test_nothing_is_said_of_usual_units(tmp_path, recwarn):
    (tmp_path / "g.csv").write_text(saved("time [s], eta [m]", TIME, ETA))
    hs(tmp_path / "g.csv")
    (tmp_path / "w.csv").write_text(WATERS["csv"])
    read_spectrum(tmp_path / "w.csv")
    assert not [w for w in recwarn if w.category is InputWarning]
