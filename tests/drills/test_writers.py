"""Writers that are killed, or find the disk full: the older file stays, or the new one is whole."""

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from random import Random

import pytest

pytestmark = [pytest.mark.drill, pytest.mark.process, pytest.mark.posix]

KILLS = 30
PAPER = Path(__file__).parents[2] / "examples" / "paper"

WRITERS = {
    "gain.nc": "run --photons 64 --set sea.spacing=0.5 -o {}",
    "series.nc": "series --photons 32 --times 0,1,2,3 -o {}",
    "ensemble.nc": "ensemble --photons 32 -n 4 -o {}",
    "ber.nc": "ber --photons 32 -n 2 --bit-rates 5e6 -o {}",
    "converge.nc": "converge --spacings 4,3,2,1 --normals vertex --photons 32 --placements 2 -o {}",
    "view.png": "view --paths 0 --spacing 0.5 --screenshot {}",
    "view.html": "view --paths 0 --spacing 0.5 --html {}",
}


def command(line, path):
    words = shlex.split(line.format(shlex.quote(str(path))))
    return [sys.executable, "-m", "meshtrace", *words]


def is_whole(path):
    """Return whether a file reads to its end as what its name says."""
    if path.suffix == ".nc":
        import xarray as xr

        with xr.open_dataset(path, engine="h5netcdf") as data:
            return len(data.load().variables) > 0
    if path.suffix == ".png":
        from PIL import Image

        with Image.open(path) as image:
            image.load()
        return True
    if path.suffix == ".json":
        import json

        return bool(json.loads(path.read_text()))
    return path.read_text().rstrip().endswith("</html>")


def only(folder, names):
    """Return the files of a folder that are none of some, temporary ones with a dot left out."""
    return [p.name for p in folder.iterdir() if p.name not in names and not p.name.startswith(".")]


# The write itself takes milliseconds of seconds: stopped at each system call that changes a file,
# under a tracer, a writer is killed where it matters.
KILLER = """
import os, random, signal, sys
kill_at, name = int(sys.argv[1]), sys.argv[2]
seen = 0
def hook(event, args):
    global seen
    if event in ("open", "os.rename", "os.remove", "os.mkdir"):
        text = str(args[0])
        writing = event != "open" or (args[1] and any(c in args[1] for c in "wax+"))
        if os.path.dirname(name) in text and writing:
            seen += 1
            if seen == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(hook)
sys.argv = ["meshtrace", *sys.argv[3:]]
from meshtrace.__main__ import main
main()
"""


def good_file(line, path):
    """Write a file once, and return its bytes and the time it took."""
    started = time.monotonic()
    done = subprocess.run(command(line, path), capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    assert is_whole(path)
    return path.read_bytes(), time.monotonic() - started


def look_at(path, good):
    """Check that a file is the older one, or a new one that is whole."""
    assert path.exists()
    assert path.read_bytes() == good or is_whole(path)


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_kills_at_random_times(name, tmp_path):
    """Half of the kills fall anywhere in the run, half in its last tenth, where files are written."""
    path, random = tmp_path / name, Random(name)
    good_file(WRITERS[name], path)  # compiles
    good, duration = good_file(WRITERS[name], path)
    killed = 0
    for i in range(KILLS):
        delay = duration * (random.random() if i % 2 else random.uniform(0.85, 1.1))
        process = subprocess.Popen(
            command(WRITERS[name], path), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            process.wait(delay)
        except subprocess.TimeoutExpired:
            process.kill()
            killed += process.wait() == -signal.SIGKILL
        look_at(path, good)
    assert killed > KILLS // 4


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name == "gain.nc" else [pytest.mark.slow]) for name in WRITERS],
)
@pytest.mark.slow
def test_kills_while_files_are_opened_and_renamed(name, tmp_path):
    path = tmp_path / name
    good, _ = good_file(WRITERS[name], path)
    words = command(WRITERS[name], path)[3:]
    for kill_at in range(1, 12):
        process = subprocess.run(
            [sys.executable, "-c", KILLER, str(kill_at), str(path), *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=500,
        )
        look_at(path, good)
        if process.returncode != -signal.SIGKILL:
            break
    assert kill_at > 1
    assert process.returncode == 0


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.slow
def test_full_disk(name, tmp_path):
    """Files may hold 4 kB: one line says so, and the older file is still there."""
    path = tmp_path / name
    good, _ = good_file(WRITERS[name], path)
    limited = f"ulimit -f 8; exec {shlex.join(command(WRITERS[name], path))}"
    done = subprocess.run(["sh", "-c", limited], capture_output=True, text=True, timeout=500)
    assert path.read_bytes() == good
    assert done.returncode > 0, done.stderr
    assert "Traceback" not in done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert str(path) in errors[0]
    assert only(tmp_path, {name}) == []


@pytest.mark.slow
def test_full_disk_of_an_export(tmp_path):
    """VTK writes what fits and says nothing."""
    words = command("view --paths 0 --spacing 0.5 --export {}", tmp_path / "scene")
    limited = f"ulimit -f 8; exec {shlex.join(words)}"
    done = subprocess.run(["sh", "-c", limited], capture_output=True, text=True, timeout=500)
    assert done.returncode > 0
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert "surface.vtp" in errors[0]
    assert only(tmp_path / "scene", set()) == []


SWEEP = "[sweep]\nphotons = 64\nrtol = 0.5\n[sweep.parameters]\nwind_speed = [3.0, 5.0]\n"


@pytest.mark.slow
def test_killed_sweeps_leave_a_store_that_goes_on(tmp_path):
    """Kill the client at random times: the same command finishes, and its gains are those of one."""
    pytest.importorskip("distributed")
    from meshtrace.studies.sweeps import read_store

    random = Random("sweep")
    study = tmp_path / "study.toml"
    study.write_text(SWEEP + "'transmitter.depth' = [5.0, 10.0, 15.0]\n")

    def line(store):
        words = ["sweep", str(study), "--store", str(store), "--workers", "1"]
        return [sys.executable, "-m", "meshtrace", *words]

    started = time.monotonic()
    whole = tmp_path / "whole.store"
    subprocess.run(line(whole), check=True, capture_output=True, timeout=500)
    duration = time.monotonic() - started
    expected = read_store(whole)["gain"]
    for i in range(KILLS // 3):
        store = tmp_path / f"{i}.store"
        # a session of its own, so that its workers can be ended with it
        process = subprocess.Popen(
            line(store),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            process.wait(duration * random.random())
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        subprocess.run(line(store), check=True, capture_output=True, timeout=500)
        found = read_store(store)["gain"]
        assert found.identical(expected)
        store.unlink()


@pytest.mark.slow
def test_killed_figures_are_drawn_by_the_next_run(tmp_path):
    random = Random("figures")
    words = [str(PAPER), "--quick", "--only", "snell", "-o"]
    whole = tmp_path / "whole"
    started = time.monotonic()
    subprocess.run(
        [sys.executable, *words, str(whole)],
        check=True,
        capture_output=True,
        timeout=500,
    )
    duration = time.monotonic() - started
    names = {path.relative_to(whole) for path in whole.rglob("*") if path.is_file()}
    for i in range(KILLS // 3):
        folder = tmp_path / str(i)
        line = [sys.executable, *words, str(folder)]
        process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            process.wait(duration * random.uniform(0.5, 1.05))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        pictures: list[Path] = [*folder.rglob("*.png"), *folder.rglob("*.nc")]
        assert all(is_whole(path) for path in pictures)
        subprocess.run(line, check=True, capture_output=True, timeout=500)
        assert {p.relative_to(folder) for p in folder.rglob("*") if p.is_file()} == names
