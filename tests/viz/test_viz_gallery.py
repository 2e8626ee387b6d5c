"""The scripts of the gallery run off-screen, and what they make is in the gallery."""

import importlib.util
import re
from functools import cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

GALLERY = Path(__file__).parents[2] / "docs" / "gallery"
SCRIPTS = sorted(GALLERY.glob("*.py"))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a function that runs a script, once, and returns what it has made."""

    @cache
    def run(script):
        folder = tmp_path_factory.mktemp(script.stem)
        spec = importlib.util.spec_from_file_location(f"gallery_{script.stem}", script)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        with mpl.rc_context():
            # ten seconds of movie are for the gallery alone
            module.main(folder, **({"frames": 8} if script.stem == "movie" else {}))
            mpl.pyplot.close("all")
        return sorted(folder.iterdir())

    return run


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB").resize((120, 75))).astype(int)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_gallery(script, made):
    assert made(script)
    for path in made(script):
        kept = GALLERY / path.name
        assert kept.exists(), f"{path.name} is not in the gallery"
        assert max(path.stat().st_size, kept.stat().st_size) < 300_000
        if path.suffix == ".png":
            with Image.open(path) as image:
                assert min(image.size) >= 600
            # other renderers smooth edges otherwise, other machines draw other digits
            assert (np.abs(pixels(path) - pixels(kept)).sum(axis=2) > 90).mean() < 0.1


def test_the_gallery_holds_nothing_else(made):
    files = (path for path in GALLERY.iterdir() if path.is_file())
    pictures = {path.name for path in files if path.suffix not in (".py", ".md")}
    assert pictures == {path.name for script in SCRIPTS for path in made(script)}
    assert sum((GALLERY / name).stat().st_size for name in pictures) < 4_000_000


def test_the_page_shows_every_picture_and_names_every_script():
    page = (GALLERY / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"\]\(([\w.]+)\)", page)
    assert sorted(shown) == sorted(
        p.name for p in GALLERY.iterdir() if p.suffix in (".png", ".mp4")
    )
    assert sorted(re.findall(r"^`(\w+\.py)`", page, re.M)) == [path.name for path in SCRIPTS]
