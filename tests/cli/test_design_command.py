"""The command design: page, file, picture, refusals."""

import re

import pytest
from command_line import meshtrace, refusal

import meshtrace as mt

LINK = """
wind_speed = 0.0
[receiver]
fov_deg = 30.0
[detector]
bit_rate = 1e6
[daylight]
direct = 1.42
diffuse = 0.295
"""
PARTS = ("ANSWER", "FIGURES", "LENS, FIELD OF VIEW AND FILTER TOGETHER", "BEST VALUES BY NIGHT",
         "BEST VALUES BY DAY", "JUST CLOSES", "BUDGET", "WATER AND NOTES")  # fmt: skip


def test_design_prints_a_page_and_writes_it(golden, tmp_path, monkeypatch, calm_design):
    """The study is that of the library, and not run here."""
    path, out, picture = tmp_path / "link.toml", tmp_path / "d.nc", tmp_path / "d.png"
    path.write_text(LINK)
    calls = []

    def study(scenario, **options):
        calls.append((scenario, options))
        return calm_design

    monkeypatch.setattr(mt, "design", study)
    text = meshtrace(
        "design", path, "--photons", "32", "-n", "9", "-o", out, "--plot", picture
    ).stdout
    ((scenario, options),) = calls
    assert scenario == mt.Scenario.load(path)
    assert callable(options.pop("progress"))
    expected = {"photons": 32, "realizations": 9, "outage": 0.01, "limit": 0.001}
    expected |= {"combining": "maximal", "bounds": None, "store": None, "workers": None}
    assert options == expected
    places = [text.index(part) for part in PARTS]
    assert places == sorted(places)
    page = mt.Design.load(out)
    assert page.summary() in text
    assert "water: a 0.114, b 0.037 m-1 at 470 nm: petzold-clear" in text
    assert picture.stat().st_size > 10_000
    golden("design", page.summary())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--bounds", "receiver.fov=1,2"), "did you mean receiver.*fov_deg"),
        (("--bounds", "receiver.fov_deg=60"), "KEY=LOW,HIGH"),
        (("--outage", "2"), "--outage: 2"),
        (("-n", "3"), "--realizations: 3"),
        (("--set", "detector.bitrate=3"), "did you mean bit_rate"),
    ],
)
def test_refusals(words, message):
    assert re.search(message, refusal("design", "--set", "sea.spectrum=flat", *words))
