"""Drawing of the figures into a folder with records and an index page; finished ones are kept."""

from __future__ import annotations

import hashlib
import html
import json
import math
import time
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import Any

import pandas as pd

from meshtrace.files import atomic
from meshtrace.stored import write_dataset
from paper.registry import FIGURES, Figure, FigureOutput, Setting, TableRow, load

INDEX = "index.html"


def write_record(path: Path, record: dict[str, Any]) -> None:
    """Write a record with its SHA-256 digest, atomically."""
    content = {**record, "digest": digest(record)}
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_record(path: Path) -> dict[str, Any] | None:
    """Return the record of a figure, None if it is missing or damaged."""
    try:
        record = dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError):
        return None
    return record if record.pop("digest", None) == digest(record) else None


def digest(record: dict[str, Any]) -> str:
    """Return the SHA-256 digest of a record."""
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


_PAGE = Template((Path(__file__).parent / "page.html").read_text(encoding="utf-8"))


def write_index(folder: Path) -> None:
    """Write the page of all figures in a folder, with a list of the missing ones."""
    records = {name: read_record(folder / f"{name}.json") for name in FIGURES}
    found = [record for record in records.values() if record is not None]
    missing = [name for name, record in records.items() if record is None]
    body = "\n".join(_section(record) for record in found)
    links = "\n".join(f'<a href="#{r["name"]}">{html.escape(_heading(r))}</a>' for r in found)
    rest = f'<p class="note">Not drawn yet: {", ".join(missing)}.</p>' if missing else ""
    text = _PAGE.substitute(links=links, rest=rest, body=body)
    with atomic(folder / INDEX) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _heading(record: dict[str, Any]) -> str:
    return f"Fig. {record['number']}: {record['title']}"


def _section(record: dict[str, Any]) -> str:
    name, title = record["name"], html.escape(_heading(record))
    table = pd.DataFrame([_cells(row) for row in record["rows"]]).to_html(
        index=False, escape=False, border=0, justify="unset"
    )
    mode = "quick" if record["quick"] else "full"
    effort = ", ".join(f"{k.replace('_', ' ')} {v}" for k, v in record["effort"].items())
    return f"""<section id="{name}">
<h2>{title}</h2>
<figure><img src="{name}.png" alt="{title}">
<figcaption>{html.escape(record["caption"])}</figcaption></figure>
<div class="wide">{table}</div>
<p class="note"><a href="{name}.nc">data</a> &middot; <a href="{name}.csv">table</a> &middot;
{html.escape(f"{mode} setting{': ' + effort if effort else ''}; seed {record['seed']}")} &middot;
{record["wall_s"]:.1f} s, {record["cpu_s"]:.1f} s of CPU</p>
</section>"""


def _cells(row: dict[str, Any]) -> dict[str, str]:
    """Return the cells of a row by the heading of their column."""
    printed = "&ndash;" if row["printed"] is None else f"{row['printed']:.4g}"
    if row["place"]:
        printed += f'<br><span class="note">{html.escape(row["place"])}</span>'
    return {
        "quantity": html.escape(row["quantity"]),
        "unit": html.escape(row["unit"]),
        "published": printed,
        "default": number_text(row["default"]),
        "paper preset": number_text(row["paper"]),
        "difference": html.escape(row["difference"]),
    }


def number_text(number: list[float] | tuple[float, float] | None) -> str:
    """Return a number with its standard error, rounded to the significant digits.

    Examples
    --------
    >>> number_text((5.9731e-5, 6.2e-8)), number_text((43.25, 0.0)), number_text(None)
    ('5.973e-05 &plusmn; 6e-08', '43.25', '&ndash;')
    """
    if number is None:
        return "&ndash;"
    value, error = number
    if not math.isfinite(value):
        return "none"
    if not error > 0.0 or not math.isfinite(error):
        return f"{value:.4g}"
    size = math.floor(math.log10(abs(value))) if value else 0
    digits = min(max(size - math.floor(math.log10(error)), 0), 8)
    text = f"{value:.{digits}e}" if abs(size) > 3 else f"{value:.{max(digits - size, 0)}f}"
    return f"{text} &plusmn; {error:.1g}"


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
    from paper.water import profiles_of

    setting, folder = setting or Setting(), Path(folder)
    report = on_figure or (lambda name, record: None)
    figures = [load(name) for name in only or FIGURES]
    if any(one.reads_profiles for one in figures):
        profiles_of(setting)  # refused before anything is drawn
    folder.mkdir(parents=True, exist_ok=True)
    records = []
    for one in figures:
        kept = read_record(folder / f"{one.name}.json")
        whole = all((folder / (one.name + kind)).is_file() for kind in _KINDS)
        if whole and kept is not None and kept.get("key") == key(one, setting, quick):
            record = {**kept, "kept": True}
        else:
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


def _made(folder: Path, one: Figure, setting: Setting, quick: bool) -> dict[str, Any]:
    """Make a figure and write its files, the record last."""
    from matplotlib import rc_context

    from meshtrace import viz

    record_path = folder / f"{one.name}.json"
    record_path.unlink(missing_ok=True)  # written last, so its presence marks the figure complete
    wall, cpu = time.perf_counter(), time.process_time()
    with rc_context(viz.style.RC), warnings.catch_warnings():  # not the user's settings
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


def _write(stem: Path, output: FigureOutput, rows: list[TableRow]) -> None:
    from meshtrace import viz

    viz.save_picture(output.picture, stem.with_suffix(".png"))
    if isinstance(output.picture, viz.ScenePlotter):
        output.picture.close()
    write_dataset(output.data, stem.with_suffix(".nc"))
    table = pd.DataFrame(rows)
    for place, form in ((5, "default"), (7, "paper")):
        table[form], errors = zip(*(n or (None, None) for n in table[form]), strict=True)
        table.insert(place, f"{form}_stderr", errors)
    with atomic(stem.with_suffix(".csv")) as temporary:
        table.to_csv(temporary, index=False)
