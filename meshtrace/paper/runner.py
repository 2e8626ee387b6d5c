"""Drawing the figures into a folder: what is there already is kept."""

from __future__ import annotations

import csv
import hashlib
import json
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from meshtrace.files import atomic
from meshtrace.paper.registry import FIGURES, Drawing, Figure, Row, Setting, load
from meshtrace.stored import write_dataset

INDEX = "index.html"
_KINDS = (".png", ".nc", ".csv")
_SHARED = ("canvas", "links", "printed", "registry")
"""Modules that figures draw from."""

_COLUMNS = (
    "quantity",
    "unit",
    "printed",
    "place",
    "default",
    "default_stderr",
    "paper",
    "paper_stderr",
    "difference",
)


def make_figures(
    folder: str | Path,
    only: Sequence[str] | None = None,
    *,
    quick: bool = False,
    setting: Setting | None = None,
    tell: Callable[[str, dict[str, Any] | None], None] | None = None,
) -> list[dict[str, Any]]:
    """Draw figures of the paper into a folder, with one page to read through.

    Parameters
    ----------
    folder : path
        Where to; made if missing.
    only : sequence of str, optional
        Names of the figures, all by default; see `FIGURES`.
    quick : bool
        Fewer photons and seas.
    setting : Setting, optional
        Seed, threads, files of temperature and salinity.
    tell : callable, optional
        Called with the name of each figure and None before it is made, and with its record when
        it is done.

    Returns
    -------
    list of dict
        Records of the figures, as in the JSON files of the folder; "kept" says which were there.

    Raises
    ------
    ScenarioError
        If there is no such figure or a file of profiles cannot be read.

    Notes
    -----
    Each figure has a key: a digest of name, version, the sources of its module and of what all
    share, effort, seed and profiles. A figure whose record has the same key and whose files are all
    present is kept, so that an interrupted run goes on where it was.
    """
    from meshtrace.paper.index import write_index
    from meshtrace.paper.profile_files import profiles_of

    setting, folder = setting or Setting(), Path(folder)
    figures = [load(name) for name in only or FIGURES]
    if any(one.reads_profiles for one in figures):
        profiles_of(setting)  # refused before anything is drawn
    folder.mkdir(parents=True, exist_ok=True)
    records = []
    for one in figures:
        record = _kept(folder, one, key(one, setting, quick))
        if record is None:
            if tell is not None:
                tell(one.name, None)
            record = _made(folder, one, setting, quick)
            write_index(folder)
        if tell is not None:
            tell(one.name, record)
        records.append(record)
    write_index(folder)
    return records


def key(one: Figure, setting: Setting, quick: bool) -> str:
    """Return a digest of all that a figure depends on."""
    inputs = {
        "name": one.name,
        "version": version("meshtrace"),
        "source": _source(one),
        "effort": one.effort(quick),
        "seed": setting.seed,
        "profiles": [_digest(path) for path in setting.profiles] if one.reads_profiles else [],
    }
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()


def _source(one: Figure) -> str:
    """Return the source of a figure's module and of what all figures share."""
    here = Path(__file__).parent
    modules = {one.make.__module__.rpartition(".")[2], *_SHARED}
    return "".join(
        (here / f"{module}.py").read_text(encoding="utf-8") for module in sorted(modules)
    )


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _kept(folder: Path, one: Figure, wanted: str) -> dict[str, Any] | None:
    """Return the record of a figure that is there already."""
    record = read_record(folder / f"{one.name}.json")
    if record is None or record.get("key") != wanted:
        return None
    if not all((folder / (one.name + kind)).is_file() for kind in _KINDS):
        return None
    return {**record, "kept": True}


def read_record(path: Path) -> dict[str, Any] | None:
    """Return the record of a figure, None if there is none that can be read."""
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def _made(folder: Path, one: Figure, setting: Setting, quick: bool) -> dict[str, Any]:
    """Make a figure and write its files, the record last."""
    from meshtrace.paper.canvas import style

    record_path = folder / f"{one.name}.json"
    record_path.unlink(missing_ok=True)  # it vouches for the files
    wall, cpu = time.perf_counter(), time.process_time()
    with style():
        drawing = one.make(setting, **one.effort(quick))
        _write(folder / one.name, drawing)
    record = {
        "key": key(one, setting, quick),
        "name": one.name,
        "number": one.number,
        "title": one.title,
        "caption": drawing.caption,
        "quick": quick,
        "effort": one.effort(quick),
        "seed": setting.seed,
        "version": version("meshtrace"),
        "wall_s": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        "rows": [row._asdict() for row in drawing.rows],
    }
    with atomic(record_path) as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return {**record, "kept": False}


def _write(stem: Path, drawing: Drawing) -> None:
    from matplotlib.image import imsave

    with atomic(stem.with_suffix(".png")) as temporary:
        if hasattr(drawing.picture, "savefig"):
            drawing.picture.savefig(temporary)
        else:
            imsave(temporary, drawing.picture)
    write_dataset(drawing.data, stem.with_suffix(".nc"))
    with (
        atomic(stem.with_suffix(".csv")) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        table = csv.writer(file)
        table.writerow(_COLUMNS)
        table.writerows(_cells(row) for row in drawing.rows)


def _cells(row: Row) -> list[Any]:
    default, paper = row.default or ("", ""), row.paper or ("", "")
    printed = "" if row.printed is None else row.printed
    return [row.quantity, row.unit, printed, row.place, *default, *paper, row.difference]
