"""Options of the commands: their texts, defaults and refusals."""

import inspect
import subprocess
import sys
from dataclasses import dataclass

import pytest
from command_line import meshtrace, refusal
from typer.main import get_command

import meshtrace as mt
from meshtrace import cli
from meshtrace.cli import application, options
from meshtrace.errors import Refused
from meshtrace.results import load

COMMANDS = get_command(cli.app).commands
STUDIES = {
    "availability": mt.studies.availability,
    "ber": mt.link_performance,
    "compare": mt.compare,
    "coverage": mt.coverage_map,
    "design": mt.design,
    "ensemble": mt.ensemble,
    "irradiance": mt.irradiance_series,
    "lidar": mt.lidar,
    "optimize": mt.optimize,
    "sensitivity": mt.sensitivities,
    "series": mt.time_series,
    "sweep": mt.sweep,
    "traces": mt.channel_trace,
}
OTHER_DEFAULTS = {
    ("ber", "bit_rate"): "1e6,5e6,1e7",
    ("ber", "realizations"): None,  # depends on the depths
    ("ensemble", "realizations"): 200,
    ("irradiance", "depths"): "1,2,5,10",
    ("irradiance", "times"): "0:2:0.005",
    ("lidar", "photons"): 4096,
    ("optimize", "hover_std"): "0,0",
    ("series", "times"): "0:10:0.05",
    ("traces", "down"): None,
}
"""Defaults of a command that are not those of its study, which may have none."""


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_has_a_sentence_of_its_own(name):
    for parameter in COMMANDS[name].params:
        assert parameter.help[0].isupper() or parameter.help.split(",")[0].islower()
        assert parameter.help.endswith((".", "]"))
        assert "`" not in parameter.help


@pytest.mark.parametrize("name", STUDIES)
def test_defaults_are_those_of_the_study(name):
    """They are written in both places."""
    of_study = inspect.signature(STUDIES[name]).parameters
    compared = 0
    for parameter in COMMANDS[name].params:
        word = max(parameter.opts, key=len)[2:].replace("-", "_")
        argument = next((n for n in (parameter.name, word) if n in of_study), None)
        if argument is None or parameter.param_type_name == "argument":
            continue
        expected = of_study[argument].default
        assert parameter.default == OTHER_DEFAULTS.get((name, argument), expected), argument
        compared += 1
    assert compared or name in ("compare",)


@pytest.mark.parametrize(
    ("parse", "text", "value"),
    [
        (options.parse_integer, "1e3", 1000),
        (options.parse_integer, str(2**64 - 1), 2**64 - 1),
        (options.parse_numbers, "0:1:0.5", [0.0, 0.5, 1.0]),
        (options.parse_numbers, "0:0.3:0.1", pytest.approx([0.0, 0.1, 0.2, 0.3])),
        (options.parse_numbers, "1,2.5", [1.0, 2.5]),
        (options.parse_pair, "1,2", (1.0, 2.0)),
        (options.parse_bounds, "a.b=1,2", ("a.b", (1.0, 2.0))),
        (options.parse_workers, "3", 3),
        (options.parse_workers, "tcp://host:8786", "tcp://host:8786"),
    ],
)
def test_texts_are_parsed(parse, text, value):
    assert parse(text) == value


@pytest.mark.parametrize(
    ("line", "allowed"),
    [
        ("series --photons 1.5", "--photons: '1.5', allowed: an integer"),
        ("series --photons inf", "--photons: 'inf', allowed: an integer"),
        ("ber --limit x", "--limit: 'x', allowed: a number"),
        ("series --times 1:2", "--times: '1:2', allowed: numbers as in 1,2,3, or start:stop:step"),
        ("series --times 0:1e9:1", "--times: '0:1e9:1', allowed: numbers as in 1,2,3"),
        ("series --times 1:0:1", "--times: '1:0:1', allowed: numbers as in 1,2,3"),
        ("series --times 0:inf:1", "--times: '0:inf:1', allowed: numbers as in 1,2,3"),
        ("irradiance --patch 1", "--patch: '1', allowed: two numbers, as in 1,2"),
        (
            "optimize --bounds a=1",
            "--bounds: 'a=1', allowed: KEY=LOW,HIGH, as in receiver.fov_deg=",
        ),
        ("explore --port 65536", "--port: '65536', allowed: <= 65535"),
    ],
)
def test_other_texts_are_refused_by_the_name_of_the_option(line, allowed):
    assert refusal(*line.split()).startswith(allowed)


