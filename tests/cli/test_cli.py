"""The command line: output, files and failures."""

import json
import re
import signal
import subprocess
import sys
import warnings

import pytest
from command_line import meshtrace, refusal

import meshtrace as mt
from meshtrace import cli
from meshtrace.engine.setup.options import Estimator
from meshtrace.scenario import Scenario
from meshtrace.surfaces import FlatSea

ANALOG = ["--estimator", "analog", "--photons", "5000"]


def run(*arguments):
    result = meshtrace("run", *arguments)
    assert result.exit_code == 0, result.stderr
    return result


@pytest.fixture
def link_file(tmp_path):
    def write(text):
        (tmp_path / "link.toml").write_text(text)
        return tmp_path / "link.toml"

    return write


def test_help_and_version():
    assert meshtrace().stdout == meshtrace("--help").stdout
    assert meshtrace("--version").stdout.startswith("meshtrace 0.")


def test_run_without_arguments_is_the_default_link():
    shown = run().stdout
    expected = Scenario.from_toml("").simulate()
    assert f"{expected.gain:.4e}" in shown
    assert f"{expected.gain_stderr:.1e}" in shown
    assert f"({expected.gain_db:.3f} dB optical)" in shown
    assert f"{expected.gain_ballistic:.4e} unscattered" in shown


def test_analog_tells_the_fates():
    shown = run("-v", "--set", "receiver.radius=3", *ANALOG).stdout
    result = Scenario.from_toml("", changes={**analog_changes(), "receiver.radius": 3}).simulate()
    assert f"{result.gain:.4e}" in shown
    assert "5,000 photons in" in shown
    for name, (photons, weight) in result.fates.items():
        line = next(line for line in shown.splitlines() if line.startswith(name))
        assert line.split()[1:3] == [f"{photons:,}", f"{100.0 * weight:.4g}"]


def analog_changes():
    return {"run.estimator": "analog", "run.photons": 5000}


@pytest.mark.parametrize("estimator", Estimator.registered)
def test_json_holds_the_result_and_the_configuration(estimator):
    done = run("--json", "--photons", 4096, "--seed", 3, "--estimator", estimator)
    data = json.loads(done.stdout)
    changes = {"run.photons": 4096, "run.seed": 3, "run.estimator": estimator}
    expected = Scenario.from_toml("", changes=changes)
    result = expected.simulate()
    assert (data["gain"], data["gain_stderr"]) == (result.gain, result.gain_stderr)
    assert data["fates"] == {name: tally._asdict() for name, tally in result.fates.items()}
    assert data["photons_per_second"] == pytest.approx(data["photons"] / data["wall_time"])
    assert Scenario.from_provenance(data["provenance"]) == expected
    assert done.stderr == ""


def test_json_knows_no_infinity():
    data = json.loads(run("--json", "--estimator", "analog", "--photons", 1).stdout)
    assert (data["gain"], data["gain_db"], data["gain_stderr"]) == (0.0, None, None)


def test_the_result_is_written_as_netcdf(tmp_path):
    done = run("-o", tmp_path / "out.nc", "--threads", 1, "--rtol", 1e-2, "--photons", "1e3")
    assert str(tmp_path / "out.nc") in done.stdout
    result = mt.GainResult.load(tmp_path / "out.nc")
    assert f"{result.gain:.4e}" in done.stdout
    assert result.provenance["run"]["threads"] == 1
    assert result.gain_stderr <= 0.01 * result.gain


def test_options_take_precedence_over_the_file(link_file):
    file = link_file("wind_speed = 13.0\n[run]\nseed = 5\nphotons = 300")
    done = run(file, "--set", "wind_speed=0", "--set", "sea.seed=3", "--seed", 6, "--json")
    provenance = json.loads(done.stdout)["provenance"]
    assert provenance["surface"]["kind"] == "flat"
    assert (provenance["run"]["seed"], provenance["run"]["photons"]) == (6, 300)


def test_a_warning_is_one_line(tmp_path, link_file):
    FlatSea().mesh(extent=5.0, spacing=1.0).to_trimesh().export(tmp_path / "small.ply")
    done = run(link_file('[sea]\nmesh = "small.ply"'), *ANALOG)
    assert done.stderr.startswith("warning: ")
    assert "left the meshed surface sideways" in done.stderr
    assert done.stderr.count("\n") == 1


def test_compiling_is_reported(monkeypatch):
    monkeypatch.setattr("meshtrace.kernels.jit.is_compiled", lambda kernel: False)
    done = run("--photons", 300)
    assert done.stderr == f"{cli.console.COMPILING}\n"
    assert run("--photons", 300, "--json").stderr == ""
    assert "larger spacing" in refusal("run", "--set", "sea.spacing=1e-4")


@pytest.mark.parametrize("estimator", Estimator.registered)
def test_kernels_once_compiled_are_found(monkeypatch, estimator):
    run("--photons", 300, "--estimator", estimator)
    monkeypatch.undo()
    assert cli.console.kernels_are_compiled(estimator)


def test_seas_with_random_slopes_need_one_kernel_of_forced_detection(monkeypatch):
    from meshtrace.engine.chains import gain

    only = gain.blurred_contributions
    monkeypatch.setattr("meshtrace.kernels.jit.is_compiled", lambda kernel: kernel is only)
    assert cli.console.kernels_are_compiled("forced")
    assert not cli.console.kernels_are_compiled("analog")


def test_a_mesh_too_small_for_its_link_is_refused(tmp_path, link_file):
    FlatSea().mesh(extent=5.0, spacing=1.0).to_trimesh().export(tmp_path / "small.ply")
    file = link_file('[sea]\nmesh = "small.ply"\n[receiver]\nposition = [9.0, 0.0]')
    message = refusal("run", file)
    assert all(word in message for word in ("small.ply", "covers", "allowed: "))


