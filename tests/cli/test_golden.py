"""Texts of the command line, kept in tests/cli/golden.

`pytest tests/cli --update-golden` replaces them: read the difference before it is committed.
"""

import re
import shlex

import pytest
from command_line import meshtrace, refusal
from typer.main import get_command

from meshtrace import cli
from meshtrace.surfaces import FlatSea

COMMANDS = sorted(get_command(cli.app).commands)

OUTPUTS = {
    "run": "run --photons 1000",
    "run-analog": "run --estimator analog --photons 20000 --set receiver.radius=3",
    "run-dark": "run --estimator analog --photons 30",
    "run-receivers": "run two.toml --photons 300",
    "series": "series --times 0:2:0.5 --photons 256",
    "ensemble": "ensemble -n 6 --photons 256",
    "lidar": "lidar --seas 2 --photons 256",
    "traces": "traces --hours 2e-4 --rate 10 --photons 64",
    "ber": "ber --wind 0,13 -n 3 --bit-rates 1e6,5e6 --photons 256",
    "ber-ranges": "ber --preset paper-ranges --wind 0 --depths 45:55:5 --bit-rates 1e6 --photons 256",
    "converge": "converge --spacings 4,3,2,1 --normals vertex --photons 32 --placements 2",
    "water-given": "water",
    "water-type": "water --type coastal",
    "water-constituents": "water --chlorophyll 0.5 --cdom 0.02 --minerals 1 --wavelengths 450:650:50",
}

REFUSED_FILES = [
    "[transmitter]\ndepth = -3.0",
    "[receiver]\nheight = -0.5",
    '[sea]\nwaves = "paper"\n[receiver]\nheight = 0.1',
    "[receiver]\nfov_deg = 181",
    "[water]\na = nan",
    "wind_speed = inf",
    "wind_speed = 5.0\n[sea\n",
    '[sea]\nmesh = "none.ply"',
    "[transmitter]\ndepht = 3.0",
    "detector = 3",
    "[detector]\nbitrate = 3.0",
    "[detector]\nbit_rate = -3.0",
    "[detector]\nwindow = 1.0",
    "[detector.led]\npower = -1.0",
    "[detector]\nled = 3",
    "[uav]\nmass = true",
]

REFUSED_COMMANDS = """\
fly
--fast
run none.toml
run --photons 0
run --photons many
run --estimator guess
run --set depth
run --set water.a=nan
run --set sea.spectrum=flatt
run --set sea.spacing=1e-4
run -o none/out.nc
run -o .
validate --suite sea
validate --suite measured --case none
validate --output table.csv
run --wind fast
ber --wind x
ber --depths 9:1:1
ber --depths 1:2:nan
ber --depths -5:5:5
ber --bit-rates 0
ber --limit 0.7
ber --uav kite
ber --preset papr
ber --coupled
design --set run.estimator=analog
ensemble --set sea.spectrum=flat
series --set sea.time=3
series --times 0:1:0
water --type jerlow
water --chlorophyll 30
water --type coastal --wavelengths 600
water --file none.csv
water --wavelengths 450,550
water --type II --set water.a=0.1
view gone.toml --html a.html
view gone.nc --html a.html
view small.ply --set wind_speed=3 --html a.html
view small.ply --map 9 --html a.html
view --screenshot a.jpg
view --html gone/a.html
view --movie a.avi
view --html a.html --color depth
view --html a.html --extent nan
view --html a.html --spacing 1e-9
view --html a.html --paths -1
sweep none.toml
validate --fast
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Start in a folder with a link file and a mesh."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "two.toml").write_text("[[receiver]]\n[[receiver]]\nheight = 1.0\n")
    FlatSea().mesh(extent=5.0, spacing=1.0).to_trimesh().export(tmp_path / "small.ply")


@pytest.mark.parametrize("command", ["meshtrace", *COMMANDS])
def test_help(golden, command):
    shown = meshtrace(*(() if command == "meshtrace" else (command,)), "--help")
    assert (shown.exit_code, shown.stderr) == (0, "")
    golden(f"help-{command}", shown.stdout, numbers=True)


@pytest.mark.parametrize("name", OUTPUTS)
def test_output(golden, name):
    shown = meshtrace(*shlex.split(OUTPUTS[name]))
    assert (shown.exit_code, shown.stderr) == (0, "")
    golden(name, shown.stdout)


def test_measured_against_computed(golden):
    shown = meshtrace(*shlex.split("validate --suite measured --case hu"))
    assert (shown.exit_code, shown.stderr) == (0, "hu\n")
    golden("validate-measured", shown.stdout)


def without_own_parts(text):
    """Leave out the parts that other tests of the process have registered."""
    return re.sub(r", \w+:\w+(?=,|\n| or )", "", text)


def test_refused_link_files(golden, tmp_path):
    shown = []
    for text in REFUSED_FILES:
        (tmp_path / "link.toml").write_text(text)
        shown.append(f"{text}\n    error: {refusal('run', 'link.toml')}\n")
    golden("refused-files", without_own_parts("\n".join(shown)), numbers=True)


def test_refused_commands(golden):
    shown = [
        f"{line}\n    error: {refusal(*shlex.split(line))}\n"
        for line in REFUSED_COMMANDS.splitlines()
    ]
    golden("refused-commands", without_own_parts("\n".join(shown)), numbers=True)
