"""The scripts of the gallery run off-screen, and what they make is in the gallery."""

import importlib.util
from pathlib import Path

import matplotlib as mpl
import pytest
from PIL import Image

GALLERY = Path(__file__).parents[2] / "docs" / "gallery"
SCRIPTS = sorted(GALLERY.glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_gallery(script, tmp_path):
    spec = importlib.util.spec_from_file_location(f"gallery_{script.stem}", script)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with mpl.rc_context():
        module.main(tmp_path)
        mpl.pyplot.close("all")
    made = sorted(tmp_path.iterdir())
    assert made
    for path in made:
        assert (GALLERY / path.name).exists(), f"{path.name} is not in the gallery"
        assert path.stat().st_size < 300_000
        if path.suffix == ".png":
            with Image.open(path) as image:
                assert min(image.size) >= 400


def test_the_gallery_holds_nothing_else():
    assert SCRIPTS
    kinds = {path.suffix for path in GALLERY.iterdir() if path.is_file()}
    assert kinds <= {".py", ".png", ".mp4", ".md", ".rst"}
