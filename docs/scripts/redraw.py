"""Redraw all kept pictures that are older than the code that draws them.

python docs/scripts/redraw.py [--all] [NAME ...]     # names of scripts, or of figures of the paper

A picture is stale if the digest of its inputs is another than the one in pictures.json, or if the
file is not the one that was drawn. Inputs are the drawing script, the functions, classes and
constants of `meshtrace.viz` and `paper` that it uses, directly or through others, the
names and units of variables in them; of a figure of the paper its function and its effort.
Comments, docstrings, blank lines and imports do not count, nor does the encoding of a file. The
engine and its tables are not among them: each edit would make all pictures stale, and tests
compare the numbers and the pictures that they give.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from places import DOCS, GENERATED, ROOT, STATIC

SCRIPTS = Path(__file__).parent
MANIFEST = GENERATED / "pictures.json"
KEPT, PAPER = DOCS / "gallery" / "pictures", DOCS / "extra" / "figures"
_MEASURED = ROOT / "meshtrace" / "apps" / "measured" / "data"
FIXED = {
    "make_bands_figure": ("fading_bands",),
    "make_daylight_table": ("daylight_ranges",),
    "make_design_figure": ("design",),
    "make_downlink_figure": ("downlink",),
    "make_explorer_pictures": (
        "explorer",
        "explorer_compare",
        "explorer_day",
        "explorer_design",
        "explorer_downlink",
        "explorer_phone",
    ),
    "make_measured_table": (
        "measured_forest",
        "measured_rows",
        *(
            f"measured_{name}".replace("-", "_")
            for name in (_MEASURED / "order.txt").read_text("utf-8").split()
            if 'abscissa = "row"' not in (_MEASURED / name / "experiment.toml").read_text("utf-8")
        ),
    ),
    "make_interleaving_figure": ("interleaving",),
    "make_modem_figure": ("modem",),
    "make_pixels_figure": ("pixels",),
    "make_tornado_figure": ("tornado",),
    "make_water_figure": ("water_spectra",),
    "make_which_colour_figure": ("which_colour",),
}
"""Scripts that write pictures into _static; tables named like a script come with its pictures."""

_VIZ, _PAPER = ROOT / "viz", ROOT / "examples" / "paper"
_ROWS = tomllib.loads((_PAPER / "rows.toml").read_text("utf-8"))["figures"]
_FIELDS = tomllib.loads((ROOT / "meshtrace" / "fields.toml").read_text("utf-8"))
_STUB = (_VIZ / "__init__.pyi").read_text("utf-8")
_HOMES = {name: home for home, name in re.findall(r"from \.(\w+) import (\w+)", _STUB)}
_ROOMS = {"meshtrace.viz": _VIZ, "paper": _PAPER}
Part = tuple[Path, str]  # a file and a name defined in it, "" for all other statements


@dataclass(frozen=True)
class Job:
    """Pictures that are drawn together."""

    name: str
    command: tuple[str, ...]
    folder: Path  # of the pictures
    sources: tuple[Path, ...]
    effort: str = ""
    root: str = ""  # name in the sources from which it is drawn, all by default

    def inputs(self) -> str:
        """Return the digest of all that draws the pictures."""
        texts = sorted(self.parts().values())  # whatever file they are in
        words = set(re.findall(r"\"(\w+)\"", "".join(texts)))
        fields = {name: row for name, row in _FIELDS.items() if name in words}
        parts = [*texts, json.dumps(fields, sort_keys=True), self.effort]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()

    def parts(self) -> dict[Part, str]:
        """Return the code that draws."""
        roots = [(path, self.root or name) for path in self.sources for name in defined(path)]
        return used(dict.fromkeys(roots))

    def outputs(self, listed: Iterable[str]) -> list[Path]:
        """Return the files of a job: those listed in the manifest for a script of the gallery."""
        if self.name in FIXED:
            return [self.folder / f"{stem}.png" for stem in FIXED[self.name]]
        if self.folder == PAPER:
            return [self.folder / (self.name + end) for end in (".png", ".nc")]
        return [ROOT / path for path in listed]

    def draw(self) -> list[Path]:
        """Run the script and return its files."""
        env = {**os.environ, "MPLBACKEND": "agg"}
        if self.folder == PAPER:
            (PAPER / f"{self.name}.json").unlink(missing_ok=True)  # finished ones are kept
        with tempfile.TemporaryDirectory(dir=DOCS) as work:
            subprocess.run(self.command, check=True, env=env, cwd=work)
            if self.folder != KEPT:
                return self.outputs(())
            return [path.replace(KEPT / path.name) for path in sorted(Path(work).iterdir())]


def jobs() -> list[Job]:
    """Return the jobs of all kept pictures."""
    python = sys.executable
    scripts = [(path, KEPT) for path in sorted((DOCS / "gallery").glob("*.py"))]
    scripts += [(SCRIPTS / f"{name}.py", STATIC) for name in FIXED]
    found = [Job(p.stem, (python, str(p)), folder, _sources(p)) for p, folder in scripts]
    figures = (python, str(_PAPER), "-o", str(PAPER), "--only")
    for name, row in _ROWS.items():
        about = json.dumps([row.get("full", {}), row.get("revision", 1)], sort_keys=True)
        found.append(Job(name, (*figures, name), PAPER, (_PAPER / f"{row['module']}.py",), about,
                         name.replace("-", "_")))  # fmt: skip
    return found


def _sources(script: Path) -> tuple[Path, ...]:
    explorer = ROOT / "meshtrace" / "apps" / "explorer"
    more = [*explorer.glob("*.py"), *(explorer / "assets").iterdir()]
    return script, *(sorted(more) if "explorer" in script.stem else ())


def used(roots: Iterable[Part]) -> dict[Part, str]:
    """Return the code of some definitions with that of all which they use."""
    found: dict[Part, str] = {}
    waiting = list(roots)
    while waiting:
        part = waiting.pop()
        path, name = part
        written = part == (_VIZ / "export.py", "save_picture")  # encodes what was drawn
        if written or part in found or not path.is_file() or name not in defined(path):
            continue
        nodes = defined(path)[name]
        found[part] = code(path, nodes)
        waiting += {place for node in nodes for place in _references(path, node)}
    return found


def defined(path: Path) -> dict[str, list[ast.stmt]]:
    """Return the statements of a file by the name that they define, "" for other ones."""
    return _statements(_python(path))


def _python(path: Path) -> str:
    return path.read_text("utf-8") if path.suffix == ".py" else ""


@cache
def _statements(text: str) -> dict[str, list[ast.stmt]]:
    found: dict[str, list[ast.stmt]] = {"": []}
    for node in ast.parse(text).body:
        names = {getattr(node, "name", "")}
        if isinstance(node, ast.Assign | ast.AnnAssign):
            names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and _stored(n)}
        for one in getattr(node, "decorator_list", ()):  # a case of a singledispatch function
            if isinstance(one, ast.Attribute) and isinstance(one.value, ast.Name):
                names.add(one.value.id)
        for name in names or {""}:
            found.setdefault(name, []).append(node)
    return found


def _stored(name: ast.Name) -> bool:
    return isinstance(name.ctx, ast.Store)


def _references(path: Path, node: ast.stmt) -> Iterator[Part]:
    """Yield the places that a statement names, other than in annotations."""
    known = {name: (path, name) for name in defined(path)} | _imports(_python(path))
    typed = {
        id(inner)
        for one in ast.walk(node)
        for hint in (getattr(one, "annotation", None), getattr(one, "returns", None))
        if hint is not None and not isinstance(node, ast.ClassDef)  # whose fields may be options
        for inner in ast.walk(hint)
    }
    for one in (inner for inner in ast.walk(node) if id(inner) not in typed):
        if isinstance(one, ast.Name) and one.id in known:
            yield known[one.id]
        if not isinstance(one, ast.Attribute):
            continue
        whole = ast.unparse(one.value)  # viz, marks, viz.marks
        if whole == "viz":
            yield _VIZ / f"{_HOMES.get(one.attr)}.py", one.attr
        elif whole.startswith("viz.") or whole in known:
            file = _VIZ / f"{whole[4:]}.py" if whole.startswith("viz.") else known[whole][0]
            yield file, one.attr


@cache
def _imports(text: str) -> dict[str, Part]:
    """Return the places of the names that a file imports from `viz` and `paper`."""
    found: dict[str, Part] = {}
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.ImportFrom):
            continue
        room, _, file = (node.module or "").rpartition(".")
        room, file = ("meshtrace.viz", node.module or "") if node.level else (room, file)
        if f"{room}.{file}" in _ROOMS:
            room, file = f"{room}.{file}", ""
        for alias in node.names if room in _ROOMS else ():
            home = file or _HOMES.get(alias.name, alias.name)
            name = alias.name if file or alias.name in _HOMES else ""  # "" for a module
            found[alias.asname or alias.name] = _ROOMS[room] / f"{home}.py", name
    return found


def code(path: Path, nodes: Iterable[ast.stmt]) -> str:
    """Return statements without docstrings, imports, lines of comments and blank lines."""
    text = path.read_text("utf-8")
    if path.suffix != ".py":
        return text
    kept: set[int] = set()
    for node in nodes:
        first = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", ()))])
        kept |= set(range(first, (node.end_lineno or node.lineno) + 1))
        for inner in ast.walk(node):
            text_alone = isinstance(inner, ast.Expr) and isinstance(inner.value, ast.Constant)
            if text_alone or isinstance(inner, ast.Import | ast.ImportFrom):
                kept -= set(range(inner.lineno, (inner.end_lineno or inner.lineno) + 1))
    lines = enumerate(text.splitlines(), 1)
    return "\n".join(line for i, line in lines if i in kept and line.split("#")[0].strip())


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read() -> dict[str, dict[str, object]]:
    """Return the manifest: inputs and files by job."""
    return dict(json.loads(MANIFEST.read_text("utf-8"))) if MANIFEST.exists() else {}


def stale(job: Job, manifest: dict[str, dict[str, object]]) -> str:
    """Return why pictures are stale, "" if they are not."""
    entry = manifest.get(job.name)
    if entry is None:
        return "not drawn by redraw.py"
    if entry["inputs"] != job.inputs():
        return "older than the code that draws it"
    listed: dict[str, str] = entry["files"]  # type: ignore[assignment]
    changed = [
        name for name, kept in listed.items()
        if not (ROOT / name).is_file() or digest(ROOT / name) != kept
    ]  # fmt: skip
    missing = {p.relative_to(ROOT).as_posix() for p in job.outputs(listed)} - set(listed)
    return f"not as drawn: {', '.join([*changed, *missing])}" if changed or missing else ""


def redraw(job: Job) -> None:
    """Draw the pictures of a job and note their digests."""
    inputs = job.inputs()
    files = {path.relative_to(ROOT).as_posix(): digest(path) for path in job.draw()}
    manifest = read()  # only now: another process may have drawn meanwhile
    before: dict[str, str] = manifest.get(job.name, {}).get("files", {})  # type: ignore[assignment]
    for name in before.keys() - files.keys():
        (ROOT / name).unlink(missing_ok=True)
    manifest[job.name] = {"inputs": inputs, "files": files}
    MANIFEST.write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def main(arguments: list[str]) -> None:
    """Redraw stale pictures, or all, or those named."""
    known, names = {job.name: job for job in jobs()}, [a for a in arguments if a != "--all"]
    if unknown := set(names) - known.keys():
        sys.exit(f"{', '.join(unknown)}: none of {', '.join(known)}")
    for job in [known[name] for name in names] or known.values():
        if names or "--all" in arguments or stale(job, read()):
            start = sum(os.times()[2:4])
            redraw(job)
            print(f"{job.name}: {sum(os.times()[2:4]) - start:.0f} CPU s", flush=True)
    subprocess.run([sys.executable, str(SCRIPTS / "make_figures_table.py")], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
