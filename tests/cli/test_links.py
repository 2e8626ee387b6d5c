"""Commands that write and compare link files, and draw results."""

import re
import tomllib

import pytest
from command_line import meshtrace, refusal

import meshtrace as mt
from meshtrace import results


def test_new_prints_a_file_that_loads_back(tmp_path):
    printed = meshtrace("new", "--wind", "8", "--set", "receiver.height=7")
    assert printed.exit_code == 0
    scenario = mt.Scenario.from_toml(printed.stdout)
    assert (scenario.wind_speed, scenario.link.receiver.height) == (8.0, 7.0)
    assert scenario == mt.Scenario.from_toml("wind_speed = 8\n[receiver]\nheight = 7")
    assert "depth = 10.0  # Depth below still water [m]" in printed.stdout


def test_new_shows_keys_and_tables_that_are_not_set(tmp_path):
    printed = meshtrace("new").stdout
    for line in ('# type = "jerlov-IB"', '# spectrum = "measured"', '# waves = "fading"'):
        assert f"\n{line}" in printed
    unset = printed[printed.index("# [detector]") :]
    tables = re.findall(r"^# \[(.+)\]$", unset, re.MULTILINE)
    assert {"detector.optics", "uav", "daylight", "sweep", "sweep.parameters"} <= set(tables)
    config = tomllib.loads(re.sub(r"^# ?", "", unset, flags=re.MULTILINE))
    assert set(config.pop("sweep")) >= {"realizations", "rtol", "parameters"}
    for table, key in (
        ("led", "spectrum"),
        ("optics", "filter_center_nm"),
        ("optics", "filter_index"),
    ):
        del config["detector"][table][key]  # examples, not defaults
    for name in ("detector", "uav"):
        assert mt.Scenario.from_config({name: config[name]}) == mt.Scenario.from_config({name: {}})
    known = {"sun_zenith_deg", "sun_azimuth_deg", "aerosol", "ozone", "day_of_year"}
    clear = {key: config["daylight"][key] for key in known}
    assert mt.Scenario.from_config({"daylight": clear}) == mt.Scenario.from_toml("[daylight]")
    again = mt.Scenario.from_toml("[detector]\n[uav]").to_toml(notes=True)
    assert "\n[detector.optics]\n" in again
    assert "# [uav]" not in again


def test_compare(tmp_path):
    for name, height in (("low", 5), ("high", 8)):
        (tmp_path / f"{name}.toml").write_text(f"[receiver]\nheight = {height}\n")
    low, high, file = tmp_path / "low.toml", tmp_path / "high.toml", tmp_path / "c.nc"
    done = meshtrace("compare", low, high, "--photons", 64, "-o", file, "--wind", 2)
    assert done.exit_code == 0, done.stderr
    found = results.load(file)
    assert found.names == ("low", "high")
    assert found.summary() in done.stdout
    assert found.provenance[0]["link"]["whitecaps"]["wind_speed"] == 2.0
    alone = "links: ['low'], allowed: a mapping of two or more names to links"
    assert refusal("compare", low) == alone
    assert "files of different names" in refusal("compare", low, low)


def test_coverage_and_plot(tmp_path):
    file, picture = tmp_path / "map.nc", tmp_path / "map.png"
    done = meshtrace("coverage", "--photons", 2000, "--extent", 2, "--step", 1, "-o", file,
                     "--plot", picture)  # fmt: skip
    assert done.exit_code == 0, done.stderr
    found = results.load(file)
    assert found.gain.shape == (4, 4)
    assert found.summary() in done.stdout
    again = tmp_path / "again.png"
    assert meshtrace("plot", file, "-o", again).exit_code == 0
    assert again.read_bytes()[:4] == picture.read_bytes()[:4] == b"\x89PNG"
    assert "a file ." in refusal("plot", file, "-o", tmp_path / "a.xyz")
    assert "undamaged" in refusal("plot", tmp_path / "none.nc")


def test_coverage_to_a_tolerance(tmp_path):
    file = tmp_path / "map.nc"
    done = meshtrace("coverage", "--rtol", 0.05, "--extent", 0.2, "--step", 0.1, "-o", file,
                     "--wind", 0)  # fmt: skip
    assert done.exit_code == 0, done.stderr
    found = results.load(file)
    assert found.provenance["unscattered"] == "image"
    assert (found.gain_stderr <= 0.05 * found.gain).all()
    assert "rtol: -1.0, allowed: > 0" in refusal("coverage", "--rtol", -1)


@pytest.mark.parametrize("command", ["run", "series", "ensemble", "ber", "compare", "coverage"])
def test_common_options(command):
    text = meshtrace(command, "--help").stdout
    for option in ("--wind", "--set", "--seed", "--threads", "--photons", "--output"):
        assert option in text


def test_completion():
    assert "--install-completion" in meshtrace("--help").stdout


def test_names_of_files_are_drawn_as_they_stand(tmp_path):
    """A name with an odd number of dollars once ended in a traceback, after the work."""
    files = [tmp_path / name for name in ("$x^{2$.toml", "$a$.toml")]
    for file in files:
        file.write_text("[sea]\nspectrum = 'flat'\n")
    picture = tmp_path / "a.png"
    done = meshtrace("compare", *files, "--photons", 64, "--plot", picture)
    assert (done.exit_code, done.stderr) == (0, "")
    assert picture.read_bytes()[:4] == b"\x89PNG"
