"""The pages of the documentation: their code runs, their commands and link files are right."""

import ast
import inspect
import os
import pkgutil
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import get_args, get_origin

import numpy as np
import pytest
from typer import Context
from typer.main import get_command

import meshtrace as mt
from meshtrace import cli
from meshtrace.engine.setup.options import Run
from meshtrace.models import Family, Model
from meshtrace.results.gain import FATE_MEANING
from meshtrace.scenario import Scenario
from meshtrace.surfaces import (
    JonswapSea,
    MeshSequence,
    Surface,
    from_gauge,
    from_wavespectra,
    gauge_spectrum,
)

DOCS = Path(__file__).parents[2] / "docs"
PAGE_NAMES = "quickstart default_link downlink receiver fading nonlinear".split()
PAGES = [DOCS / f"{name}.md" for name in PAGE_NAMES]
PAGES += sorted((DOCS / "guides").glob("*.md"))
PRINTING = re.compile(
    r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", re.MULTILINE | re.DOTALL
)
WRITTEN = [p for p in sorted(DOCS.rglob("*.md")) if not p.stem.endswith(("_table", "_file"))]
NUMBER = re.compile(r"(?<!\w)(?<!\d\.)[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]\d+)?")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINES_OF_KEYS = re.compile(r"^(- `.+?): (.*)$", re.MULTILINE)
COMMANDS = get_command(cli.app).commands
BUOY = "f,0,90,180,270\n0.1,1,2,1,0\n0.2,2,4,2,1\n0.3,1,1,1,1\n"


def blocks(page, language):
    return [text for found, text in BLOCK.findall(page.read_text("utf-8")) if found == language]


def pages_with(language):
    return [pytest.param(page, id=page.stem) for page in PAGES if blocks(page, language)]


