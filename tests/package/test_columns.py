"""Text files of columns, and the spectra and phase functions read from them."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import tables
from meshtrace.errors import Refused
from meshtrace.surfaces import MeasuredSea, SpectralSea, TabulatedSpectrum, from_wavespectra

FORMS = {
    "comma": "theta,vsf\n1,2\n10,0.5\n",
    "semicolon": "theta [deg];vsf\n1,0;2,0\n10,0;0,5\n",
    "tab": "# measured\n1\t2\n10\t0.5\n",
    "spaces": "1   2\n10  0.5   # last\n",
    "semicolon and points": "1.0;2.0\n10.0;0.5\n",
    "byte order mark": "\ufefftheta,vsf\r\n1,2\r\n10,0.5\r\n",
}


def values_of(file):
    table = tables.read_columns(file, (tables.Column("theta", "deg"), tables.Column("vsf", "1")))
    return np.column_stack([series.values for series in table.values()])


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_forms(tmp_path, text):
    file = tmp_path / "a.csv"
    file.write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(values_of(file), [[1.0, 2.0], [10.0, 0.5]])
    phase = mt.TabulatedPhase.from_file(file)
    assert phase == mt.TabulatedPhase(theta_deg=[1.0, 10.0], value=[2.0, 0.5])


@pytest.mark.parametrize(
    "content", [b"", b"1\n2\n", b"a,b\n", b"1,2\n3\n", b"1,2\n3,x\n", b"1,nan\n", b"\xff\xfe\x00"]
)
def test_refusals_are_one_line(tmp_path, content):
    file = tmp_path / "a.csv"
    file.write_bytes(content)
    for read in (values_of, mt.TabulatedPhase.from_file, TabulatedSpectrum.from_file):
        with pytest.raises(Refused, match="columns of numbers"):
            read(file)
    with pytest.raises(Refused, match="no such file"):
        values_of(tmp_path / "none.csv")


def test_phase_function_of_a_link_file(tmp_path):
    (tmp_path / "vsf.csv").write_text(FORMS["comma"])
    (tmp_path / "link.toml").write_text('[water.phase]\nkind = "tabulated"\nfile = "vsf.csv"\n')
    scenario = mt.Scenario.load(tmp_path / "link.toml")
    expected = mt.TabulatedPhase(theta_deg=[1.0, 10.0], value=[2.0, 0.5])
    assert scenario.link.water.phase == expected
    assert mt.Scenario.from_toml(scenario.to_toml()) == scenario  # without the file


def test_spectrum_over_frequency(tmp_path):
    """The table over f [Hz] is 2 pi times that over omega."""
    omega = np.linspace(0.5, 3.0, 26)
    density = 0.1 * np.exp(-((omega - 1.0) ** 2))
    (tmp_path / "omega.csv").write_text(
        "omega,S\n" + "\n".join(f"{w},{s}" for w, s in zip(omega, density, strict=True))
    )
    rows = zip(omega / (2.0 * np.pi), 2.0 * np.pi * density, strict=True)
    (tmp_path / "hz.csv").write_text("f [Hz];S(f)\n" + "\n".join(f"{f};{s}" for f, s in rows))
    one, two = (TabulatedSpectrum.from_file(tmp_path / f"{name}.csv") for name in ("omega", "hz"))
    np.testing.assert_allclose(two.omega, one.omega)
    np.testing.assert_allclose(two(omega), density)
    assert one.omega_p == pytest.approx(1.0)
    assert one(0.4) == one(3.1) == 0.0


def test_sea_of_a_tabulated_spectrum_has_its_variance(tmp_path):
    (tmp_path / "s.csv").write_text("omega,S\n0.5,0\n1.0,0.2\n2.0,0.02\n3.0,0\n")
    (tmp_path / "link.toml").write_text('[sea.spectrum]\nkind = "tabulated"\nfile = "s.csv"\n')
    sea = mt.Scenario.load(tmp_path / "link.toml").surface
    assert isinstance(sea, SpectralSea)
    sea = sea.replace(waves=sea.band.replace(omega_min=0.5, omega_max=3.0))
    area = 0.05 + 0.11 + 0.01  # of the trapezoids
    variance = 0.5 * (sea.components.amplitude**2).sum()
    assert variance == pytest.approx(area, rel=1e-3)


def test_directional_table(tmp_path):
    """Rows over f [Hz], columns over the direction from which the waves come."""
    directions = np.arange(0.0, 360.0, 30.0)
    efth = np.outer([1.0, 2.0, 1.0], 1.0 + np.cos(np.radians(directions - 90.0))) * 1e-3
    head = "f;" + ";".join(f"{d:g}" for d in directions)
    rows = [f"{f};" + ";".join(map(str, r)) for f, r in zip((0.1, 0.2, 0.3), efth, strict=True)]
    (tmp_path / "e.csv").write_text("\n".join([head, *rows]))
    sea = from_wavespectra(tmp_path / "e.csv", mss="band")
    assert isinstance(sea, MeasuredSea)
    assert np.sum(sea.variance) == pytest.approx(efth.sum() * 0.1 * 30.0)
    link = '[sea]\nspectrum = "measured"\nfile = "e.csv"\nmss = "band"\n'
    (tmp_path / "link.toml").write_text(link)
    assert mt.Scenario.load(tmp_path / "link.toml").surface.variance == sea.variance
    (tmp_path / "link.toml").write_text(link + "sites = 3\n")
    with pytest.raises(Refused, match="did you mean site"):
        mt.Scenario.load(tmp_path / "link.toml")
    (tmp_path / "bad.csv").write_text("0.1,1\n0.2,1\n")
    with pytest.raises(Refused, match="a header with a direction"):
        from_wavespectra(tmp_path / "bad.csv")
