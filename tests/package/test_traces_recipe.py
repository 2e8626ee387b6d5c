"""The recipe of W2A-Traces and the part of it that is kept."""

import hashlib
import sys
from pathlib import Path

import numpy as np
import pytest

import meshtrace as mt

FOLDER = Path(__file__).parents[2] / "examples" / "traces"
SAMPLE = FOLDER / "sample"


@pytest.fixture(scope="module")
def recipe():
    sys.path.insert(0, str(FOLDER))
    try:
        import build
    finally:
        sys.path.remove(str(FOLDER))
    return build


def test_the_kept_part_is_whole_and_small(recipe):
    sums = (line.split() for line in (SAMPLE / "SHA256SUMS").read_text().splitlines())
    known = {name: digest for digest, name in sums}
    files = recipe.files(SAMPLE)
    assert len(files) == len(known) == len(recipe.WINDS) * (len(recipe.DEPTHS) + 1)
    for path in files:
        assert hashlib.sha256(path.read_bytes()).hexdigest() == known[path.name]
    assert sum(path.stat().st_size for path in files) < 5_000_000


def test_gains_fall_with_depth_and_fade_less_in_wide_apertures(recipe):
    for wind in recipe.WINDS:
        means = []
        for depth in recipe.DEPTHS:
            trace = mt.ChannelTrace.load(SAMPLE / f"{wind:g}m-s_{depth:g}m.nc")
            assert trace.gain.shape == (200, 6)
            assert np.isfinite(trace.gain).all()
            assert (trace.gain > 0.0).all()
            means.append(trace.gain.mean(axis=0))
            # light that a wider view adds, and a wider aperture smooths
            assert (trace.gain[:, 3:] >= trace.gain[:, :3]).all()
            index = trace.gain.var(axis=0) / means[-1] ** 2
            assert (np.diff(index[:3]) < 0.0).all()
        assert (np.diff(means, axis=0) < 0.0).all()


@pytest.mark.slow
def test_frames_are_those_of_the_recipe(recipe):
    recipe.check(SAMPLE)


@pytest.mark.thorough
def test_a_case_is_built_and_checked(recipe, tmp_path, capsys):
    recipe.build(tmp_path, 0.1, 20.0, "13m-s_10m", None)
    recipe.check(tmp_path)
    assert "13m-s_10m.nc: 2 frames agree" in capsys.readouterr().out
    assert not list(tmp_path.glob("*.store"))
