"""Drawing of the figures into a folder; finished ones are kept."""

from __future__ import annotations

import hashlib
import time
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from meshtrace.files import atomic
from meshtrace.paper.index import write_index
from meshtrace.paper.records import digest, read_record, write_record
from meshtrace.paper.registry import FIGURES, Figure, FigureOutput, Row, Setting, load
from meshtrace.stored import write_dataset

_KINDS = (".png", ".nc", ".csv")


def make_figures(
    folder: str | Path,
    only: Sequence[str] | None = None,
    *,
    quick: bool = False,
    setting: Setting | None = None,
    on_figure: Callable[[str, dict[str, Any] | None], None] | None = None,
) -> list[dict[str, Any]]:
    """Draw figures of the paper into a folder, with an index page.

    Parameters
    ----------
    folder : path
        Folder to write to; made if missing.
    only : sequence of str, optional
        Names of the figures, all by default; see `FIGURES`.
    quick : bool
        Fewer photons and seas.
    setting : Setting, optional
        Seed, threads, files of temperature and salinity.
    on_figure : callable, optional
        Called with the name of each figure and None before it is drawn, and with its record
        afterwards.

    Returns
    -------
    list of dict
        Records of the figures, as in the JSON files of the folder, and whether they were kept.

    Raises
    ------
    Refused
        If there is no such figure or a file of profiles cannot be read.

    Notes
    -----
    Each figure has a key: a digest of its name and revision, the version, effort, seed and
    profiles. A figure whose record has the same key and whose files are all present is kept, so
    that an interrupted run resumes.
    """
    from meshtrace.paper.profiles import profiles_of

    setting, folder = setting or Setting(), Path(folder)
    report = on_figure or (lambda name, record: None)
    figures = [load(name) for name in only or FIGURES]
    if any(one.reads_profiles for one in figures):
        profiles_of(setting)  # refused before anything is drawn
    folder.mkdir(parents=True, exist_ok=True)
    records = []
    for one in figures:
        record = _kept(folder, one, key(one, setting, quick))
        if record is None:
            report(one.name, None)
            record = _made(folder, one, setting, quick)
            write_index(folder)
        report(one.name, record)
        records.append(record)
    write_index(folder)
    return records


def key(one: Figure, setting: Setting, quick: bool) -> str:
    """Return the digest of the inputs of a figure."""
    files = setting.profiles if one.reads_profiles else ()
    inputs = {
        "name": one.name,
        "version": version("meshtrace"),
        "revision": one.revision,
        "effort": one.effort(quick),
        "seed": setting.seed,
        "profiles": [hashlib.sha256(path.read_bytes()).hexdigest() for path in files],
    }
    return digest(inputs)


def _kept(folder: Path, one: Figure, wanted: str) -> dict[str, Any] | None:
    """Return the record of a finished figure."""
    record = read_record(folder / f"{one.name}.json")
    whole = all((folder / (one.name + kind)).is_file() for kind in _KINDS)
    if record is None or record.get("key") != wanted or not whole:
        return None
    return {**record, "kept": True}


def _made(folder: Path, one: Figure, setting: Setting, quick: bool) -> dict[str, Any]:
    """Make a figure and write its files, the record last."""
    from meshtrace.paper.canvas import style

    record_path = folder / f"{one.name}.json"
    record_path.unlink(missing_ok=True)  # written last, so its presence marks the figure complete
    wall, cpu = time.perf_counter(), time.process_time()
    with style(), warnings.catch_warnings():
        # the figures are those of the paper's bands, and their captions state the missing waves
        warnings.filterwarnings("ignore", "waves: .* give a scintillation index")
        output = one.make(setting, **one.effort(quick))
        rows = one.table(output)
        _write(folder / one.name, output, rows)
    record = {
        "key": key(one, setting, quick),
        **{name: getattr(one, name) for name in ("name", "number", "title")},
        "caption": one.text(output),
        "quick": quick,
        "effort": one.effort(quick),
        "seed": setting.seed,
        "version": version("meshtrace"),
        "wall_s": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        "rows": [row._asdict() for row in rows],
    }
    write_record(record_path, record)
    return {**record, "kept": False}


def _write(stem: Path, output: FigureOutput, rows: list[Row]) -> None:
    import pandas as pd
    from matplotlib.image import imsave

    with atomic(stem.with_suffix(".png")) as temporary:
        if hasattr(output.picture, "savefig"):
            output.picture.savefig(temporary)
        else:
            imsave(temporary, output.picture)
    write_dataset(output.data, stem.with_suffix(".nc"))
    table = pd.DataFrame(rows)
    for place, form in ((5, "default"), (7, "paper")):
        table[form], errors = zip(*(n or (None, None) for n in table[form]), strict=True)
        table.insert(place, f"{form}_stderr", errors)
    with atomic(stem.with_suffix(".csv")) as temporary:
        table.to_csv(temporary, index=False)
