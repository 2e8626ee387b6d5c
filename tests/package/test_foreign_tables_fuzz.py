"""Random forms of known tables: each is read with its right values, or refused."""

import itertools
import random

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.comms import SiPM
from meshtrace.errors import Refused
from meshtrace.optics.water_files import read_spectrum
from meshtrace.surfaces import TabulatedSpectrum, gauge_spectrum

TIME = np.arange(0.0, 60.0, 0.05)
ETA = 0.01 * np.cos(5.0 * TIME) + 0.006 * np.cos(8.0 * TIME + 1.0)
OMEGA = np.linspace(0.4, 3.0, 20)
DENSITY = 0.1 * np.exp(-6.0 * (OMEGA - 1.0) ** 2)
THETA = np.linspace(1.0, 180.0, 30)
PHASE = 1.0 / (1.01 - np.cos(np.radians(THETA))) ** 1.5
NM, PDE = np.linspace(400.0, 700.0, 7), np.array([0.1, 0.2, 0.3, 0.35, 0.3, 0.2, 0.1])
DEPTH, WAVELENGTH = np.repeat([0.0, 5.0], 3), np.tile([450.0, 500.0, 550.0], 2)
A, B = np.linspace(0.05, 0.3, 6), np.linspace(0.1, 0.5, 6)

# names, and units with the factor of the values in them; None: to be refused
NAMES = {
    "t": ["time", "t", "Time", "TIME", "elapsed time"],
    "eta": ["eta", "elevation", "WG1", "z", "η", "surface elevation", "Probe 1", "wg_2"],
    "f": ["f", "freq", "Frequency"],
    "S": ["S", "S(f)", "E", "psd", "spectral density"],
    "omega": ["omega", "w", "ω", "angular frequency"],
    "D": ["S", "S(ω)", "E", "density", "S(omega)"],
    "theta": ["theta", "angle", "θ", "scattering angle"],
    "p": ["p", "vsf", "VSF", "beta", "value", "whatever", "P11"],
    "nm": ["wavelength", "lambda", "λ", "wl"],
    "pde": ["pde", "PDE", "EQE", "value", "T", "trans"],
    "depth": ["depth", "z", "Depth"],
    "a": ["a", "absorption"],
    "b": ["b", "scattering"],
}
UNITS = {
    "t": {None: 1.0, "s": 1.0, "sec": 1.0},
    "eta": {None: 1.0, "m": 1.0, "mm": 1e3, "cm": 1e2, "ft": 1.0 / 0.3048, "um": 1e6, "dbar": None, "V": None},
    "f": {None: 1.0, "Hz": 1.0, "hz": 1.0, "mHz": 1e3, "1/s": 1.0},
    "S": {None: 1.0, "m2/Hz": 1.0, "m²/Hz": 1.0, "m2 s": 1.0, "cm2/Hz": 1e4, "m2 s rad-1": 0.5 / np.pi, "m2": None, "m2/Hz/deg": None},
    "omega": {None: 1.0, "rad/s": 1.0, "rad s-1": 1.0, "1/s": 1.0, "deg/s": 180.0 / np.pi},
    "D": {None: 1.0, "m2 s rad-1": 1.0, "m2 s": 1.0, "cm2 s rad-1": 1e4, "m2/Hz": 2.0 * np.pi, "dB": None},
    "theta": {None: 1.0, "deg": 1.0, "degrees": 1.0, "°": 1.0, "rad": np.pi / 180.0, "m": None},
    "p": {None: 1.0, "sr-1": 1.0, "m-1 sr-1": 1.0, "a.u.": 1.0, "1/rad": None},
    "nm": {None: 1.0, "nm": 1.0, "um": 1e-3, "µm": 1e-3, "m": 1e-9, "angstrom": 10.0, "cm-1": None, "eV": None},
    "pde": {None: 1.0, "1": 1.0, "%": 100.0, "percent": 100.0, "A/W": None, "dB": None},
    "depth": {None: 1.0, "m": 1.0, "cm": 100.0, "dbar": None},
    "a": {None: 1.0, "1/m": 1.0, "m-1": 1.0, "m⁻¹": 1.0, "cm-1": 0.01, "m-1 sr-1": None},
    "b": {None: 1.0, "1/m": 1.0, "m^-1": 1.0, "1/cm": 0.01},
}  # fmt: skip


