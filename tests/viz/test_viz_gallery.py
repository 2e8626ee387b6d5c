"""The scripts of the gallery run off-screen, and their pictures are those that are kept."""

import ast
import re
from functools import cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from looks import faults
from PIL import Image

GALLERY = Path(__file__).parents[2] / "docs" / "gallery"
KEPT = GALLERY / "pictures"
SCRIPTS = sorted(GALLERY.glob("*.py"))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a function that runs a script, once, and returns the pictures that it has saved."""

    @cache
    def run(script):
        folder = tmp_path_factory.mktemp(script.stem)
        with mpl.rc_context(), pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            patch.setattr("sys.argv", [str(script)])
            text = re.sub(r"^FRAMES = \d+", "FRAMES = 5", script.read_text("utf-8"), flags=re.M)
            exec(compile(text, script, "exec"), {"__name__": "__main__", "__file__": str(script)})
            figures = map(mpl.pyplot.figure, mpl.pyplot.get_fignums())
            found = {name: faults(figure) for name, figure in enumerate(figures)}
            mpl.pyplot.close("all")
            assert not any(found.values()), found
        return sorted(folder.iterdir())

    return run


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB").resize((120, 75))).astype(int)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
@pytest.mark.thorough
@pytest.mark.slow_but("spectra")
def test_gallery(script, made):
    assert made(script)
    for path in made(script):
        kept = KEPT / path.name
        assert kept.exists(), f"{path.name} is not in the gallery"
        assert max(path.stat().st_size, kept.stat().st_size) <= 400_000
        if path.suffix == ".png":
            with Image.open(path) as image:
                assert min(image.size) >= 600
            # other renderers smooth edges otherwise, other machines draw other digits
            assert (np.abs(pixels(path) - pixels(kept)).sum(axis=2) > 90).mean() < 0.1


@pytest.mark.slow
def test_the_gallery_holds_nothing_else(made):
    pictures = {path.name for path in KEPT.iterdir()}
    assert pictures == {path.name for script in SCRIPTS for path in made(script)}
    assert sum((KEPT / name).stat().st_size for name in pictures) < 6_000_000
    assert {path.suffix for path in GALLERY.iterdir() if path.is_file()} <= {".py", ".rst"}


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_scripts_are_pages(script):
    """A title, a text, a small picture; slow ones have the kept pictures in their text."""
    text = script.read_text(encoding="utf-8")
    title, line, *rest = ast.get_docstring(ast.parse(text)).splitlines()
    assert line == "=" * len(title)
    assert any(rest)
    for name in re.findall(r"/?gallery/pictures/([\w.]+)", text):
        assert (KEPT / name).exists()
    slow = re.search(r"^SLOW = (\(.*?\))", (GALLERY.parent / "conf.py").read_text(), re.M)
    drawn_by_tests = script.stem in ast.literal_eval(slow.group(1))
    assert re.findall(
        r"^# sphinx_gallery_thumbnail_path = 'gallery/pictures/([\w.]+)'$", text, re.M
    )
    assert ("../movie.mp4" in text or "/gallery/pictures/" in text) == drawn_by_tests
