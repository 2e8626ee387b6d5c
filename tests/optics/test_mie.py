import os
import subprocess
import sys
import threading

import numpy as np
import pytest

from meshtrace.optics import mie

M = 1 / 1.33
# Independent double-precision series, x = 2 pi n_w r / wavelength for r from 10 um to 1 mm.
REFERENCE = {
    177.8: (2.001679695505, 0.850215565278),
    1000.0: (2.031532404483, 0.849179417028),
    5000.0: (2.007803311397, 0.846743714718),
    17780.0: (2.005107506793, 0.846440720008),
}


def integral_over_sphere(m, x, nodes):
    """Integral of i over solid angle, and that of i cos(theta), exact for nodes > orders."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    i = mie.phase_intensity(m, x, node)
    return 2 * np.pi * (i @ weight), 2 * np.pi * ((i * node) @ weight)


@pytest.mark.parametrize("x", REFERENCE)
def test_efficiencies_of_bubbles(x):
    q = mie.efficiencies(M, x)
    q_sca, g = REFERENCE[x]
    assert q.q_sca == pytest.approx(q_sca, abs=1e-11)
    assert q.q_ext == pytest.approx(q_sca, abs=1e-11)
    assert q.g == pytest.approx(g, abs=1e-11)


def test_efficiencies_keep_the_shape():
    x = np.array([[1.0, 10.0, 100.0], [2.0, 20.0, 200.0]])
    q = mie.efficiencies(0.75, x)
    assert q.q_sca.shape == q.g.shape == x.shape
    assert q.q_sca[1, 2] == mie.efficiencies(0.75, 200.0).q_sca


def test_absorption_of_a_small_sphere():
    m, x = 1.33 - 0.01j, 0.15
    q = mie.efficiencies(m, x)
    absorbed = -4 * x * ((m**2 - 1) / (m**2 + 2)).imag
    assert q.q_ext - q.q_sca == pytest.approx(absorbed, rel=2 * x**2)


@pytest.mark.parametrize("x", [0.5, 10.0, 177.8])
def test_intensity_integrates_to_the_efficiency(x):
    total, forward = integral_over_sphere(M, x, nodes=int(2 * x) + 40)
    q = mie.efficiencies(M, x)
    assert total == pytest.approx(np.pi * x**2 * q.q_sca, rel=1e-9)
    assert forward / total == pytest.approx(q.g, abs=1e-9)


def test_intensity_of_a_tiny_sphere_is_rayleighs():
    x, cosine = 0.01, np.linspace(-1, 1, 9)
    polarisability = (M**2 - 1) / (M**2 + 2)
    rayleigh = x**6 * polarisability**2 * (1 + cosine**2) / 2
    np.testing.assert_allclose(mie.phase_intensity(M, x, cosine), rayleigh, rtol=2 * x**2)


def test_matrix_products_equal_the_single_spheres():
    cosine = np.cos(np.deg2rad([0.0, 0.1, 1.0, 30.0, 82.5, 120.0, 180.0]))
    sizes = np.array([600.0, 300.0, 177.8, 20.0, 3.0])
    together = mie._intensities(M, sizes, cosine)
    for column, x in enumerate(sizes):
        alone = mie.phase_intensity(M, x, cosine)
        np.testing.assert_allclose(together[:, column], alone, rtol=1e-9)


def test_angular_edges():
    edges = mie.angular_edges()
    assert edges.size == 2501
    assert edges[0] == 0.0
    assert edges[-1] == np.pi
    assert np.pi / 2 in edges
    assert np.all(np.diff(edges) > 0)
    # Neighbouring bins differ little in width, so that the density has no visible seams.
    assert np.diff(edges)[1:].max() == pytest.approx(np.deg2rad(0.1))


def test_population_table_is_the_mean_distribution():
    """Against Gauss-Legendre integration of each sphere's intensity over each bin."""
    edges = np.deg2rad(np.linspace(0, 180, 91))
    kinds = np.array([4.0, 9.0, 15.0])
    cosine = np.cos(edges)
    node, weight = np.polynomial.legendre.leggauss(40)
    centre, half = (cosine[1:] + cosine[:-1]) / 2, (cosine[:-1] - cosine[1:]) / 2
    exact = np.zeros(90)
    for x in kinds:
        points = mie.phase_intensity(M, x, centre[:, None] + half[:, None] * node)
        exact += 2 * half * (points @ weight) / x**2 / len(kinds)
    q = mie.efficiencies(M, kinds)
    # 1024 copies of each sphere: every one of them meets each of 1024 node sets.
    table = mie.population_table(M, np.repeat(kinds, 1024), edges, rotations=1024)
    assert exact.sum() == pytest.approx(q.q_sca.mean(), rel=1e-12)
    np.testing.assert_allclose(table.cdf[1:], np.cumsum(exact) / exact.sum(), atol=2e-5)
    assert table.q_sca == pytest.approx(q.q_sca.mean(), rel=1e-14)
    assert table.g == pytest.approx((q.q_sca * q.g).sum() / q.q_sca.sum(), rel=1e-14)
    assert abs(table.closure) < 2e-5