def test_errors_of_a_file_begin_with_its_name(link_file):
    file = link_file("[transmitter]\ndepth = -3.0")
    assert refusal("run", file) == f"{file}: transmitter.depth: -3.0, allowed: 0 < depth <= 12000"


def test_our_own_failures_keep_their_traceback(monkeypatch):
    def fail(*args, **kwargs):
        raise ValueError("a slip of ours")

    monkeypatch.setattr(Scenario, "simulate", fail)
    result = meshtrace("run")
    assert isinstance(result.exception, ValueError)
    assert result.exit_code == 1


def test_the_bar_shows_on_a_terminal_only(monkeypatch):
    from rich.console import Console

    class Terminal(Console):
        is_terminal = True

    monkeypatch.setattr("rich.console.Console", Terminal)
    monkeypatch.setattr("meshtrace.cli.console._is_on_terminal", lambda: True)
    assert "following photons" in run(*ANALOG).stderr
    assert run("--json", *ANALOG).stderr == ""


def command(*arguments, **options):
    return subprocess.Popen(
        [sys.executable, "-m", "meshtrace", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


@pytest.mark.process
@pytest.mark.thorough
def test_a_real_process_runs_and_fails(tmp_path):
    with command("run", "-o", "out.nc", "--photons", "1000", cwd=tmp_path) as process:
        shown, _ = process.communicate()
    assert process.returncode == 0
    assert "channel gain" in shown
    assert (tmp_path / "out.nc").exists()
    with command("run", "--set", "transmitter.depth=-1", cwd=tmp_path) as process:
        assert process.communicate() == (
            "",
            "error: transmitter.depth: -1, allowed: 0 < depth <= 12000\n",
        )
    assert process.returncode == 2


def test_interrupting_ends_with_one_line(monkeypatch):
    simulate = Scenario.simulate

    def interrupted(self, progress=None, wavelengths_nm=None, per_lamp=False):
        return simulate(self, lambda photons: signal.raise_signal(signal.SIGINT))

    monkeypatch.setattr(Scenario, "simulate", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        result = meshtrace("run", "--estimator", "analog", "--photons", 10**9)
    finally:
        signal.signal(signal.SIGINT, before)
    assert (result.exit_code, result.stdout, result.stderr) == (130, "", "interrupted\n")


def test_warnings_while_a_file_is_read_are_lines_too(tmp_path):
    """They once showed a line of the source."""
    rows = ["frequency,0,90,180,270", "0.1,0.01,0.005,0.001,0.002", "0.2,0.003,0.002,0.001,0.001"]
    (tmp_path / "waves.csv").write_text("\n".join(rows))
    file = tmp_path / "link.toml"
    file.write_text('[sea]\nspectrum = "measured"\nfile = "waves.csv"\n')
    done = run(file, "--photons", 64)
    lines = done.stderr.splitlines()
    assert lines
    assert all(line.startswith("warning: ") for line in lines)
    assert "source: the spectrum ends at 0.2 Hz" in done.stderr


@pytest.mark.thorough
def test_a_work_of_hours_is_told_at_its_begin():
    """A thousand billion photons once began without a word."""
    command = [sys.executable, "-m", "meshtrace", "run", "--estimator", "analog",
               "--photons", str(10**12), "--set", "sea.spectrum=flat"]  # fmt: skip
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        line = next(line for line in process.stderr if line.startswith("warning: "))
        process.kill()
    assert re.fullmatch(r"warning: 1,000,000,000,000 photons: about [\d.]+ (h|d)\n", line)


def test_help_names_every_command_by_a_whole_sentence():
    shown = meshtrace("--help").stdout
    assert "..." not in shown.partition("Commands:")[2]


def test_a_series_of_two_steps_has_no_coherence_time():
    shown = meshtrace("series", "--times", "0,1", "--photons", 64, "--wind", 0).stdout
    assert "nan" not in shown
    assert re.search(r"coherence time +-\n", shown)
    assert "needs gains that vary, at 3 times or more" in shown


def test_convergence_of_a_dark_link_is_refused():
    dark = ["--spacings", "4,3,2,1", "--photons", 32, "--placements", 1, "--set", "water.a=180"]
    assert "no light received" in refusal("converge", *dark)


def test_alike_warnings_are_two_lines(capsys):
    from meshtrace.cli.console import warnings_as_lines

    with warnings_as_lines():
        for current in (83.1, 143, 97):
            warnings.warn(f"{current} mA through the SiPM", stacklevel=1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "warning: 83.1 mA through the SiPM"
    assert lines[1:] == ["warning, 3 times in all: 83.1 to 143 mA through the SiPM"]


@pytest.mark.parametrize("setting", ["depth=5", "receiver.depth=5"])
def test_a_key_of_another_table_is_named(setting):
    done = meshtrace("run", "--set", setting)
    assert done.exit_code == 2
    assert "did you mean transmitter.depth" in done.stderr


def test_a_duration_takes_the_place_of_times():
    done = meshtrace("series", "--duration", "1", "--times", "0,1")
    assert done.stderr == "error: --duration: 1.0, allowed: not beside --times\n"
    assert meshtrace("series", "--duration", "0.05", "--photons", "32").exit_code == 0


def test_bounds_of_a_search_are_asked_for_in_the_form_of_the_option():
    done = meshtrace("optimize")
    assert done.stderr.startswith("error: --bounds: missing, allowed: KEY=LOW,HIGH")


def test_a_setting_without_its_option_is_recognized():
    assert (
        "did you mean --set transmitter.depth=5?" in meshtrace("run", "transmitter.depth=5").stderr
    )
