"""Lamps from IES and EULUMDAT files: read by hand-written files, sampled, and their light."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak

import meshtrace as mt
from meshtrace.engine import straight
from meshtrace.engine.setup import arrays, ends
from meshtrace.errors import Refused
from meshtrace.kernels import sources
from meshtrace.kernels.jit import entry
from meshtrace.kernels.tables import intensities
from meshtrace.link import AirMeasuredLamp, MeasuredLamp
from meshtrace.link.photometry import read_photometry
from meshtrace.scenario import Scenario

ORDER = 4.0
THETA = np.arange(0.0, 91.0, 1.0)


def ies(theta, azimuth, candela, tilt="NONE", numbers="1 1000 2.0", kind=1, units=2, ballast=0.5):
    """Return an IES file; `candela` has a row for each horizontal angle."""
    rows = "\n".join(" ".join(f"{x:.8g}" for x in row) for row in candela)
    angles = (" ".join(f"{x:g}" for x in a) for a in (theta, azimuth))
    return (f"IESNA:LM-63-2002\n[TEST] none\nTILT={tilt}\n{numbers} {len(theta)} {len(azimuth)} "
            f"{kind} {units} 0 0 0\n{ballast} 1 10\n" + "\n".join(angles) + f"\n{rows}\n")  # fmt: skip


def ldt(symmetry, azimuth, theta, rows, factor="2.0", tilt="0", lumens=500):
    """Return a EULUMDAT file with one set of lamps and decimal commas."""
    step = azimuth[1] - azimuth[0] if len(azimuth) > 1 else 0
    head = ["maker", "1", symmetry, len(azimuth), step, len(theta), theta[1] - theta[0], "", "lamp",
            "", "", "", *[0] * 9, 100, 100, factor, tilt, 1, 1, "LED", lumens, "", "", 10]  # fmt: skip
    numbers = [*[0.5] * 10, *azimuth, *theta, *np.ravel(rows)]
    return "\n".join(map(str, [*head, *(f"{x:.8g}".replace(".", ",") for x in numbers)]))


def written(tmp_path, text, name="lamp.ies"):
    (tmp_path / name).write_text(text, encoding="latin-1")
    return str(tmp_path / name)


def lobed(theta, azimuth):
    """Return an intensity without any symmetry: rows by azimuth [deg]."""
    t, c = np.radians(theta)[None, :], np.radians(azimuth)[:, None]
    return np.cos(t) ** 2 * (2.0 + np.cos(c) + 0.5 * np.sin(c) + 0.3 * np.sin(2.0 * c))


def test_intensities_have_both_factors_of_the_file(tmp_path):
    text = ies(THETA, [0.0], np.cos(np.radians(THETA))[None] * 10.0)
    lamp = read_photometry(written(tmp_path, text))
    assert lamp.intensity[60] == pytest.approx([5.0, 5.0])
    # a Lambertian lamp of 10 cd sends pi 10 lm
    assert lamp.flux == pytest.approx(10.0 * math.pi, rel=2e-4)


SYMMETRIC = {  # the given planes of each symmetry, and whether C -> -C and C -> 180 - C are the same
    "0": (np.arange(0.0, 360.0, 30.0), lambda c: lobed(THETA, c)),
    "2": (np.arange(0.0, 181.0, 30.0), lambda c: lobed(THETA, np.where(c > 180.0, 360.0 - c, c))),
    "3": (np.arange(-90.0, 91.0, 30.0),
          lambda c: lobed(THETA, (np.where((c > 90.0) & (c < 270.0), 180.0 - c, c)) % 360.0)),
    "4": (np.arange(0.0, 91.0, 30.0), lambda c: lobed(THETA, 90.0 - np.abs(90.0 - c % 180.0))),
}  # fmt: skip


@pytest.mark.parametrize("symmetry", SYMMETRIC)
def test_planes_of_every_symmetry_fill_the_circle(symmetry, tmp_path):
    planes, of = SYMMETRIC[symmetry]
    whole = np.arange(0.0, 360.0, 30.0)
    text = ldt(symmetry, whole, THETA, of(planes % 360.0))
    lamp = read_photometry(written(tmp_path, text, "lamp.LDT"))
    np.testing.assert_allclose(np.degrees(lamp.azimuth), [*whole, 360.0])
    # per 1000 lm: 500 lm with the factor 2 leave it as it is
    np.testing.assert_allclose(lamp.intensity[:, :-1].T, of(whole), rtol=1e-6, atol=1e-8)
    np.testing.assert_array_equal(lamp.intensity[:, 0], lamp.intensity[:, -1])
    if symmetry != "0":
        given = np.sort(planes % 360.0) if symmetry != "3" else np.arange(90.0, 271.0, 30.0)
        same = read_photometry(written(tmp_path, ies(THETA, given, of(given), ballast=0.5)))
        np.testing.assert_allclose(same.intensity, lamp.intensity, rtol=1e-6, atol=1e-8)


def test_a_lamp_symmetric_about_its_axis_has_one_plane(tmp_path):
    row = np.cos(np.radians(THETA))
    one = ldt(1, np.arange(0.0, 360.0, 15.0), THETA, row)
    lamp = read_photometry(written(tmp_path, one, "lamp.ldt"))
    assert lamp.intensity.shape == (91, 2)
    np.testing.assert_allclose(lamp.intensity[:, 0], row, rtol=1e-6, atol=1e-8)


ROW = np.ones((1, 3))
WRONG = {
    "type B": (ies([0, 45, 90], [0], ROW, kind=2), "photometric type: '2'"),
    "units": (ies([0, 45, 90], [0], ROW, units=3), "units type"),
    "file of tilts": (ies([0, 45, 90], [0], ROW, tilt="a.tlt"), "TILT: 'a.tlt'"),
    "no tilt": ("IESNA:LM-63-2002\n1 2 3", "TILT"),
    "multiplier": (ies([0, 45, 90], [0], ROW, numbers="1 1000 -1"), "multiplier"),
    "short": (ies([0, 45, 90], [0], ROW)[:-5], "end of file"),
    "long": (ies([0, 45, 90], [0], ROW) + " 3", "more numbers"),
    "negative": (ies([0, 45, 90], [0], -ROW), "intensities"),
    "dark": (ies([0, 45, 90], [0], 0 * ROW), "intensities"),
    "angles": (ies([0, 90, 45], [0], ROW), "vertical angles"),
    "half a circle": (ies([0, 45, 90], [0, 120], np.ones((2, 3))), "horizontal angles"),
    "Isym": (ldt(5, [0, 90, 180, 270], [0, 45, 90], ROW), "Isym"),
    "planes": (ldt(4, [0, 90, 180], [0, 45, 90], ROW), "C-planes"),
    "lines": ("a\nb", "EULUMDAT"),
    "tilted": (ldt(1, [0, 180], [0, 45, 90], ROW, tilt="15"), "tilt of luminaire"),
    "factor": (ldt(1, [0, 180], [0, 45, 90], ROW, factor="0"), "conversion factor"),
}


@pytest.mark.parametrize("case", WRONG)
def test_other_files_are_refused(case, tmp_path):
    text, named = WRONG[case]
    path = written(tmp_path, text, "lamp.ies" if text.startswith("IESNA") else "lamp.ldt")
    with pytest.raises(Refused) as caught:
        MeasuredLamp(file=path)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(Refused, match=r"none\.ies"):
        MeasuredLamp(file=str(tmp_path / "none.ies"))


def test_factors_by_the_tilt_leave_the_pattern(tmp_path):
    row = np.cos(np.radians(THETA))[None]
    text = ies(THETA, [0.0], row).replace("TILT=NONE", "TILT=INCLUDE\n1\n3\n0 45 90\n1 0.9 0.8")
    assert read_photometry(written(tmp_path, text)).intensity[:, 0] == pytest.approx(row[0])


# --- its light -----------------------------------------------------------------------------


@entry
def drawn(table, seed, out):
    for i in range(len(out)):
        _, d, _, _ = sources.launch(table, seed, i)
        out[i, 0], out[i, 1], out[i, 2] = d.x, d.y, d.z


@pytest.fixture
def lobes(tmp_path):
    azimuth = np.arange(0.0, 361.0, 30.0)
    return written(tmp_path, ies(THETA, azimuth, lobed(THETA, azimuth)))


def directions_of(lamp, n=200_000):
    link = mt.Link(
        transmitter=lamp,
        receiver=mt.WaterReceiver(depth=1.0) if lamp.kind[0] == "a" else mt.Receiver(),
    )
    out = np.empty((n, 3))
    drawn(arrays.source_arrays(link, 1.0), np.uint64(5), out)
    return out


@pytest.mark.parametrize(
    ("kind", "turned"),
    [(AirMeasuredLamp, {}), (AirMeasuredLamp, {"tilt_deg": 40.0, "tilt_azimuth_deg": 30.0}),
     (MeasuredLamp, {"zenith_deg": 30.0, "roll_deg": 50.0})],
)  # fmt: skip
def test_directions_have_the_density_of_the_table(kind, turned, lobes):
    """Chi-square over 12 x 20 cells of azimuth and s = sin^2(theta / 2), of equal solid angle."""
    lamp = kind(file=lobes, **turned)
    d, axis = directions_of(lamp), np.array(lamp.axis)
    e1, e2 = lamp.sides
    assert abs(np.array([e1 @ e2, e1 @ axis, e2 @ axis])).max() < 1e-14
    s = 0.5 * (1.0 - d @ axis)
    azimuth = np.arctan2(d @ e2, d @ e1) % (2.0 * np.pi)
    cells, edges = (12, 20), (np.linspace(0.0, 2.0 * np.pi, 13), np.linspace(0.0, 0.5, 21))
    counts = np.histogram2d(azimuth, s, edges)[0]
    assert counts.sum() > 0.999 * len(d)  # all but those of the half degree beyond the last angle
    # the table itself is linear in the azimuth between the planes of the file
    fine_c, fine_s = (np.arange(720) + 0.5) / 2.0, (np.arange(400) + 0.5) / 800.0
    theta = np.degrees(2.0 * np.arcsin(np.sqrt(fine_s)))
    planes = np.arange(0.0, 361.0, 30.0)
    rows = lobed(THETA, planes)
    at_theta = np.array([np.interp(theta, THETA, row) for row in rows])
    density = np.array([np.interp(fine_c, planes, column) for column in at_theta.T]).T
    expected = density.reshape(cells[0], 60, cells[1], 20).sum(axis=(1, 3))
    assert chi2_test(counts.ravel(), expected.ravel() / expected.sum()) > sidak(ALPHA, 3)


def test_the_plane_c0_lies_along_x_and_c90_along_y_from_a_lamp_that_shines_down(lobes):
    e1, e2 = AirMeasuredLamp(file=lobes).sides
    np.testing.assert_allclose(e1, [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(e2, [0.0, 1.0, 0.0], atol=1e-15)
    e1, e2 = MeasuredLamp(file=lobes).sides
    np.testing.assert_allclose(e1, [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(e2, [0.0, -1.0, 0.0], atol=1e-15)


@pytest.fixture
def lambertian(tmp_path):
    """Return the file of a lamp cos^4(theta), whose kind `Led` has it in closed form."""
    row = 100.0 * np.cos(np.radians(THETA)) ** ORDER
    return written(tmp_path, ies(THETA, [0.0], row[None]))


HALF = math.degrees(math.acos(0.5 ** (1.0 / ORDER)))
SEA = mt.JonswapSea(wind_speed=5.0)
LINKS = {
    "up": (MeasuredLamp, mt.Led, {"depth": 5.0}, mt.Receiver(radius=0.2, fov_deg=60.0)),
    "down": (AirMeasuredLamp, mt.AirLed, {"height": 5.0}, mt.WaterReceiver(depth=4.0, radius=0.2)),
}


@pytest.mark.parametrize("name", LINKS)
def test_a_measured_lambertian_lamp_has_the_gain_of_an_led(name, lambertian):
    measured, led, place, receiver = LINKS[name]
    gains = [
        mt.simulate(mt.Link(transmitter=lamp, receiver=receiver), SEA, photons=512)
        for lamp in (measured(file=lambertian, **place), led(half_angle_deg=HALF, **place))
    ]
    assert gains[0].gain > 0.0
    error = math.hypot(gains[0].gain_stderr, gains[1].gain_stderr)
    # linear interpolation over 1 degree raises cos^4 by 1e-4
    assert abs(gains[0].gain - gains[1].gain) < 4.0 * error + 5e-4 * gains[1].gain


@pytest.mark.parametrize("estimator", ["forced", "analog"])
def test_the_light_on_either_side_is_that_of_its_plane(estimator, lobes):
    """Over still water without scattering C0, towards +x, has 3 times the light of C180."""
    water, lamp = mt.Water(a=0.1, b=0.0), MeasuredLamp(file=lobes, depth=5.0)
    ends_of = [mt.Receiver(position=(x, 0.0), radius=0.3, fov_deg=180.0) for x in (6.0, -6.0)]
    link = mt.Link(water=water, transmitter=lamp, receiver=tuple(ends_of))
    photons = 128 if estimator == "forced" else 1_000_000
    result = mt.simulate(link, mt.surfaces.FlatSea(), estimator, photons=photons)
    error = np.hypot(*(result.gain_stderr / result.gain))
    bright, faint = result.gain
    assert error < 0.1
    # 0.3 m at 11 m is 1.5 degrees to either side, whose mean in C is linear but for 1e-2
    assert abs(bright / faint / 3.0 - 1.0) < 0.01 + 4.0 * error


def test_straight_light_is_that_of_an_led(lambertian):
    place = {"depth": 20.0, "zenith_deg": 90.0}
    end = mt.WaterReceiver(
        depth=19.0, position=(8.0, 1.0), radius=0.5, tilt_deg=90.0, tilt_azimuth_deg=180.0
    )
    gains = []
    for lamp in (MeasuredLamp(file=lambertian, **place), mt.Led(half_angle_deg=HALF, **place)):
        forced = ends.forced_link(mt.Link(transmitter=lamp, receiver=end))
        gains.append(straight.straight_gains(forced, None, forced.medium, 0, 0)[0])
    assert gains[0] == pytest.approx(gains[1], rel=1e-3)


def test_a_link_file_names_the_lamp_relative_to_itself(lobes, tmp_path):
    text = '[transmitter]\nkind = "measured-lamp"\nfile = "lamp.ies"\nroll_deg = 20.0\n'
    (tmp_path / "link.toml").write_text(text)
    scenario = Scenario.load(tmp_path / "link.toml")
    assert scenario.link.transmitter == MeasuredLamp(file=lobes, roll_deg=20.0)
    assert Scenario.from_toml(scenario.to_toml()) == scenario


def test_the_emitter_has_the_intensity_of_the_file(lobes):
    lamp = AirMeasuredLamp(file=lobes)
    emitter = ends.emitter_of(lamp)
    theta, azimuth = np.radians([0.0, 30.0, 45.0, 80.0]), np.radians([0.0, 60.0, 210.0, 330.0])
    ways = np.stack(
        [np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), -np.cos(theta)]
    )
    out = np.empty(4)
    intensities(
        emitter.table, np.ascontiguousarray(ways.T), emitter.axis, emitter.e1, emitter.e2, out
    )
    at = [
        lobed(np.degrees([t]), np.degrees([c]))[0, 0] for t, c in zip(theta, azimuth, strict=True)
    ]
    np.testing.assert_allclose(out, np.array(at) / lamp.photometry.flux, rtol=1e-7)