def printed(page, folder):
    """Return the output of each block of a page; all blocks are one script."""
    script = folder / "page.py"
    codes = [code for code, _ in PRINTING.findall(page.read_text("utf-8"))]
    script.write_text("\nprint('\\x1e')\n".join(codes), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": ""},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split("\x1e\n")


def with_outputs(page, outputs):
    """Return the text of a page with these outputs below its blocks."""
    found = iter(outputs)

    def pair(match):
        output = next(found)
        below = f"\n```text\n{output.rstrip()}\n```\n" if output.strip() else ""
        return f"```python\n{match.group(1)}```\n{below}"

    return PRINTING.sub(pair, page.read_text("utf-8"))


def numbers(text):
    return [float(number.replace(",", "")) for number in NUMBER.findall(text)]


@pytest.mark.process
@pytest.mark.parametrize("page", pages_with("python"))
@pytest.mark.thorough
@pytest.mark.slow_but("quickstart", "own_models")
def test_code_runs_and_pages_show_what_it_prints(page, tmp_path, request):
    """`--update-golden` replaces the outputs. Numbers may differ by a change of the engine."""
    if page.stem == "sweep":
        pytest.importorskip("distributed")
    outputs = printed(page, tmp_path)
    if request.config.getoption("--update-golden"):
        page.write_text(with_outputs(page, outputs), encoding="utf-8")
    for output, (_, shown) in zip(outputs, PRINTING.findall(page.read_text("utf-8")), strict=True):
        words = [NUMBER.sub("0", text).split() for text in (output, shown)]
        assert words[0] == words[1]
        assert numbers(output) == pytest.approx(numbers(shown), rel=0.3)


COMMAND_OUTPUT = re.compile(
    r"^```sh\n(meshtrace \w+ link\.toml [^\n]*)\n```\n\n```text\n(.*?)^```$", re.M | re.S
)


def report_of(words, folder):
    """Return what a command prints about a link, without the line on its output file."""
    done = subprocess.run(
        [sys.executable, "-m", "meshtrace", *words[1:]],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": "", "COLUMNS": "100"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if not line.startswith("written to")]
    return "\n".join(lines).rstrip()


@pytest.mark.process
@pytest.mark.parametrize(
    "name",
    [
        *(pytest.param(f"design-{i}", marks=pytest.mark.slow) for i in range(3)),
        pytest.param("lidar-0", marks=pytest.mark.thorough),
    ],
)
def test_guides_show_what_their_commands_print(name, tmp_path, request):
    """`--update-golden` replaces the outputs; "..." at the end of one stands for its remainder."""
    page, index = DOCS / "guides" / f"{name[:-2]}.md", int(name[-1])
    text = page.read_text("utf-8")
    (tmp_path / "link.toml").write_text(blocks(page, "toml")[0], encoding="utf-8")
    command, shown = COMMAND_OUTPUT.findall(text)[index]
    report = report_of(shlex.split(command), tmp_path)
    shown = "".join(line for line in shown.splitlines(True) if not line.startswith("warning:"))
    if shown.endswith("...\n"):
        shown, report = shown[:-4], report.partition("FIGURES")[0]
    if request.config.getoption("--update-golden"):
        page.write_text(text.replace(shown.rstrip(), report.rstrip()), encoding="utf-8")
        return
    words = [NUMBER.sub("0", re.sub("─+", "─", part)).split() for part in (report, shown)]
    assert words[0] == words[1]
    assert numbers(report) == pytest.approx(numbers(shown), rel=0.3)


def own_classes(page):
    """Return the classes of a page as the module that its link files name."""
    tree = ast.parse("\n".join(blocks(page, "python")))
    kept = (ast.ClassDef, ast.Import, ast.ImportFrom)
    return "\n".join(ast.unparse(node) for node in tree.body if isinstance(node, kept))


@pytest.mark.parametrize("page", pages_with("toml"))
def test_link_files_load(page, tmp_path, monkeypatch):
    (tmp_path / "ring_wave.ply").touch()
    (tmp_path / "run").mkdir()
    (tmp_path / "buoy.csv").write_text(BUOY, encoding="utf-8")
    (tmp_path / "spectrum.csv").write_text("f [Hz],S\n0.1,0\n0.2,1\n0.3,0\n", encoding="utf-8")
    t = np.arange(0.0, 100.0, 0.1)
    np.savetxt(tmp_path / "gauge.csv", np.column_stack([t, np.cos(5.0 * t)]), delimiter=",")
    for i in range(2):
        (tmp_path / "run" / f"sea_{i}.vtp").touch()
    (tmp_path / "my_models.py").write_text(own_classes(page), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_models", raising=False)
    for text in blocks(page, "toml"):
        config = tomllib.loads(text)
        study = config.pop("sweep", {"parameters": {}})
        assert isinstance(Scenario.from_config(config, folder=tmp_path, trust=True), Scenario)
        assert set(study) <= {"realizations", "rtol", "photons", "seed", "store", "parameters"}


def command_lines(page):
    """Yield the words of each call of meshtrace: in blocks, after && too, and in running text."""
    text = page.read_text("utf-8")
    calls = re.split(r"\n|&&|\|", "\n".join(blocks(page, "sh") + blocks(page, "bash")))
    calls += re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S))
    for call in calls:
        program, _, arguments = call.strip().partition(" ")
        if program.removeprefix(".venv/bin/") == "meshtrace" and arguments:
            yield shlex.split(arguments, comments=True)


CHECKED = [*sorted(DOCS.rglob("*.md")), *sorted(DOCS.parent.glob("*.md"))]


@pytest.mark.parametrize("page", CHECKED, ids=lambda page: page.stem)
def test_commands_exist(page):
    program = get_command(cli.app)
    for name, *arguments in command_lines(page):
        command = program if name.startswith("-") else COMMANDS[name]
        parameters = command.get_params(Context(command))
        options = {option for p in parameters for option in (*p.opts, *p.secondary_opts)}
        used = {word.partition("=")[0] for word in (name, *arguments) if word.startswith("-")}
        assert used <= options, f"{name}: {used - options}"


def test_the_readme_has_the_commands_that_exist():
    text = (DOCS.parent / "README.md").read_text("utf-8")
    rows = re.findall(r"^\| (`.*?`) \|", text[text.index("| command |") :], re.MULTILINE)
    named = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert sorted(named) == sorted(COMMANDS)
    extras = tomllib.loads((DOCS.parent / "pyproject.toml").read_text("utf-8"))["project"]
    (line,) = re.findall(r"^Extras: (.*?)\n\n", text, re.MULTILINE | re.DOTALL)
    words = set(re.findall(r"`(?:.venv/bin/pip install \"\.\[)?(\w+)(?:\]\")?`", line))
    assert words == set(extras["optional-dependencies"]) - {"test", "docs", "lint"}


def test_quickstart_lists_all_commands():
    listed = set(re.findall(r"`(?:meshtrace )?([a-z]+)`", _section("quickstart.md", "| command |")))
    assert set(COMMANDS) <= listed


def test_concepts_list_all_fates():
    rows = re.findall(r"^\| `(\w+)` \| (.+) \|$", _section("concepts.md", "| fate |"), re.MULTILINE)
    assert dict(rows) == {fate.name.lower(): text for fate, text in FATE_MEANING.items()}


def _section(page, start):
    """Return the table that begins with a header."""
    text = (DOCS / page).read_text("utf-8")
    return text[text.index(start) :].split("\n\n")[0]


@pytest.mark.thorough
def test_link_file_page_is_that_of_the_models():
    """In another process: tests register kinds of their own."""
    code = "from make_link_file import PAGE, page; assert page() == PAGE.read_text('utf-8')"
    subprocess.run([sys.executable, "-c", code], cwd=DOCS / "scripts", check=True)


def link_file_sections():
    """Return the keys on the page of link files, by table, and all its lines of keys."""
    text = (DOCS / "link_file.md").read_text("utf-8")
    parts = re.split(r"^## \[+([\w.]+)\].*$", text, flags=re.MULTILINE)
    found = {}
    for name, part in zip(parts[1::2], parts[2::2], strict=True):
        heads = [head for head, _ in LINES_OF_KEYS.findall(part)]
        keys = re.findall(r"(?:^- |, )`([\w.]+)`", "\n".join(heads), re.MULTILINE)
        found.setdefault(name, set()).update(keys)
    return found, LINES_OF_KEYS.findall(text)


def tables_of(annotation):
    """Yield the models inside an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, Model):
        yield annotation
    for part in get_args(annotation):
        yield from tables_of(part)


LINK_TABLES = {
    "physics": [mt.Physics],
    "whitecaps": [mt.physics.Whitecaps],
    "sea": [*Surface.registered.values(), mt.Meshing],
    "water": [mt.Water],
    "bubbles": [*mt.optics.BubblePopulation.registered.values()],
    "transmitter": [*mt.sources.Source.registered.values()],
    "receiver": [*mt.receivers.Aperture.registered.values()],
    "planes": [mt.IrradiancePlanes],
    "detector": [mt.OokLink],
    "uav": [mt.Uav],
    "daylight": [mt.Daylight],
    "run": [Run, mt.Forced, mt.Analog],
}
OTHERWISE = {
    "kind",
    "source",
    "recipe",
    "record",
    "parts",
    "wavelength_nm of daylight",
    "spectrum of water",
    "wavelength_nm of water",
    "normals of sea",
}
"""Fields that another table gives, or that a reader fills."""
UNDER = {"components": "water.phase", "estimator": "run"}
UNDER |= dict.fromkeys(("gain_spectrum", "filter_transmission", "pde"), "detector.led.spectrum")
"""Fields whose models have the keys of another table."""


def test_every_key_and_nested_table_is_on_the_page_of_link_files():
    found, rows = link_file_sections()
    assert len(rows) > 200
    assert not [head for head, text in rows if not (text and re.search(r"= `|\(\S", head))]
    waiting = [(name, model) for name, models in LINK_TABLES.items() for model in models]
    seen = set()
    while waiting:
        table, model = waiting.pop()
        if (table, model) in seen or not model.__module__.startswith("meshtrace."):
            continue
        seen.add((table, model))
        for key, field in model.model_fields.items():
            if {key, f"{key} of {table}"} & OTHERWISE:
                continue
            kinds = list(tables_of(field.annotation))
            inner = UNDER.get(key, f"{table}.{key}")
            where = (table, "sea.spectrum") if model is JonswapSea else (table,)
            assert any(key in found[name] for name in where), (table, key)
            for kind in kinds:
                members = kind.registered.values() if issubclass(kind, Family) else (kind,)
                assert inner in found, inner
                waiting += [(inner, member) for member in members]
    assert len(seen) > 40


def test_keys_beside_files_are_on_the_page_of_link_files():
    found, _ = link_file_sections()
    for reader in (from_wavespectra, from_gauge, gauge_spectrum, MeshSequence):
        own = set(inspect.signature(reader).parameters) - {"source", "gauge", "kind"}
        assert own <= found["sea"], reader
    assert {"file", "mesh", "meshes"} <= found["sea"]
    assert "file" in found["water.phase"] & found["sea.spectrum"]


def test_each_sea_has_one_name_in_link_files():
    text = (DOCS / "link_file.md").read_text("utf-8")
    seas = re.findall(r"^- \*\*([\w-]+)\*\*: ", text[text.index("## [sea]") :], re.MULTILINE)
    assert seas.count("jonswap") == 1
    for name in ("sinusoidal", "tilted-plane"):
        with pytest.raises(mt.Refused, match=r"sea\.spectrum"):
            Scenario.from_toml(f"[sea]\nspectrum = '{name}'\nslope_x = 0.1")


def test_every_file_and_source_of_the_algorithms_exists():
    text = (DOCS / "algorithms.md").read_text("utf-8")
    for row in re.findall(r"^\|.*\|$", text, re.MULTILINE):
        folder = None
        for path in re.findall(r"`([\w/]+(?:\.py|/))`", row):
            folder = path.rpartition("/")[0] or folder
            assert (DOCS.parent / "meshtrace" / folder / path.rpartition("/")[2]).exists(), path
    named = set(re.findall(r"\[(\w+\d\d+)\]", text))
    assert named == set(re.findall(r"^\[(\w+)\] ", text, re.MULTILINE))


def test_every_public_name_has_a_page():
    """Compared as objects: a page may name one by its public name or by its module."""
    text = "".join(page.read_text("utf-8") for page in (DOCS / "api").glob("*.md"))
    names = re.findall(r"^   ~(\S+)$", text, re.MULTILINE)
    assert len(names) == len(set(names))
    listed = {name: pkgutil.resolve_name(name) for name in names}
    groups = [getattr(mt, name) for name in mt.__all__]
    for package in (mt, *filter(inspect.ismodule, groups)):
        for name in getattr(package, "__all__", ()):
            thing = getattr(package, name)
            if not (name.startswith("_") or inspect.ismodule(thing) or get_origin(thing)):
                assert any(thing is other for other in listed.values()), name


def test_every_group_of_the_api_is_in_the_index():
    index = (DOCS / "api" / "index.md").read_text("utf-8")
    pages = {page.stem for page in (DOCS / "api").glob("*.md")} - {"index"}
    assert set(re.findall(r"^(\w+)$", index, re.MULTILINE)) == pages


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: page.stem)
def test_pictures_have_words_for_those_who_do_not_see_them(page):
    text = page.read_text("utf-8")
    words = re.findall(r"!\[([^\]]*)\]\(", text)
    words += [re.sub(r".*\n:alt: |\n[^:].*", "", f, flags=re.S) for f in FIGURES.findall(text)]
    assert all(len(alt.split()) > 1 for alt in words), words


FIGURES = re.compile(r"^:::\{figure\} .*?^:::$", re.M | re.S)


def test_the_side_bar_is_short_and_by_task():
    groups = re.findall(
        r":caption: (.*)\n\n((?:[\w/]+\n)+)", (DOCS / "index.md").read_text("utf-8")
    )
    assert [name for name, _ in groups] == "Start|Learn|Do|Look up|Trust|Contribute".split("|")
    assert sum(len(pages.split()) for _, pages in groups) <= 16


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.stem)
def test_formulas_are_typeset(page):
    """The renderer knows each command of them, and no formula of the text is plain."""
    tex2mathml = pytest.importorskip("docutils.utils.math.latex2mathml").tex2mathml
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"`[^`]*`", "", text)
    formulas = re.compile(r"\$\$(.+?)\$\$|\$([^$]+)\$", re.DOTALL)
    for block, inline in formulas.findall(text):
        tex2mathml(block or inline, as_block=bool(block))
    assert not re.findall(r"\S*(?:\bint [A-Z]|\w\^[{(a-zA-Z]|\bexp\(-)\S*", formulas.sub("", text))
