"""The page that reads through all figures."""

from __future__ import annotations

import html
import math
from pathlib import Path
from typing import Any

import pandas as pd

from meshtrace.files import atomic
from meshtrace.paper.records import INDEX, read_record
from meshtrace.paper.registry import FIGURES

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1f2933; max-width: 68rem; margin: 2rem auto;
       padding: 0 1rem; }
h1 { font-size: 1.7rem; } h2 { font-size: 1.2rem; margin-top: 3rem; }
nav { columns: 3 16rem; } nav a { display: block; } a { color: #0b5c8e; }
figure { margin: 1rem 0; } figure img { max-width: 100%; height: auto; }
figcaption { max-width: 48rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.9rem; }
th, td { border-bottom: 1px solid #d5dbe1; padding: 0.3rem 0.7rem; text-align: left;
         vertical-align: top; }
td:nth-child(4), td:nth-child(5) { white-space: nowrap; font-variant-numeric: tabular-nums; }
.note { color: #56616b; font-size: 0.9rem; }
"""


def write_index(folder: Path) -> None:
    """Write the page of all figures in a folder, with a list of the missing ones."""
    records = {name: read_record(folder / f"{name}.json") for name in FIGURES}
    found = [record for record in records.values() if record is not None]
    missing = [name for name, record in records.items() if record is None]
    body = "\n".join(_section(record) for record in found)
    links = "\n".join(f'<a href="#{r["name"]}">{html.escape(_heading(r))}</a>' for r in found)
    rest = f'<p class="note">Not drawn yet: {", ".join(missing)}.</p>' if missing else ""
    text = f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Figures of the water-to-air channel</title>
<style>{_STYLE}</style>
</head>
<body>
<h1>Figures of the water-to-air channel</h1>
<p>Each figure of the paper, redrawn by meshtrace. The tables set the printed numbers beside those
of the right physics (default) and of the forms as published (paper preset); numbers after &plusmn;
are standard errors. They come from the run that drew the picture; only the column of printed
values is taken from the paper.</p>
<nav>
{links}
</nav>
{rest}
{body}
</body>
</html>
"""
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
        "the paper prints": printed,
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
