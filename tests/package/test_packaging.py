"""What a user gets: the packages, quick imports, and examples that run."""

import ast
import json
import re
import runpy
import subprocess
import sys
import tomllib
from contextlib import suppress
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from meshtrace.errors import Refused, extra
from meshtrace.kernels import linker
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


def files():
    """Return the files of the package."""
    folders = (ROOT / name for name in ("meshtrace", "surfaces", "viz"))
    return [path for folder in folders for path in folder.rglob("*") if path.is_file()]


def test_every_package_has_an_init_with_a_docstring():
    """Folders without this file are left out of a wheel."""
    for folder in {path.parent for path in files() if path.suffix == ".py"}:
        assert ast.get_docstring(ast.parse((folder / "__init__.py").read_text())), folder


def installed_by(extra):
    """Return the distributions that `pip install meshtrace[extra]` installs, by lower-case name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras, found = project["optional-dependencies"], set()

    def add(line, extras_of_line=()):
        need = Requirement(line)
        name = canonicalize_name(need.name)
        if name == "meshtrace":
            for own in need.extras:
                for inner in extras[own]:
                    add(inner)
        elif need.marker is None or any(
            need.marker.evaluate({"extra": e}) for e in ("", *extras_of_line)
        ):
            if (name, *need.extras) not in found:
                found.add((name, *need.extras))
                with suppress(metadata.PackageNotFoundError):
                    for inner in metadata.requires(name) or ():
                        add(inner, need.extras)

    for line in (*project["dependencies"], *extras[extra]):
        add(line)
    return {name for name, *_ in found}


@pytest.mark.thorough
def test_the_extra_of_the_tests_installs_what_they_import():
    """The environment of .ci/run also has other extras, which would hide a lack."""
    owners, found = metadata.packages_distributions(), set()
    for path in (ROOT / "tests").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {name.name.partition(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add(node.module.partition(".")[0])
    needed = {name for name in found if name in owners} - {"meshtrace", "surfaces", "viz"}
    known = installed_by("test")
    lacking = {name for name in needed if not {canonicalize_name(d) for d in owners[name]} & known}
    assert not lacking


@pytest.mark.process
def test_importing_meshtrace_loads_nothing_heavy():
    assert not modules_after("import meshtrace") & HEAVY


@pytest.mark.process
@pytest.mark.thorough
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


@pytest.mark.process
@pytest.mark.thorough
def test_a_run_with_compiled_kernels_loads_no_more_than_it_needs():
    """scipy.stats alone takes as long to import as a run; numba.np serves compilation."""
    code = "from meshtrace.cli import app\napp(['run'], standalone_mode=False)"
    Scenario.from_toml("").simulate()  # compiles, if need be
    groups = ("constants", "integrate", "interpolate", "linalg", "optimize", "special", "stats")
    scipy = {f"scipy.{name}" for name in groups}  # and by compilation
    compilation = {"numba.cpython.unicode", "numba.np.arrayobj"} if linker.LINKED else set()
    others = {"pandas", "h5py", "miepython", "rich.progress", "meshtrace.comms.ook"}
    needed = {"numba", "scipy"}  # numba imports the outermost package
    loaded = modules_after(code) & ((HEAVY - needed) | scipy | compilation | others)
    assert not loaded


@pytest.mark.process
@pytest.mark.thorough
@pytest.mark.parametrize(("name", "heavy"), [
    ("plot", {"meshtrace.engine.simulate", "meshtrace.link", "meshtrace.comms", "pyvista"}),
    ("view", {"xarray", "pandas", "meshtrace.viz.marks", "scipy.ndimage", "scipy.spatial"}),
])  # fmt: skip
def test_pictures_load_no_more_than_they_need(name, heavy):
    pytest.importorskip("pyvista")
    integrals = {"scipy.integrate", "scipy.interpolate", "scipy.optimize", "scipy.stats"}
    studies = {"meshtrace.studies.campaign", "meshtrace.validation"}
    loaded = modules_after(f"import meshtrace.viz\nmeshtrace.viz.{name}")
    assert not loaded & (heavy | integrals | studies)


@pytest.mark.process
def test_schemas_are_built_for_the_models_that_a_run_uses():
    code = """
import meshtrace as mt
from meshtrace.models import Model
mt.Scenario.from_toml("")
def below(cls):
    for sub in cls.__subclasses__():
        yield sub
        yield from below(sub)
sys.modules |= {f"built {cls.__name__}": 0 for cls in below(Model) if cls.__pydantic_complete__}
"""
    built = {name for name in modules_after(code) if name.startswith("built ")}
    assert {"built Scenario", "built Link"} <= built
    assert len(built) < 30  # of some hundred, a millisecond each


@pytest.mark.parametrize("value", [None, "sea.dat"])
def test_a_missing_package_is_named_with_its_extra(value):
    missing = ModuleNotFoundError("none", name="wavespectra")
    with pytest.raises(Refused) as caught, extra("measured", "reader", value, "formats of {}"):
        raise missing
    for words in ("wavespectra is not installed", 'pip install "meshtrace[measured]"', value or ""):
        assert words in str(caught.value)


def test_the_extra_all_has_all_that_users_choose_from():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    (line,) = extras["all"]
    assert {*Requirement(line).extras, "all", "test", "docs", "lint"} == set(extras)


def test_every_public_name_is_there():
    import meshtrace

    assert all(hasattr(meshtrace, name) for name in meshtrace.__all__)
    assert dir(meshtrace) == sorted(meshtrace.__all__)
    assert len(meshtrace.__all__) <= 27


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
@pytest.mark.thorough
@pytest.mark.slow_but("daylight", "link_file", "quickstart")
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


def test_the_readme_names_every_example():
    for example in EXAMPLES:
        assert f"examples/{example.name}" in README


def test_the_default_link_file_states_the_defaults():
    assert Scenario.load(ROOT / "examples" / "default_link.toml") == Scenario.from_toml("")


def test_the_default_link_file_shows_every_key():
    text = (ROOT / "examples" / "default_link.toml").read_text()
    config = Scenario.from_toml("").to_config()
    del config["sea"]["alpha_coefficient"]
    rare = {"first_photon", "max_events", "max_surface_events"}
    rare |= {"r_min", "r_max", "capillary"}
    for section, table in config.items():
        for key in table if isinstance(table, dict) else {section: table}:
            assert key in rare or re.search(rf"\b{key} = ", text) or f"[{key}]" in text, key
