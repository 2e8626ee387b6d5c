"""What a user gets: the packages, quick imports, and examples that run."""

import ast
import json
import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from meshtrace.scenario import Scenario

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
HEAVY = {
    "dask",
    "distributed",
    "imageio",
    "matplotlib",
    "numba",
    "pyvista",
    "scipy",
    "trimesh",
    "xarray",
    "meshtrace.viz",
}


def modules_after(code):
    """Return the modules that a fresh interpreter has loaded after some code."""
    code = f"import sys\n{code}\nimport json\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_every_folder_with_modules_is_packaged():
    config = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    found = set()
    for name, folder in config["package-dir"].items():
        top = ROOT / folder
        for file in top.rglob("*.py"):
            parts = file.parent.relative_to(top).parts
            found.add(".".join([name, *parts]))
    assert sorted(config["packages"]) == sorted(found)


def test_every_package_has_an_init_with_a_docstring():
    config = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    for name in config["packages"]:
        folder = config["package-dir"].get(name, name.replace(".", "/"))
        assert ast.get_docstring(ast.parse((ROOT / folder / "__init__.py").read_text())), name


def test_data_files_are_packaged():
    config = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    for path in (ROOT / "meshtrace").rglob("*"):
        if path.is_dir() or path.suffix in (".py", ".nbi", ".nbc", ".pyc"):
            continue
        name = ".".join(path.relative_to(ROOT).parts[:-1])
        package = max((p for p in config["packages"] if f"{name}.".startswith(f"{p}.")), key=len)
        folder = ROOT / package.replace(".", "/")
        patterns = config["package-data"].get(package, [])
        assert any(path in folder.glob(pattern) for pattern in patterns), path


@pytest.mark.process
def test_importing_meshtrace_loads_nothing_heavy():
    assert not modules_after("import meshtrace") & HEAVY


@pytest.mark.process
def test_the_core_loads_neither_pictures_nor_clusters():
    code = "import meshtrace as mt, meshtrace.surfaces\nmt.simulate, mt.Link(), mt.GainResult"
    heavy = {"dask", "distributed", "imageio", "matplotlib", "pyvista", "xarray", "meshtrace.viz"}
    assert not modules_after(code) & heavy


@pytest.mark.process
@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["run", "--help"]])
def test_help_loads_nothing_heavy(arguments):
    code = f"from meshtrace.cli import app\napp({arguments!r}, standalone_mode=False)"
    loaded = modules_after(code)
    assert not loaded & (HEAVY | {"numpy", "meshtrace.link", "meshtrace.scenario"})


def test_every_public_name_is_there():
    import meshtrace

    assert all(hasattr(meshtrace, name) for name in meshtrace.__all__)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
@pytest.mark.thorough
def test_examples_run(example, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(example), run_name="__main__")
    assert "gain" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


def test_the_python_of_the_readme_runs(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for block in re.findall(r"```python\n(.*?)```", README, re.DOTALL):
        exec(compile(block, "README.md", "exec"), {})
    form = r"gain (\d\.\d+e-\d\d) \+- (\d\.\de-\d\d)"
    gain, stderr = map(float, re.search(form, capsys.readouterr().out).groups())
    stated, stated_stderr = map(float, re.search(form, README).groups())
    assert abs(gain - stated) < 0.005e-5 + 3.0 * stderr
    assert 0.5 < stderr / stated_stderr < 2.0


def test_the_readme_is_short():
    assert len(README.splitlines()) < 120


def test_the_files_that_the_readme_names_exist():
    for target in re.findall(r"\]\((?!http)([^)]+)\)", README):
        assert (ROOT / target).exists(), target
    for example in EXAMPLES:
        assert f"examples/{example.name}" in README


def test_the_default_link_file_states_the_defaults():
    assert Scenario.load(ROOT / "examples" / "default_link.toml") == Scenario.from_toml("")


def test_the_default_link_file_shows_every_key():
    text = (ROOT / "examples" / "default_link.toml").read_text()
    config = Scenario.from_toml("").to_config()
    del config["sea"]["alpha_coefficient"]
    rare = {"first_photon", "max_events", "max_surface_events"}
    rare |= {"r_min", "r_max", "capillary", "jitter"}
    for section, table in config.items():
        for key in table if isinstance(table, dict) else {section: table}:
            assert key in rare or re.search(rf"\b{key} = ", text) or f"[{key}]" in text, key
