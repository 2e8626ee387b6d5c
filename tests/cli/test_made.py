"""Commands made from the signatures and docstrings of studies."""

import subprocess
import sys

import pytest
from command_line import meshtrace, refusal
from typer.main import get_command

import meshtrace as mt
from meshtrace import cli
from meshtrace.cli.commands import study_commands
from meshtrace.cli.made import reader_of, sentences
from meshtrace.errors import Refused
from meshtrace.results import load


def documented(first, second=2.0, third=None):
    """Return nothing.

    Parameters
    ----------
    first : sequence of float
        Depths [m], see
        `second`. More text.
    second, third : float
        Two numbers.

    Returns
    -------
    None
        No parameter.
    """


def test_sentences_of_a_docstring():
    assert sentences(documented) == {
        "first": "Depths [m], see `second`.",
        "second": "Two numbers.",
        "third": "Two numbers.",
    }
    assert sentences(lambda: None) == {}


@pytest.mark.parametrize("name", study_commands())
def test_every_option_has_a_sentence_of_its_own(name):
    command = study_commands()[name]
    for option in command._study.options:
        shown = next(p.help for p in command._made.params if p.name == option)
        assert shown[0].isupper()
        assert not shown.startswith("As in ")
        assert "`" not in shown


@pytest.mark.parametrize(
    ("annotation", "text", "value"),
    [
        ("int | None", "1e3", 1000),
        ("int", str(2**64 - 1), 2**64 - 1),
        ("float", "1e-3", 1e-3),
        ("ArrayLike | None", "0:1:0.5", [0.0, 0.5, 1.0]),
        ("float | Sequence[float]", "1,2.5", [1.0, 2.5]),
        ("tuple[float, float]", "1,2", (1.0, 2.0)),
        ("Bounds", ["a.b=1,2"], {"a.b": (1.0, 2.0)}),
        ("Word", "tilt", "tilt"),
        ("Sequence[Word]", "tilt,none", ["tilt", "none"]),
    ],
)
def test_texts_are_read_by_the_annotation(annotation, text, value):
    names = {}
    exec("from collections.abc import Sequence\nfrom typing import Literal", names)
    exec("Word = Literal['tilt', 'none']", names)
    reader, _ = reader_of(annotation, names)
    assert reader.read("--option", text) == value


@pytest.mark.parametrize(
    ("annotation", "text", "allowed"),
    [
        ("int", "1.5", "an integer"),
        ("int", "inf", "an integer"),
        ("float", "x", "a number"),
        ("Sequence[float]", "1:2", "numbers as in 1,2,3"),
        ("tuple[float, float]", "1", "two numbers"),
        ("Bounds", ["a=1"], "KEY=LOW,HIGH"),
    ],
)
def test_other_texts_are_refused_by_the_name_of_the_option(annotation, text, allowed):
    reader, _ = reader_of(annotation, {})
    with pytest.raises(Refused, match=f"^--option: .*allowed: {allowed}"):
        reader.read("--option", text)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("series --photons 0", "--photons: 0, allowed: 1 <= photons"),
        ("series --photons many", "--photons: 'many', allowed: an integer"),
        ("ber --limit 0.7", "--limit: 0.7, allowed: 0 < limit < 0.5"),
        ("ber --bit-rates 0", "--bit-rates: 0.0, allowed: 0 < bit_rate"),
        ("coverage --step -1", "--step: -1.0, allowed: "),
        ("sensitivity --of x", "--of: 'x', allowed: gain, ber"),
        ("optimize", "--over: missing, allowed: "),
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
    for options in ({"workers": 0}, {"timeout": -1.0}):
        (name,) = options
        with pytest.raises(Refused, match=f"^{name}: "):
            mt.sweep(mt.Link(), {"water.b": [0.0]}, rtol=None, photons=32, **options)
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
    best = mt.optimize(scenario, over=over, objective="gain", realizations=1, photons=64)
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
    assert set(study_commands()) < set(get_command(cli.app).commands)


def test_photons_of_the_table_count_in_every_study(tmp_path):
    """The study of fading alone would take those of the link file."""
    bands = ("--what", "fading", "--omega-max", "2,3,4,5")
    done = meshtrace("converge", *bands, "-o", tmp_path / "a.nc")
    assert done.exit_code == 0, done.stderr
    assert load(tmp_path / "a.nc").provenance["run"]["photons"] == 2048
