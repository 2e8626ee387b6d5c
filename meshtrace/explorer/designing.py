"""Design of a link in a separate process, beside the page, and its texts."""

from __future__ import annotations

import asyncio
import math
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from meshtrace.errors import Described, Refused
from meshtrace.explorer.controls import BY_NAME
from meshtrace.explorer.readings import bit_error_rate, minus
from meshtrace.scenario import Scenario
from meshtrace.studies.designs.page import LIGHTS, BestValue, Design, Reach

_DESIGN = """
import sys
import meshtrace as mt
try:
    scenario = mt.Scenario.load(sys.argv[1], trust=True)
    mt.design(scenario).save(sys.argv[2])
except mt.Refused as error:
    sys.exit(str(error))
"""


async def design_of(scenario: Scenario) -> Design:
    """Return `mt.design(scenario)` of another process, which ends if this task is cancelled.

    Raises
    ------
    Refused
        If the design is refused or the process fails, by the last line of its error.
    """
    with TemporaryDirectory(prefix="meshtrace-") as folder:
        link, made = Path(folder, "link.toml"), Path(folder, "design.nc")
        link.write_text(scenario.to_toml(), encoding="utf-8")
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-c", _DESIGN, str(link), str(made),
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        try:
            _, said = await process.communicate()
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if process.returncode:
            lines = said.decode(errors="replace").strip().splitlines() or ["ended without a word"]
            raise Refused("design", Described(lines[-1]), "a link that can be designed")
        return Design.load(made)


def design_reading(found: Design) -> dict[str, Any]:
    """Return the page of a design as texts: answer, tables of (title, head, rows) and notes.

    Values are in the units of the controls.
    """
    both = "each alone"
    remarks = [f"{_scale(c.key, '')[0]}: {c.note}" for c in found.choices if c.note]
    return {
        "answer": [line.strip().replace("+-", "±") for line in found.answer],
        "tables": [
            _table("Figures", ("", *LIGHTS), _figures(found)),
            _table(f"Best values, {both}", ("", "given", *LIGHTS), _best(found.choices, True)),
            _table("Best lens, view and filter together", ("", "given", *LIGHTS),
                   [*_best(found.together, False), _together(found)]),
            _table(f"Just closes, {both}", ("", "given", *LIGHTS), _reach(found)),
            _table("Budget", ("", *LIGHTS, "unit"), _budget(found)),
        ],
        "notes": [*dict.fromkeys(remarks), *found.notes, *filter(None, [found.status])],
        "text": found.summary(),
    }  # fmt: skip


def _table(title: str, head: tuple[str, ...], rows: list[list[str]]) -> dict[str, Any]:
    return {"title": title, "head": head, "rows": rows}


def _figures(found: Design) -> list[list[str]]:
    columns = [
        (
            f"{f.outage[0]:.2g} ({f.outage[1]:.2g} … {f.outage[2]:.2g})",
            bit_error_rate(f.ber[0]),
            f"{f.margin:.1f} dB",
            f"{f.reserve:.1f} ± {f.reserve_stderr:.1f} dB",
            f"{f.capacity / 1e6:.3g} Mbit/s",
        )
        for f in found.figures
    ]
    names = ("Outage", "Mean bit error rate", "Margin of the mean",
             f"Reserve, outage {100.0 * found.outage:g} %", "Capacity")  # fmt: skip
    return [list(map(minus, row)) for row in zip(names, *columns, strict=True)]


def _best(choices: tuple[BestValue, ...], alone: bool) -> list[list[str]]:
    """Return a row for each key: value as given, best by each light with its flat range."""
    rows = []
    for key in dict.fromkeys(c.key for c in choices):
        mine = [c for c in choices if c.key == key]
        name, unit = _scale(key, mine[0].unit)
        cells = []
        for c in mine:
            flat = f"({c.flat[0] * unit:.3g} … {c.flat[1] * unit:.3g})"
            gained = f", {round(c.gained, 1) + 0.0:+.1f} dB" if alone else ""
            cells.append(f"{c.best * unit:.3g} {flat}{gained}")
        rows.append([name, f"{mine[0].given * unit:.3g}", *map(minus, cells)])
    return rows


def _together(found: Design) -> list[str]:
    gained = {c.light: f"{c.gained:+.1f} ± {c.gained_stderr:.1f} dB" for c in found.together}
    return ["Gained", "", *(minus(gained.get(light, "–")) for light in LIGHTS)]


def _reach(found: Design) -> list[list[str]]:
    rows = []
    for key in dict.fromkeys(r.key for r in found.reach):
        mine = [r for r in found.reach if r.key == key]
        name, unit = _scale(key, mine[0].unit)
        cells = ["none" if math.isnan(r.value) else f"{_side(r)} {r.value * unit:.3g}"
                 for r in mine]  # fmt: skip
        rows.append([name, f"{mine[0].given * unit:.3g}", *cells])
    return rows


def _side(row: Reach) -> str:
    """Return the side on which a link closes; a whole scan says nothing beyond its end."""
    if row.note == "end of the scan":
        return {"at least": "all from", "at most": "all to"}[row.side]
    return {"at least": "≥", "at most": "≤"}[row.side]


def _budget(found: Design) -> list[list[str]]:
    return [
        [
            f"= {line.name}" if line.total else line.name,
            *(minus(f"{round(value, 1) + 0.0:.1f}") for value in (line.night, line.day)),
            line.unit,
        ]
        for line in found.budget
    ]


def _scale(key: str, unit: str) -> tuple[str, float]:
    """Return the label of the control of a key with the unit, and its scale."""
    for control in BY_NAME.values():
        if key in control.keys:
            return f"{control.label} [{control.unit}]", control.per_unit
    return f"{key} [{unit}]", 1.0