def spectrum(path):
    found = TabulatedSpectrum.from_file(path)
    return found.omega, found.density


def phase(path):
    found = mt.TabulatedPhase.from_file(path)
    return found.theta_deg, found.value


def curve(path):
    found = SiPM(pde={"file": str(path)}).pde
    return found.wavelength_nm, found.value


def hs(source):
    return (gauge_spectrum(source, spreading="cos2s").hs,)


TABLES = {
    "gauge": (hs, {"t": TIME, "eta": ETA}, hs(np.column_stack([TIME, ETA]))),
    "f": (spectrum, {"f": OMEGA / 2.0 / np.pi, "S": 2.0 * np.pi * DENSITY}, (OMEGA, DENSITY)),
    "omega": (spectrum, {"omega": OMEGA, "D": DENSITY}, (OMEGA, DENSITY)),
    "phase": (phase, {"theta": THETA, "p": PHASE}, (THETA, PHASE)),
    "curve": (curve, {"nm": NM, "pde": PDE}, (NM, PDE)),
    "water": (
        lambda path: np.transpose(read_spectrum(path).table),
        {"depth": DEPTH, "nm": WAVELENGTH, "a": A, "b": B},
        (DEPTH, WAVELENGTH, A, B),
    ),
}


def write(rng, table):
    """Return a text of a table, and whether it has to be refused."""
    form = rng.choice([" [{}]", " ({})", "_{}", " {}", "/{}", " in {}", "({})", "below"])
    headings, units, columns, bad = [], [], [], False
    for key, values in rng.sample(list(table.items()), len(table)):
        unit, factor = rng.choice(list(UNITS[key].items()))
        bad |= factor is None
        name = rng.choice(NAMES[key])
        headings.append(name if unit is None or form == "below" else name + form.format(unit))
        units.append(unit or "")
        columns.append(values * (factor or 1.0))
    separator = rng.choice([",", ";", "\t", " "])
    comma = separator in ";\t" and rng.random() < 0.4
    body = [
        [f"{x:.12g}".replace(".", "," if comma else ".") for x in row]
        for row in zip(*columns, strict=True)
    ]
    index = rng.choice([None, None, "", "index", "no name"])
    if index is not None:
        body = [[str(i), *row] for i, row in enumerate(body)]
        headings = headings if index == "no name" else [index, *headings]
        units = ["", *units]
    if rng.random() < 0.1:
        row = rng.choice(body)
        change = rng.choice([list.pop, lambda r: r.append("7"), lambda r: r.__setitem__(-1, "x")])
        change(row)
        bad = True

    def line(words):
        quoted = [f'"{w}"' if separator == " " and (" " in w or not w) else w for w in words]
        return separator.join(quoted)

    sign = rng.choice(["", "", "# "]) if index is None else ""
    lines = [sign + line(headings)]
    if form == "below" and any(units):
        lines.append(sign + line(units[-len(headings) :]))
    end = separator if separator != " " and rng.random() < 0.2 else ""
    lines += [line(row) + end for row in body]
    text = rng.choice(["\n", "\r\n"]).join(lines) + rng.choice(["", "\n", "\n\n"])
    return rng.choice(["", "", "\ufeff"]) + text, bad


@pytest.mark.thorough
@pytest.mark.drill
def test_random_forms_are_read_right_or_refused(tmp_path):
    rng, right, refused = random.Random(20), 0, 0
    for kind in itertools.islice(itertools.cycle(TABLES), 300):
        read, table, expected = TABLES[kind]
        text, bad = write(rng, table)
        (tmp_path / "x.csv").write_text(text, encoding="utf-8", newline="")
        try:
            values = read(tmp_path / "x.csv")
        except (Refused, ValueError) as error:
            assert "\n" not in str(error), text
            refused += not bad
            continue
        assert not bad, text
        for found, wanted in zip(values, expected, strict=True):
            np.testing.assert_allclose(found, wanted, rtol=1e-6, err_msg=text)
        right += 1
    assert right > 3 * refused  # good ones that are refused
