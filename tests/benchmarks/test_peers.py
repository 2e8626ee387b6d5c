"""The peers follow the same link: their gains agree with the engine's.

The bound of the benchmark is the one that the project sets itself: three times the naive tracer.
"""

import pytest
from mc_statistics import ALPHA, sidak, z_test
from naive import HAS_OPEN3D, caster, naive_gain
from peers import LINK, default_mesh, measure, mitsuba_rows

import meshtrace as mt


@pytest.fixture(scope="module")
def reference():
    options = {"estimator": "analog", "photons": 1_000_000, "seed": 4, "normals": "facet"}
    return mt.simulate(LINK, default_mesh(), **options)


@pytest.mark.parametrize("open3d", [False, True], ids=["embreex", "Open3D"])
def test_naive_gain_agrees(open3d, reference):
    if open3d and not HAS_OPEN3D:
        pytest.skip("Open3D is not installed")
    mesh = default_mesh()
    gain, stderr = naive_gain(caster(mesh, open3d), LINK, mesh, 200_000, seed=1)
    assert stderr / gain < 0.03
    assert z_test(gain, stderr, reference.gain, reference.gain_stderr) > sidak(ALPHA, 3)


@pytest.mark.external
def test_mitsuba_gain_agrees(reference):
    rows = mitsuba_rows(400_000)
    if not rows:
        pytest.skip("Mitsuba 3 is not installed, or has no LLVM that it can use")
    assert rows[0].stderr / rows[0].gain < 0.06
    p = z_test(rows[0].gain, rows[0].stderr, reference.gain, reference.gain_stderr)
    assert p > sidak(ALPHA, 3)


def test_speed_against_the_naive_tracer(benchmark):
    rows = {row.name: row for row in benchmark.pedantic(measure, rounds=1)}
    benchmark.extra_info.update({name: row._asdict() for name, row in rows.items()})
    for name, row in rows.items():
        if name.startswith("naive"):
            assert rows["analog"].merit >= 3.0 * row.merit, rows
