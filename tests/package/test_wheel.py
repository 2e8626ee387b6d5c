"""The platform wheel: its first run compiles nothing."""

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a shell script")
def test_the_first_run_from_a_platform_wheel_compiles_nothing(tmp_path):
    """Build, unpack apart from the checkout, and run in an empty cache folder."""
    pytest.importorskip("wheel")
    script = [str(ROOT / ".ci" / "wheel"), sys.executable, str(tmp_path)]
    subprocess.run(script, check=True, cwd=ROOT, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    assert wheel.stem.endswith(platform)
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(tmp_path / "site")
    cache = tmp_path / "cache"
    environment = {
        **os.environ,
        "PYTHONPATH": str(tmp_path / "site"),
        "NUMBA_CACHE_DIR": str(cache),
    }
    code = """
import json, time
import meshtrace as mt
from meshtrace.scenario import Scenario
r, seconds = Scenario.from_toml("").simulate(), time.process_time()
mt.simulate(mt.Link().mirrored(), mt.JonswapSea(), photons=256)
mt.simulate(mt.Link(), mt.JonswapSea(), "analog", photons=256)
mt.coverage_map(mt.Link(), mt.JonswapSea(), extent=1.0, step=0.5, rtol=0.5)
print(json.dumps([mt.__file__, r.gain, seconds]))
"""
    run = [sys.executable, "-c", code]
    done = subprocess.run(run, env=environment, cwd=tmp_path, capture_output=True, check=True)
    place, gain, seconds = json.loads(done.stdout)
    assert Path(place).is_relative_to(tmp_path)
    assert 5e-5 < gain < 7e-5
    assert not list(cache.rglob("*.kernel"))
    assert seconds <= 2.5
