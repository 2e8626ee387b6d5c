"""Index page of all figures."""

from __future__ import annotations

import html
import math
from pathlib import Path
from string import Template
from typing import Any

import pandas as pd

from meshtrace.files import atomic
from meshtrace.paper.records import INDEX, read_record
from meshtrace.paper.registry import FIGURES

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
