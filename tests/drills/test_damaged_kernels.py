"""Damaged files of compiled kernels: no crash, the same gain, and an intact file afterwards."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest

pytestmark = [pytest.mark.drill, pytest.mark.process]

CODE = """
import meshtrace as mt
from meshtrace.surfaces import JonswapSea
sea = JonswapSea(wind_speed=5.0, seed=7, waves="paper")
for estimator in ("forced", "analog"):
    print(mt.simulate(mt.Link(), sea, estimator=estimator, photons=64, spacing=0.5, threads=1).gain)
"""


def gains(folder):
    """Return what a fresh process prints, and its warnings."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, timeout=400
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


@pytest.fixture(scope="module")
def intact(tmp_path_factory):
    """Return a folder with the kernels of both estimators, and the gains."""
    folder = tmp_path_factory.mktemp("kernels")
    # those of this session, if it has them, so that they need not be compiled here
    kept = Path(os.environ["NUMBA_CACHE_DIR"]) / "kernels"
    if kept.is_dir():
        from meshtrace.kernels import jit

        shutil.copytree(
            kept / jit.folder().name, folder / "kernels" / jit.folder().name, dirs_exist_ok=True
        )
    return folder, gains(folder)[0]


def damages(random, content):
    """Yield a file emptied, cut and with one bit flipped."""
    yield b""
    yield content[: random.randrange(len(content))]
    place = random.randrange(len(content))
    flipped = content[place] ^ (1 << random.randrange(8))
    yield content[:place] + bytes([flipped]) + content[place + 1 :]


def check(intact, folder, choose):
    """Damage some files at once, and look at the next two runs."""
    source, expected = intact
    shutil.copytree(source, folder, dirs_exist_ok=True)
    sound = {path: path.read_bytes() for path in sorted(folder.rglob("meshtrace.*.kernel"))}
    damaged = choose(sound)
    for path, content in damaged.items():
        path.write_bytes(content)
    shown, warned = gains(folder)
    assert shown == expected
    used = [path for path in damaged if f"{path}: damaged, compiled again" in warned]
    for path in used:
        assert len(path.read_bytes()) == pytest.approx(len(sound[path]), rel=0.01)
    shown, warned = gains(folder)
    assert shown == expected
    assert "damaged" not in warned
    return len(used)


@pytest.mark.slow
def test_every_small_kernel_damaged_at_once(intact, tmp_path):
    """Kernels that are compiled in a second or two; the others are for the long drill."""
    random = Random(1)

    def choose(sound):
        small = {path: content for path, content in sound.items() if len(content) < 100_000}
        return {path: random.choice([*damages(random, c)]) for path, c in small.items()}

    assert check(intact, tmp_path, choose) >= 4


@pytest.mark.slow
def test_every_kernel_emptied_cut_and_flipped(intact, tmp_path):
    random = Random(2)
    for how in range(3):
        found = check(
            intact,
            tmp_path / str(how),
            lambda sound, how=how: {p: [*damages(random, c)][how] for p, c in sound.items()},
        )
        assert found >= 7