@dataclass(frozen=True, kw_only=True)
class Group:
    """Two options."""

    wind: str | None = None
    deep: bool = False


def test_a_group_of_options_is_one_argument_of_a_function():
    """An option that the function declares itself takes the place of that of the group."""
    calls = []

    def function(group: Group, wind: int = 1):
        calls.append((group, wind))

    spread = application._with_groups(function)
    assert list(inspect.signature(spread).parameters) == ["wind", "deep"]
    spread(wind=3, deep=True)
    assert calls == [(Group(deep=True), 3)]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("series --photons 0", "--photons: 0, allowed: 1 <= photons"),
        ("series --photons many", "--photons: 'many', allowed: an integer"),
        ("ber --limit 0.7", "--limit: 0.7, allowed: 0 < limit < 0.5"),
        ("ber --bit-rates 0", "--bit-rates: 0.0, allowed: 0 < bit_rate"),
        ("coverage --step -1", "--step: -1.0, allowed: "),
        ("sensitivity --quantity x", "--quantity: 'x', allowed: gain, ber"),
        ("optimize", "--bounds: missing, allowed: "),
        ("traces --hours nan", "--hours: nan, allowed: "),  # both once ended in a traceback
        ("traces --hours 1e308 --rate 1e308", "--"),
        ("converge --time-steps 1,0.5,0.25,0.125 --duration nan", "--duration: nan, allowed: "),
        ("converge --time-steps 1,0.5,0.25,0.125 --duration inf", "--duration: inf, allowed: "),
        ("converge --normals x,vertex", "--normals: 'x', allowed: vertex, facet"),
        ("converge --omega-max 1,2 --placements 3", "--placements: 3, allowed: only with --spac"),
        ("converge --what fading --spacings 1,2", "--spacings: [1.0, 2.0], allowed: only with -"),
    ],
)
def test_refusals_of_a_study_name_the_option(line, message):
    """They once named the parameter of the function."""
    assert refusal(*line.split()).startswith(message)


def test_sweeps_refuse_numbers_of_workers_and_seconds(tmp_path):
    """They were once checked by the command alone."""
    for words in ({"workers": 0}, {"timeout": -1.0}):
        (name,) = words
        with pytest.raises(Refused, match=f"^{name}: "):
            mt.sweep(mt.Link(), {"water.b": [0.0]}, rtol=None, photons=32, **words)
    file = tmp_path / "study.toml"
    file.write_text("[sweep.parameters]\n'water.b' = [0.0]\n")
    assert refusal("sweep", file, "--workers", 0).startswith("--workers: 0, allowed: ")


def test_defaults_are_those_of_the_studies(tmp_path):
    """The seed and the time of a link file count where a study once had its own."""
    link = tmp_path / "link.toml"
    link.write_text("[sea]\ntime = 2.0\n[run]\nseed = 5\n")
    scenario = mt.Scenario.load(link)
    found = mt.coverage_map(scenario, extent=1.0, step=1.0, photons=100)
    assert found.provenance["times"] == [2.0]
    over = {"transmitter.half_angle_deg": (5.0, 20.0)}
    best = mt.optimize(scenario, bounds=over, objective="gain", realizations=1, photons=64)
    assert best.provenance["run"]["seed"] == 5


def test_series_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "series.png"
    done = meshtrace("series", "--times", "0:1:0.5", "--photons", 64, "--plot", picture)
    assert done.exit_code == 0, done.stderr
    assert picture.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.process
def test_studies_are_imported_by_their_own_commands_only():
    code = (
        "import sys; from meshtrace.cli import app; app(['--help'], standalone_mode=False); "
        "sys.exit(any(name.startswith('meshtrace.studies') for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


def test_photons_of_the_table_count_in_every_study(tmp_path):
    """The study of fading alone would take those of the link file."""
    bands = ("--what", "fading", "--omega-max", "2,3,4,5")
    done = meshtrace("converge", *bands, "-o", tmp_path / "a.nc")
    assert done.exit_code == 0, done.stderr
    assert load(tmp_path / "a.nc").provenance["run"]["photons"] == 2048
