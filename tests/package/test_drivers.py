"""Examples that hand a trace to other programs: what they write is read back."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from meshtrace.comms import OokLink
from meshtrace.comms.budget import ber_of_gains

DRIVERS = Path(__file__).parents[2] / "examples" / "drivers"
RATE = 50.0


@pytest.fixture
def trace(tmp_path, monkeypatch):
    """Return a trace of weak gains, also in a file of the working folder."""
    monkeypatch.chdir(tmp_path)
    link = OokLink()
    smooth = np.convolve(np.random.default_rng(1).normal(size=2015), np.hanning(16) / 2.5, "valid")
    needed = link.required_power(1e-4) / float(link.received_power(1.0))
    gain = needed * np.exp(0.4 * smooth)
    time = np.arange(gain.size) / RATE
    columns = {"gain": ("time", gain), "background": ("time", 1e-9 * (1.0 + time))}
    found = xr.Dataset({**columns, "omega_max": 20.0}, coords={"time": time})
    found.to_netcdf("trace.nc", engine="h5netcdf")
    return found


@pytest.fixture
def run(monkeypatch, capsys):
    """Return a function that runs a driver on the trace and returns its output and names."""

    def driver(name, *targets):
        monkeypatch.setattr(sys, "argv", [name, "trace.nc", *targets])
        names = runpy.run_path(str(DRIVERS / name), run_name="__main__")
        return capsys.readouterr().out, names

    return driver


def test_examples_are_short():
    long = {p.name for p in DRIVERS.glob("*.py") if len(p.read_text("utf-8").splitlines()) >= 40}
    assert long <= {"modem.py"}


def test_csv(trace, run):
    run("to_csv.py", "trace.csv")
    header, *_ = Path("trace.csv").read_text().splitlines()
    assert header == "time,gain,background"
    table = np.loadtxt("trace.csv", delimiter=",", skiprows=1)
    assert table[:, 1].tolist() == trace.gain.values.tolist()
    assert table[:, 0].tolist() == trace.time.values.tolist()


def test_matlab(trace, run):
    from scipy.io import loadmat

    run("to_matlab.py", "trace.mat")
    found = loadmat("trace.mat")
    assert found["gain"].shape == (trace.time.size, 1)
    for name in ("time", "gain", "background"):
        assert found[name][:, 0].tolist() == trace[name].values.tolist()
    assert "omega_max" not in found


def test_gnuradio(trace, run):
    assert "2000 values at 50 Hz" in run("to_gnuradio.py", "gain.f32")[0]
    found = np.fromfile("gain.f32", "<f4")
    assert Path("gain.f32").stat().st_size == 4 * trace.time.size
    assert found == pytest.approx((trace.gain / trace.gain.mean()).values, rel=1e-7)


def test_ns3(trace, run):
    run("to_ns3.py", "lost.txt", "per.csv")
    time, per = np.loadtxt("per.csv", delimiter=",", skiprows=1).T
    ber = ber_of_gains(OokLink(), trace.gain.values)
    assert time.tolist() == trace.time.values.tolist()
    assert per == pytest.approx(1.0 - (1.0 - ber) ** 8192, abs=1e-9)
    words = Path("lost.txt").read_text().split()
    assert all(word.isdecimal() for word in words)
    lost = np.array(words, dtype=int)
    sent = round(2.0 * trace.time.size)  # 100 a second, two of each step
    assert (np.diff(lost) > 0).all()
    assert 0 <= lost[0] < lost[-1] < sent
    share, error = lost.size / sent, np.sqrt((per * (1.0 - per)).mean() / sent)
    assert share == pytest.approx(per.mean(), abs=4.0 * error + 1.0 / sent)


def test_desert(trace, run):
    """The arguments in the order of mclink.cpp: ber_good ber_bad p_gb p_bg step_period state."""
    text = run("to_desert.py")[0].strip()
    head, numbers, state = text[: text.index("MCLINK") + 6], text.split()[4:9], text.split()[9]
    assert head == "set link [new Module/UW/HMMPHYSICAL/MCLINK"
    assert state == "GOOD]"
    good, bad, p_gb, p_bg, step = map(float, numbers)
    assert 0.0 <= good < bad <= 0.5
    assert step == pytest.approx(1.0 / RATE)
    ber = ber_of_gains(OokLink(), trace.gain.values).mean()
    assert (p_bg * good + p_gb * bad) / (p_bg + p_gb) == pytest.approx(ber, rel=0.02)


def test_sionna(trace, run):
    pytest.importorskip("sionna")
    text, names = run("to_sionna.py")
    assert "a (4, 1, 1, 1, 1, 1, 50), tau (4, 1, 1, 1)" in text
    windows = trace.gain.values.reshape(-1, 50)  # CIRDataset shuffles them
    for found in names["a"].numpy().reshape(4, 50):
        off = np.abs(found - windows).max(axis=1) / windows.mean()
        assert off.min() < 1e-6


@pytest.mark.slow
def test_modem(trace, run):
    pytest.importorskip("commpy")
    rows = [list(map(float, line.split())) for line in run("modem.py")[0].splitlines()[1:]]
    rows = np.array(rows)
    assert (np.diff(rows[:, 2]) <= 0.0).all()  # the formula falls with the margin
    assert rows[-1, 3] <= rows[0, 3]
    assert rows[-1, 1] < 0.2
    # no code of 128 bits is better than an ideal one, within four errors of 100 packets
    error = np.sqrt(np.maximum(rows[:, 2] * (1.0 - rows[:, 2]), 0.01) / 100.0)
    assert (rows[:, 1] > rows[:, 2] - 4.0 * error).all()


@pytest.mark.parametrize("name", sorted(p.name for p in DRIVERS.glob("*.py")))
def test_a_driver_without_files_says_what_it_needs(name, monkeypatch, capsys):
    if name == "to_sionna.py":
        pytest.importorskip("sionna")
    monkeypatch.setattr(sys, "argv", [name])
    with pytest.raises(SystemExit):
        runpy.run_path(str(DRIVERS / name), run_name="__main__")
    assert "the following arguments are required" in capsys.readouterr().err
