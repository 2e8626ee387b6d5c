"""What contributors, users of a distribution and an index get: one version, links that lead."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import jinja2
import pytest
import yaml
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
PLACEHOLDER = "repository.invalid"
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
TEMPLATES = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.md"))
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / ".github").glob("*.md")])
CALLERS = [
    *PAGES,
    *WORKFLOWS,
    ROOT / "Makefile",
    ROOT / ".pre-commit-config.yaml",
    *(ROOT / ".devcontainer").iterdir(),
    *(path for path in (ROOT / ".ci").iterdir() if path.is_file()),
    ROOT / "docs" / "contributing.md",
]
LINK = re.compile(r"\]\((?!https?:)([^)]+)\)")


def text(*path):
    return ROOT.joinpath(*path).read_text("utf-8")


def recipe(pyproject=None):
    """Return the conda recipe as conda-build renders it."""

    def load_file_data(path, from_recipe_dir):
        file = ROOT / ".ci" / "conda" / path
        return tomllib.loads(file.read_text("utf-8") if pyproject is None else pyproject)

    given = {"load_file_data": load_file_data, "PYTHON": "python"}
    return yaml.safe_load(jinja2.Template(text(".ci", "conda", "meta.yaml")).render(given))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_to_files_and_headings(page):
    for link in LINK.findall(page.read_text("utf-8")):
        path, _, heading = link.partition("#")
        target = page.parent / path if path else page
        assert target.exists(), link
        titles = re.findall(r"^#+ (.+)$", target.read_text("utf-8"), re.M) if heading else ()
        assert not heading or heading in {title.lower().replace(" ", "-") for title in titles}, link


def long_description():
    """Return the README with the substitutions of the build hook."""
    config = tomllib.loads(text("pyproject.toml"))["tool"]["hatch"]["metadata"]["hooks"]
    description = text("README.md")
    for line in config["fancy-pypi-readme"]["substitutions"]:
        description = re.sub(line["pattern"], line["replacement"], description)
    return description.replace("$HFPR_VERSION", PROJECT["version"])


def test_the_long_description_links_to_the_files_of_its_release():
    description = long_description()
    assert not LINK.search(description)
    start = rf"{PROJECT['urls']['Repository']}/(blob|raw)/v{PROJECT['version']}/"
    links = re.findall(rf"(!?)\[[^\]]*\]\({start}([^)]+)\)", description)
    assert [path for *_, path in links] == LINK.findall(text("README.md"))
    assert all((form == "raw") == bool(picture) for picture, form, _ in links)


def test_the_address_of_the_repository_stands_in_one_place():
    holders = {"pyproject.toml", ".github/CODE_OF_CONDUCT.md", "RELEASING.md"}
    suffixes = {".md", ".toml", ".py", ".cff", ".yml", ".yaml", ".json", ".pyi", ""}
    for folder in (
        ".",
        ".ci",
        ".ci/conda",
        ".devcontainer",
        ".github",
        ".github/workflows",
        "docs",
    ):
        for path in (ROOT / folder).iterdir():
            if path.is_file() and path.suffix in suffixes and path.name != ".git":
                name = path.relative_to(ROOT).as_posix()
                assert (PLACEHOLDER in path.read_text("utf-8")) == (name in holders), name
    assert all(PLACEHOLDER in url for url in PROJECT["urls"].values())


def test_one_version():
    citation = yaml.safe_load(text("CITATION.cff"))
    assert citation["version"] == recipe()["package"]["version"] == PROJECT["version"]
    assert 'release = installed("meshtrace")' in text("docs", "conf.py")
    assert (citation["license"], citation["keywords"]) == (PROJECT["license"], PROJECT["keywords"])


@pytest.mark.skipif(sys.platform != "linux", reason="sed of GNU")
def test_the_command_of_a_release_sets_every_version(tmp_path):
    command = re.search(r"sed -i -E .*", text("RELEASING.md"))[0]
    for name in ("pyproject.toml", "CITATION.cff"):
        shutil.copy(ROOT / name, tmp_path)
    subprocess.run(command.replace("0.2.0", "7.8.9"), shell=True, cwd=tmp_path, check=True)
    changed = (tmp_path / "pyproject.toml").read_text("utf-8")
    assert tomllib.loads(changed)["project"]["version"] == "7.8.9"
    assert yaml.safe_load((tmp_path / "CITATION.cff").read_text("utf-8"))["version"] == "7.8.9"
    assert recipe(changed)["package"]["version"] == "7.8.9"
    assert changed.count("7.8.9") == 1


def test_the_recipe_has_the_dependencies_of_the_package():
    needs = recipe()["requirements"]
    python = f"python {PROJECT['requires-python']}"
    assert python in needs["host"]
    # a recipe for all platforms has no markers: conda-forge packs these by platform
    plain = [line.partition(";")[0] for line in PROJECT["dependencies"]]
    expected = [Requirement(line) for line in (python, *plain)]
    assert [Requirement(line) for line in needs["run"]] == expected
    build = tomllib.loads(text("pyproject.toml"))["build-system"]["requires"]
    assert {Requirement(line) for line in build} <= {Requirement(line) for line in needs["host"]}
    commands = dict(line.split(" = ") for line in recipe()["build"]["entry_points"])
    assert commands == PROJECT["scripts"]


@pytest.mark.parametrize("page", CALLERS, ids=lambda page: page.name)
def test_called_scripts_and_targets_exist(page):
    targets = set(re.findall(r"^(\w+):", text("Makefile"), re.M))
    called = page.read_text("utf-8")
    for name in re.findall(r"(?<![\w/])\.ci/([a-z]+)\b", called):
        path = ROOT / ".ci" / name
        assert path.is_dir() or os.access(path, os.X_OK), name
    for words in re.findall(r"(?:^|`|run: |&& |\$ )make ((?:[a-z]+ ?)+)", called, re.M):
        assert set(words.split()) <= targets, words


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_call_scripts_of_the_repository(workflow):
    """Checks stand in .ci/ alone: a step installs, or calls a script or a target."""
    jobs = yaml.safe_load(workflow.read_text("utf-8"))["jobs"]
    commands = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    assert {"run", "floors", "wheel"} <= set(re.findall(r"\.ci/(\w+)", " ".join(commands)))
    for command in commands:
        assert re.match(r"(\.ci/|make |python -m venv |(\.venv/bin/)?pip install )", command), (
            command
        )


@pytest.mark.parametrize("template", TEMPLATES, ids=lambda path: path.stem)
def test_templates_of_issues_have_a_name(template):
    _, head, body = template.read_text("utf-8").split("---\n", 2)
    assert set(yaml.safe_load(head)) == {"name", "about", "labels"}
    assert body.strip()


def test_hooks_and_containers_are_readable():
    (local,) = yaml.safe_load(text(".pre-commit-config.yaml"))["repos"]
    assert {"ruff", "ruff-format", "mypy", "imports"} <= {hook["id"] for hook in local["hooks"]}
    build = json.loads(text(".devcontainer", "devcontainer.json"))["build"]
    stages = re.findall(r"^FROM \S+ AS (\w+)$", text(".devcontainer", build["dockerfile"]), re.M)
    assert build["target"] in stages


def test_the_changelog_begins_with_this_or_the_next_version():
    heading, version, state = re.search(
        r"^## (([\d.]+) \((unreleased|\d{4}-\d\d-\d\d)\))$", text("CHANGELOG.md"), re.M
    ).groups()
    if state == "unreleased":
        assert Version(version) >= Version(PROJECT["version"]), heading
    else:
        assert version == PROJECT["version"], heading


def test_the_paper_for_a_journal_cites_what_the_documentation_cites():
    paper, entries = text("docs", "joss", "paper.md"), text("docs", "joss", "paper.bib")
    body = paper.split("---\n", 2)[2]
    assert 600 <= len(body.split()) <= 1000
    assert set(re.findall(r"@(\w+)", body)) == set(re.findall(r"^@\w+\{(\w+),", entries, re.M))
    sources = [*(ROOT / "docs").glob("*.md"), *(ROOT / "meshtrace").rglob("*.py")]
    sources += [*(ROOT / "surfaces").glob("*.py")]
    known = "".join(path.read_text("utf-8") for path in sources)
    for doi in re.findall(r"doi = \{(.+)\}", entries):
        assert doi in known, doi
    for author in yaml.safe_load(text("CITATION.cff"))["authors"]:
        assert f"- name: {author['name']}\n" in paper


@pytest.mark.thorough
def test_the_first_change_of_the_documentation_passes():
    code = re.search(r"```python\n(.*?)```", text("docs", "contributing.md"), re.DOTALL)[1]
    room = {}
    exec(compile(code, "docs/contributing.md", "exec"), room)
    room["test_twice_the_absorption"]()
    ratio = room["gain"](0.2) / room["gain"](0.1)
    assert f"The ratio is {ratio:.7f}" in text("docs", "contributing.md")


def repository_files():
    """Return the names of all files of the tree but those that builds and tests write."""
    written = re.compile(
        r"(^|/)(__pycache__|\.\w+_cache|[\w.]+\.egg-info|build|dist)/|\.py[co]$|\.nb[ic]$"
        r"|^\.(git|venv\w*|hypothesis|benchmarks|import_linter_cache|coverage)(/|$)"
        r"|^docs/(_build|api/generated|examples)/|^docs/sg_execution_times.rst$"
    )
    walk = os.walk(ROOT)
    names = (
        Path(folder, name).relative_to(ROOT).as_posix() for folder, _, ns in walk for name in ns
    )
    return {name for name in names if not written.search(name)}


def test_no_file_is_a_link():
    """A clone or an archive without symbolic links would have a line of text in its place."""
    assert [name for name in repository_files() if (ROOT / name).is_symlink()] == []
    assert not any((ROOT / "meshtrace" / name).exists() for name in ("surfaces", "viz"))


@pytest.mark.process
@pytest.mark.skipif(not shutil.which("git"), reason="git reads .gitignore")
def test_no_file_of_the_repository_is_ignored(tmp_path):
    """Distributions leave out what .gitignore names, data files of the package included."""
    names = sorted(repository_files())
    subprocess.run(["git", "init", "--quiet", tmp_path], check=True)
    git = ["git", f"--git-dir={tmp_path / '.git'}", f"--work-tree={ROOT}"]
    check = [*git, "check-ignore", "--no-index", "--stdin"]
    done = subprocess.run(check, input="\n".join(names), capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 1, done.stdout + done.stderr  # 1: none of them


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("uv"), reason="uv builds")
def test_distributions_are_complete(tmp_path):
    """The source distribution has every file, the wheel built from it the package alone."""
    subprocess.run(["uv", "build", "--quiet", "--out-dir", tmp_path], cwd=ROOT, check=True)
    (sdist,), (wheel,) = tmp_path.glob("*.tar.gz"), tmp_path.glob("*.whl")
    with tarfile.open(sdist) as packed:
        names = {m.name.partition("/")[2] for m in packed.getmembers() if not m.isdir()}
    assert names - {"PKG-INFO"} == repository_files()
    assert sdist.stat().st_size < 15e6
    with zipfile.ZipFile(wheel) as packed:
        (metadata,) = [name for name in packed.namelist() if name.endswith("METADATA")]
        assert long_description() in packed.read(metadata).decode()
        names = {name for name in packed.namelist() if ".dist-info/" not in name}
    beside = {f"meshtrace/{n}" for n in repository_files() if n.startswith(("surfaces/", "viz/"))}
    assert names == beside | {n for n in repository_files() if n.startswith("meshtrace/")}
    assert wheel.stat().st_size < 1.1e6