def test_population_table_does_not_depend_on_the_order_of_sizes():
    sizes = np.array([30.0, 10.0, 20.0, 5.0])
    one = mie.population_table(M, sizes, rotations=2)
    other = mie.population_table(M, sizes[::-1], rotations=2)
    np.testing.assert_array_equal(one.cdf, other.cdf)


def test_tables_are_read_only():
    table = mie.population_table(M, [5.0])
    with pytest.raises(ValueError, match="read-only"):
        table.cdf[0] = 1.0


@pytest.mark.process
@pytest.mark.thorough
def test_the_compiled_backend_is_used_and_the_environment_left_alone():
    code = (
        "import os\n"
        "from meshtrace.optics import mie\n"
        "mie.efficiencies(0.75, 10.0)\n"
        "import miepython\n"
        "print(miepython.USE_JIT, os.environ.get('MIEPYTHON_USE_JIT'))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "None"]


def test_the_choice_of_backend_is_restored(monkeypatch):
    monkeypatch.setenv("MIEPYTHON_USE_JIT", "0")
    mie._miepython.cache_clear()
    mie.efficiencies(0.75, 10.0)
    assert os.environ["MIEPYTHON_USE_JIT"] == "0"


@pytest.mark.parametrize("x", [0.0, -1.0, np.nan, np.inf, [1.0, -2.0]])
def test_wrong_size_parameters(x):
    with pytest.raises(ValueError, match=r"^x.*: .*, allowed: > 0$"):
        mie.efficiencies(M, x)
    with pytest.raises(ValueError, match=r"^x.*: .*, allowed: > 0$"):
        mie.population_table(M, x)


def test_wrong_cosine():
    with pytest.raises(ValueError, match=r"^cos_theta\[1\]: 1.5, allowed: -1 <= cos_theta <= 1$"):
        mie.phase_intensity(M, 10.0, [0.0, 1.5])
    with pytest.raises(ValueError, match=r"^cos_theta: nan"):
        mie.phase_intensity(M, 10.0, np.nan)


def test_wrong_rotations():
    with pytest.raises(ValueError, match=r"^rotations: 0, allowed: an integer >= 1$"):
        mie.population_table(M, [10.0], rotations=0)


EDGES = np.array([0.0, 1.0, np.pi])


@pytest.mark.parametrize(
    ("edges", "cdf", "q_sca"),
    [
        ([0.1, 1.0, np.pi], [0.0, 0.5, 1.0], 2.0),
        ([0.0, 4.0, np.pi], [0.0, 0.5, 1.0], 2.0),
        ([0.0, np.pi], [0.0, 0.5, 1.0], 2.0),
        (EDGES, [0.0, 0.5, 0.9], 2.0),
        (EDGES, [0.0, 1.5, 1.0], 2.0),
        (EDGES, [0.0, np.nan, 1.0], 2.0),
        (EDGES, [0.0, 0.5, 1.0], np.nan),
    ],
)
def test_wrong_tables(edges, cdf, q_sca):
    with pytest.raises(ValueError, match="allowed"):
        mie.MieTable(np.array(edges), np.array(cdf), q_sca, 0.85, 0.0)


class Recipe:
    """A cheap table that counts how often it is made."""

    inputs = {"n_water": 1.33, "wavelength_nm": 470.0}  # noqa: RUF012

    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return mie.MieTable(EDGES.copy(), np.array([0.0, 0.25, 1.0]), 2.025, 0.85, 1e-5)

    def table(self, **changed):
        return mie.cached_table("test", {**self.inputs, **changed}, self)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    monkeypatch.setenv("MESHTRACE_CACHE_DIR", str(folder))
    return folder


def assert_is_the_recipe(table):
    np.testing.assert_array_equal(table.theta_edges, EDGES)
    np.testing.assert_array_equal(table.cdf, [0.0, 0.25, 1.0])
    assert (table.q_sca, table.g, table.closure) == (2.025, 0.85, 1e-5)


def test_cache_computes_once(cache):
    recipe = Recipe()
    for _ in range(3):
        assert_is_the_recipe(recipe.table())
    assert recipe.calls == 1
    assert [file.suffix for file in cache.iterdir()] == [".npz"]


def test_cache_tells_inputs_apart(cache):
    recipe = Recipe()
    recipe.table()
    recipe.table(wavelength_nm=532.0)
    recipe.table(wavelength_nm=np.nextafter(470.0, 500.0))
    assert recipe.calls == 3
    assert len(list(cache.iterdir())) == 3


def damaged(content, how):
    return {
        "empty": b"",
        "half": content[: len(content) // 2],
        "text": b"not a table",
        "flipped": content[:100] + bytes(255 - byte for byte in content[100:]),
    }[how]


@pytest.mark.parametrize("how", ["empty", "half", "text", "flipped"])
def test_damaged_file_is_computed_again(cache, how):
    recipe = Recipe()
    recipe.table()
    (file,) = cache.iterdir()
    file.write_bytes(damaged(file.read_bytes(), how))
    with pytest.warns(UserWarning, match="damaged, computed again"):
        assert_is_the_recipe(recipe.table())
    assert recipe.calls == 2
    assert_is_the_recipe(recipe.table())
    assert recipe.calls == 2


@pytest.mark.parametrize(
    "changed",
    [{"inputs": "{}"}, {"cdf": np.array([0.0, 2.0, 1.0])}, {"g": np.nan}, {"closure": None}],
)
def test_file_with_wrong_content_is_computed_again(cache, changed):
    recipe = Recipe()
    recipe.table()
    (file,) = cache.iterdir()
    with np.load(file) as data:
        content = {**data, **changed}
    np.savez(file, **{name: value for name, value in content.items() if value is not None})
    with pytest.warns(UserWarning, match="damaged, computed again"):
        assert_is_the_recipe(recipe.table())
    assert recipe.calls == 2


def test_cache_that_cannot_be_written(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("MESHTRACE_CACHE_DIR", str(tmp_path / "file" / "cache"))
    with pytest.warns(UserWarning, match="not kept"):
        assert_is_the_recipe(Recipe().table())


def test_failed_write_leaves_nothing_behind(cache, monkeypatch):
    def full(stream, **arrays):
        stream.write(b"half a table")
        raise OSError("no space left")

    monkeypatch.setattr(mie.np, "savez", full)
    with pytest.warns(UserWarning, match="no space left"):
        assert_is_the_recipe(Recipe().table())
    assert list(cache.iterdir()) == []


def test_parallel_writers(cache):
    recipe, tables = Recipe(), []
    threads = [threading.Thread(target=lambda: tables.append(recipe.table())) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(tables) == 8
    for table in tables:
        assert_is_the_recipe(table)
    assert len(list(cache.iterdir())) == 1
