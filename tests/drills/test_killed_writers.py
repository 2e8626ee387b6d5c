"""Every writer killed in the act: a forked child writes without end, and gets SIGKILL.

The older file is still there, or the new one is whole; no file with its final name is cut.
"""

import io
import itertools
import json
import os
import shutil
import signal
import sys
import time
import zipfile
from contextlib import suppress
from dataclasses import replace
from random import Random

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.files import atomic
from meshtrace.results import load
from meshtrace.surfaces import FlatSea

pytestmark = [
    pytest.mark.drill,
    pytest.mark.posix,
    # matplotlib and numba have threads; the child calls none of them
    pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning"),
]

KILLS = [5, pytest.param(30, marks=pytest.mark.slow)]


def killed_writes(write, look, kills):
    """Kill a child that calls write(0), write(1) ... up to 1.5 writes after the first; look then."""
    random = Random(kills)
    start = time.perf_counter()
    write(-1)
    longest = 1.5 * (time.perf_counter() - start)
    for _ in range(kills):
        ready, tell = os.pipe()
        child = os.fork()
        if child == 0:
            with suppress(BaseException):
                write(0)
                os.write(tell, b"x")
                for i in range(1, 10**6):
                    write(i)
            os._exit(1)
        os.close(tell)
        assert os.read(ready, 1) == b"x"
        time.sleep(random.uniform(0.0, longest))
        os.kill(child, signal.SIGKILL)
        assert os.waitpid(child, 0)[1] == signal.SIGKILL
        os.close(ready)
        look()


def killed_at_write(write, folder, n):
    """Kill a child that calls write() before its n-th write to the folder; return its writes."""
    child = os.fork()
    if child == 0:
        writes = itertools.count(1)
        done = 0

        def before(event, args):
            nonlocal done
            wanted = event == "os.rename" or (event == "open" and args[1] == "w")
            if wanted and str(args[0]).startswith(str(folder)):
                done = next(writes)
                if done == n:
                    os.kill(os.getpid(), signal.SIGKILL)

        with suppress(BaseException):
            sys.addaudithook(before)
            write()
        os._exit(done)
    status = os.waitpid(child, 0)[1]
    return n if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)


def netcdf(path):
    assert load(path).gain > 0.0


def picture(path):
    from PIL import Image

    with Image.open(path) as image:
        image.load()


def movie(path):
    import imageio.v2 as imageio

    with imageio.get_reader(path) as reader:
        assert sum(1 for _ in reader) == 3


def vtk(path):
    import pyvista as pv

    assert pv.read(path).n_points > 100


def page(path):
    assert path.read_text().rstrip().endswith("</html>")


@pytest.fixture
def gain():
    return mt.simulate(mt.Link(), FlatSea(), photons=64, spacing=0.5, threads=1)


@pytest.fixture
def viz():
    return pytest.importorskip("meshtrace.viz")


class _Camera:
    """A plotter that needs no graphics card, of which a child has none."""

    def screenshot(self, return_img=True):
        return np.full((640, 819, 3), 200, np.uint8)

    def close(self):
        pass


def writer(name, gain, viz, monkeypatch):
    """Return a function that writes a file, and one that reads it to its end."""
    if name == "gain.nc":
        return gain.save, netcdf
    if name == "record.json":

        def write(path):
            with atomic(path) as temporary:
                temporary.write_text(json.dumps(list(range(20_000))))

        return write, lambda path: json.loads(path.read_text())
    mesh = FlatSea().mesh(extent=5.0, spacing=0.2)
    paths = mt.trace_paths(mt.Link(), FlatSea(), n=40, seed=1)
    cells = np.arange(30.0)
    coverage = mt.CoverageMap(cells, cells, np.ones((30, 30)), np.ones((30, 30)), {})
    if name.partition(".")[0] in ("sea", "paths", "map"):
        source = {"sea": mesh, "paths": paths, "map": coverage}[name.partition(".")[0]]
        return lambda path: viz.save_vtk(source, path), vtk
    from meshtrace.viz import export, show

    camera = _Camera()
    if name == "view.png":
        return lambda path: export.save_picture(camera, path), picture
    if name == "view.html":
        return lambda path: viz.save_html(None, mesh, path), page
    times = np.arange(3.0)
    ones = np.ones(3)
    series = mt.GainSeries("time", times, ones, ones, ones, 0.0)
    monkeypatch.setattr(show, "scene", lambda *_, **__: camera)
    return lambda path: show.save_movie(mt.Link(), FlatSea(), times, path, gain=series), movie


