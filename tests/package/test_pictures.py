"""Kept pictures are those of today's drawing code: `python docs/scripts/redraw.py` redraws the others."""

import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "docs" / "scripts"


@pytest.fixture(scope="module")
def room():
    sys.path.insert(0, str(SCRIPTS))
    import redraw

    yield redraw
    sys.path.remove(str(SCRIPTS))
    sys.modules.pop("redraw")


def test_no_picture_is_stale(room):
    manifest = room.read()
    found = {job.name: room.stale(job, manifest) for job in room.jobs()}
    assert not {name: why for name, why in found.items() if why}, (
        "run python docs/scripts/redraw.py"
    )


def test_every_kept_picture_is_drawn_by_a_job(room):
    listed = {name for entry in room.read().values() for name in entry["files"]}
    listed |= {p.relative_to(room.ROOT).as_posix() for job in room.jobs() for p in job.outputs(())}
    kept = (p for p in SCRIPTS.parent.rglob("*") if p.suffix in (".png", ".mp4", ".gif", ".svg"))
    built = SCRIPTS.parent / "_build", SCRIPTS.parent / "examples"
    kept = {
        p.relative_to(room.ROOT).as_posix()
        for p in kept
        if not any(folder in p.parents for folder in built)
    }
    assert kept == {name for name in listed if not name.endswith(".nc")}


def test_code_and_data_count_and_words_do_not(room, tmp_path):
    script = tmp_path / "a.py"

    def inputs(text):
        script.write_text(text)
        return room.Job("a", (), tmp_path, (script,)).inputs()

    plain = inputs("x = 1\n")
    assert inputs('"""A picture."""\n\n# first\nx = 1\n') == plain
    assert inputs("import numpy as np\nx = 1\n") == plain
    assert inputs("x = 2\n") != plain
    assert inputs('x = 1\nax.set(xlabel=axis_label("gain"))\n') != plain


@pytest.mark.parametrize(
    ("name", "used", "unused"),
    [
        ("spectra", "plots_curves", "show"),
        ("coverage", "plots_results", "links"),
        ("movie", "scenes", "links"),
        ("make_tornado_figure", "plots_studies", "scenes"),
        ("make_explorer_pictures", "page", "show"),
        ("gain-depth", "links", "show"),
        ("surfaces", "scenes", "show"),
    ],
)
def test_a_picture_depends_on_the_modules_that_draw_it(room, name, used, unused):
    job = next(job for job in room.jobs() if job.name == name)
    modules = {path.stem for path, _ in job.parts()}
    assert used in modules
    assert "style" in modules
    assert unused not in modules


def test_a_picture_depends_on_the_definitions_that_it_uses_and_no_others(room):
    """A plain figure not on scenes, though one file writes both; a scene on constants it uses."""
    parts = {job.name: {name for _, name in job.parts()} for job in room.jobs()}
    assert {"plot_spectrum", "lines", "RC"} <= parts["spectra"]
    assert not {"ScenePlotter", "save_picture", "plot_sweep", "FATE_COLORS"} & parts["spectra"]
    assert {"FATE_COLORS", "_rays", "_BUBBLES_SHOWN", "SceneStyle"} <= parts["photon_paths"]
    assert {"gain_depth", "wind_lines", "mean_gain"} <= parts["gain-depth"]
    assert not {"coverage_depth", "fates"} & parts["gain-depth"]


def test_an_edit_of_what_is_not_used_leaves_a_picture(room, tmp_path, monkeypatch):
    (tmp_path / "style.py").write_text("A = 1\nB = 2\n\n\ndef use():\n    return twice(A)\n")
    (tmp_path / "marks.py").write_text("from .style import A\n\n\ndef line():\n    return A\n")
    script = tmp_path / "a.py"
    script.write_text("from meshtrace.viz import marks\n\nmarks.line()\n")
    monkeypatch.setattr(room, "_VIZ", tmp_path)
    monkeypatch.setitem(room._ROOMS, "meshtrace.viz", tmp_path)
    job = room.Job("a", (), tmp_path, (script,))
    assert {name for _, name in job.parts()} == {"", "line", "A"}
    before = job.inputs()
    (tmp_path / "style.py").write_text("A = 1\nB = 3\n")
    assert job.inputs() == before
    (tmp_path / "style.py").write_text("A = 5\nB = 3\n")
    assert job.inputs() != before


def test_a_picture_that_was_edited_or_lost_is_stale(room, tmp_path, monkeypatch):
    monkeypatch.setattr(room, "ROOT", tmp_path)
    script, picture = tmp_path / "a.py", tmp_path / "a.png"
    script.write_text("x = 1\n")
    picture.write_bytes(b"drawn")
    (tmp_path / "meshtrace" / "optics" / "data").mkdir(parents=True)
    job = room.Job("a", (), tmp_path, (script,))
    assert room.stale(job, {}) == "not drawn by redraw.py"
    manifest = {"a": {"inputs": job.inputs(), "files": {"a.png": room.digest(picture)}}}
    assert room.stale(job, manifest) == ""
    picture.write_bytes(b"edited")
    assert room.stale(job, manifest) == "not as drawn: a.png"
    picture.unlink()
    assert room.stale(job, manifest) == "not as drawn: a.png"
    script.write_text("x = 2\n")
    assert room.stale(job, manifest) == "older than the code that draws it"
