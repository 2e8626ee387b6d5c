"""Redraw all kept pictures that are older than the code and data that draw them.

python docs/redraw.py [--all] [NAME ...]     # names of scripts, or of figures of the paper

A picture is stale if the digest of its inputs is another than the one in pictures.json, or if the
file is not the one that was drawn. Inputs are the drawing script, the modules of `meshtrace.viz`
that it uses with those that they import, the names and units of variables in them, and the tables
of optical data; of a figure of the paper its modules of `meshtrace.paper` and its effort, too.
Comments, docstrings, blank lines and imports do not count. The engine is not among them: each edit
of it would make all pictures stale, and tests compare the numbers and the pictures that it gives.
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
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent
MANIFEST = DOCS / "pictures.json"
STATIC, KEPT, PAPER = DOCS / "_static", DOCS / "gallery" / "pictures", DOCS / "extra" / "figures"
_MEASURED = ROOT / "meshtrace" / "validation" / "measured" / "data"
FIXED = {
    "make_bands_figure": ("fading_bands",),
    "make_daylight_table": ("daylight_ranges",),
    "make_downlink_figure": ("downlink",),
    "make_explorer_pictures": ("explorer", "explorer_day", "explorer_downlink"),
    "make_measured_table": tuple(
        f"measured_{name}".replace("-", "_")
        for name in (_MEASURED / "order.txt").read_text("utf-8").split()
    ),
    "make_interleaving_figure": ("interleaving",),
    "make_tornado_figure": ("tornado",),
}
"""Scripts that write pictures into _static; tables named like a script come with its pictures."""

_VIZ, _PAPER = ROOT / "viz", ROOT / "meshtrace" / "paper"
_ROWS = tomllib.loads((_PAPER / "rows.toml").read_text("utf-8"))["figures"]
_FIELDS = tomllib.loads((ROOT / "meshtrace" / "fields.toml").read_text("utf-8"))
_STUB = (_VIZ / "__init__.pyi").read_text("utf-8")
_HOMES = {name: home for home, name in re.findall(r"from \.(\w+) import (\w+)", _STUB)}
_USES = re.compile(r"\bviz\.(\w+)|from meshtrace\.viz(?:\.\w+)? import \(?([\w\s,]+)")
_MODULES = re.compile(r"from (?:meshtrace\.viz)?\.(\w+) import|from \. import ([\w, ]+)")


@dataclass(frozen=True)
class Job:
    """Pictures that are drawn together."""

    name: str
    command: tuple[str, ...]
    folder: Path  # of the pictures
    sources: tuple[Path, ...]
    effort: str = ""

    def inputs(self) -> str:
        """Return the digest of all that draws the pictures."""
        texts = [code(path) for path in closure(self.sources)]
        words = set(re.findall(r"\"(\w+)\"", "".join(texts)))
        fields = {name: row for name, row in _FIELDS.items() if name in words}
        tables = sorted(
            p for p in (ROOT / "meshtrace" / "optics" / "data").iterdir() if p.is_file()
        )
        parts = [*texts, json.dumps(fields, sort_keys=True), self.effort, *map(digest, tables)]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()

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
    scripts += [(DOCS / f"{name}.py", STATIC) for name in FIXED]
    found = [Job(p.stem, (python, str(p)), folder, _sources(p)) for p, folder in scripts]
    figures = (python, "-m", "meshtrace", "figures", "-o", str(PAPER), "--only")
    for name, row in _ROWS.items():
        about = json.dumps([row.get("full", {}), row.get("revision", 1)], sort_keys=True)
        found.append(Job(name, (*figures, name), PAPER, (_PAPER / f"{row['module']}.py",), about))
    return found


def _sources(script: Path) -> tuple[Path, ...]:
    explorer = ROOT / "meshtrace" / "explorer"
    more = [*explorer.glob("*.py"), *(explorer / "assets").iterdir()]
    return script, *(sorted(more) if "explorer" in script.stem else ())


def closure(sources: Iterable[Path]) -> list[Path]:
    """Return sources with the modules of `viz` and `paper` that they use, and that those import."""
    found, waiting = set(), list(sources)
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        text = path.read_text("utf-8")
        names = {n for pair in _USES.findall(text) for n in re.findall(r"\w+", " ".join(pair))}
        modules = {_HOMES.get(name, name) for name in names}
        modules |= {
            n for pair in _MODULES.findall(text) for n in re.findall(r"\w+", " ".join(pair))
        }
        waiting += [_VIZ / f"{m}.py" for m in modules if (_VIZ / f"{m}.py").is_file()]
        rooms = re.findall(r"from meshtrace\.paper\.(\w+) import", text)
        waiting += [_PAPER / f"{m}.py" for m in rooms if m != "registry"]
    return sorted(found)


def code(path: Path) -> str:
    """Return a text without docstrings, imports, lines of comments and blank lines, if Python."""
    text = path.read_text("utf-8")
    if path.suffix != ".py":
        return text
    dropped: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        for one in getattr(node, "body", ()) if isinstance(getattr(node, "body", ()), list) else ():
            text_alone = isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant)
            if text_alone or isinstance(one, ast.Import | ast.ImportFrom):
                dropped |= set(range(one.lineno, (one.end_lineno or one.lineno) + 1))
    lines = enumerate(text.splitlines(), 1)
    kept = (line for i, line in lines if i not in dropped and line.split("#")[0].strip())
    return "\n".join(kept)


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
        return "older than the code or data that draws it"
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
    subprocess.run([sys.executable, str(DOCS / "make_figures_table.py")], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