NAMES = ["gain.nc", "record.json", "sea.vtp", "sea.ply", "sea.vtu", "paths.vtp", "map.vti",
         "view.png", "view.html", pytest.param("view.gif", marks=pytest.mark.slow)]  # fmt: skip


@pytest.mark.parametrize("kills", KILLS)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.thorough
def test_killed_in_the_act(name, kills, tmp_path, gain, viz, monkeypatch):
    path = tmp_path / name
    write, read = writer(name, gain, viz, monkeypatch)
    write(path)
    read(path)
    kept = [path.stat().st_mtime_ns]

    def look():
        read(path)
        kept.append(path.stat().st_mtime_ns)
        visible = [p.name for p in tmp_path.iterdir() if not p.name.startswith(".")]
        assert visible == [name]

    killed_writes(lambda i: write(path), look, kills)
    assert kept[-1] > kept[0]  # else none was written


@pytest.mark.slow
# imageio leaves the pipes of its readers to the collector
@pytest.mark.filterwarnings("ignore:Exception ignored in:pytest.PytestUnraisableExceptionWarning")
def test_killed_encoder(tmp_path, gain, viz, monkeypatch):
    """The encoder is a process of its own, which outlives the killed one for a moment."""
    test_killed_in_the_act("view.mp4", 30, tmp_path, gain, viz, monkeypatch)


@pytest.mark.parametrize("kills", [30])
@pytest.mark.slow
def test_killed_figures(kills, tmp_path):
    """Picture, data, table, record and index: each is absent, or whole."""
    import pandas as pd
    import xarray as xr

    from paper import Setting, runner
    from paper.registry import load as load_figure

    figure, setting = load_figure("snell"), Setting()
    output = figure.make(setting, **figure.effort(True))
    quiet = replace(figure, make=lambda *_, **__: output)
    readers = {
        ".png": picture,
        ".nc": lambda path: xr.open_dataset(path, engine="h5netcdf").load().close(),
        ".csv": lambda path: pd.read_csv(path)["quantity"].size,
        ".json": lambda path: json.loads(path.read_text())["rows"],
        ".html": page,
    }
    seen = set()

    def write(i):
        runner._made(tmp_path, quiet, setting, True)
        runner.write_index(tmp_path)

    def look():
        for path in tmp_path.iterdir():
            if not path.name.startswith("."):
                seen.add(path.suffix)
                readers[path.suffix](path)

    killed_writes(write, look, kills)
    assert seen >= {*readers} - {".json"}  # which is removed first and written last


def test_killed_stores(tmp_path):
    """A store that was killed is none, or goes on; all its gains are those of a whole one."""
    from hostile_own_files import swept

    folder = tmp_path / "stores"

    def write():
        return np.asarray(swept(folder / "one.store", 3e-5)["gain"])

    folder.mkdir()
    for n in range(1, killed_at_write(write, folder, None) + 1):
        shutil.rmtree(folder)
        folder.mkdir()
        assert killed_at_write(write, folder, n) == n
        np.testing.assert_array_equal(write(), np.full((2, 2, 1), 3e-5))


def test_torn_files_are_found():
    """The readers see a cut file."""
    with pytest.raises((OSError, ValueError, Refused, zipfile.BadZipFile)):
        picture(io.BytesIO(b"\x89PNG\r\n\x1a\n"))
