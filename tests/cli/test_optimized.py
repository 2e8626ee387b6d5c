"""Commands under `python -OO`, which drops docstrings: the same help and link files."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.process

SHOW = """
import contextlib, io
from typer.main import get_command
from meshtrace import cli
def shown(*line):
    with contextlib.redirect_stdout(io.StringIO()) as text:
        cli.app(line, prog_name="meshtrace", standalone_mode=False)
    return text.getvalue()
for line in ["--version"], ["--help"], ["new"], *([n, "--help"] for n in get_command(cli.app).commands):
    print(line, shown(*line))
"""


def python(*words):
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=300)


@pytest.mark.thorough
def test_help_of_all_commands_is_the_same_without_docstrings():
    """It once ended in a KeyError."""
    plain, optimized = python("-c", SHOW), python("-OO", "-c", SHOW)
    assert optimized.returncode == 0, optimized.stderr
    assert optimized.stdout == plain.stdout
    assert len(plain.stdout.splitlines()) > 500


@pytest.mark.parametrize("line", ["--version", "--help"])
def test_commands_run_without_docstrings(line):
    done = python("-OO", "-m", "meshtrace", line)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split()[0] in ("meshtrace", "Usage:")


@pytest.mark.thorough
def test_a_run_gives_the_same_gain_without_docstrings_and_assertions():
    line = ("-m", "meshtrace", "run", "--wind", "0", "--photons", "64", "--json")
    plain, optimized = python(*line), python("-OO", *line)
    assert optimized.returncode == 0, optimized.stderr
    gains = [
        text.partition('"gain":')[2].partition(",")[0] for text in (plain.stdout, optimized.stdout)
    ]
    assert gains[0] == gains[1] != ""
