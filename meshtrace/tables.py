"""Tables of text: files of numbers in columns are read, aligned rows are written."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused, reads_as_number, reason_of

_LARGEST = 16 * 2**20  # bytes


class Columns(NamedTuple):
    """Numbers of a file, shape (rows, columns), and the words of its header, if it has one."""

    header: tuple[str, ...]
    values: NDArray[np.float64]


def read_columns(
    path: str | PathLike[str], least: int = 2, delimiter: str | None = None
) -> Columns:
    """Read a text file of numbers in columns.

    Parameters
    ----------
    path : path
        Columns separated by commas, semicolons (numbers may then have decimal commas), tabs or
        spaces; ``#`` begins a comment, and a first line with words is a header.
    least : int
        Number of columns needed.
    delimiter : str, optional
        Separator of the columns, by default the one in use.

    Returns
    -------
    Columns

    Raises
    ------
    Refused
        If it is no such file, has fewer columns, or a value is no finite number.
    """
    file, allowed = Path(path), f"a text file of {least} or more columns of numbers"
    if not file.is_file():
        raise Refused(str(path), Described("no such file"), allowed)
    if file.stat().st_size > _LARGEST:
        raise Refused(str(path), Described("above 16 MB"), allowed)
    try:
        rows = [line.partition("#")[0].strip() for line in file.read_text("utf-8-sig").splitlines()]
    except (OSError, ValueError) as error:
        raise Refused(str(path), Described(reason_of(error)), allowed) from error
    rows = [row for row in rows if row]
    separator = delimiter or next((s for s in ";,\t" if rows and s in rows[-1]), None)
    cells = [
        [word.strip().replace(",", ".") if separator == ";" else word.strip() for word in words]
        for words in (row.split(separator) for row in rows)
    ]
    header = () if not cells or all(map(reads_as_number, cells[0])) else tuple(cells.pop(0))
    try:
        width = min(map(len, cells), default=0)  # remarks may follow
        values = np.array([row[:width] for row in cells], dtype=np.float64)
    except ValueError as error:
        raise Refused(str(path), Described(reason_of(error)), allowed) from error
    if values.ndim != 2 or values.shape[1] < least or not np.isfinite(values).all():
        found = " x ".join(map(str, values.shape))
        raise Refused(str(path), Described(f"{found} values"), f"{allowed}, all finite")
    return Columns(header, values)


def text_table(rows: Iterable[Sequence[str]], headings: Sequence[str] = ()) -> str:
    """Return rows as an aligned table of text, under headings if there are any.

    Examples
    --------
    >>> print(text_table([("gain", "1e-5"), ("chains", "64")], ("quantity", "value")))
    quantity   value
    ────────────────
    gain       1e-5
    chains     64
    """
    from rich.box import Box
    from rich.console import Console
    from rich.table import Table

    # columns two spaces apart; a rule below the headings
    box = Box("    \n    \n ── \n    \n    \n    \n    \n    \n") if headings else None
    table = Table(*headings, box=box, show_header=bool(headings), padding=(0, 2, 0, 0))
    table.pad_edge, table.show_edge = False, False
    for row in rows:
        table.add_row(*row)
    console = Console(file=StringIO(), width=1000, markup=False, highlight=False, emoji=False)
    console.print(table)
    text: str = console.file.getvalue()  # type: ignore[attr-defined]
    return "\n".join(line.rstrip() for line in text.splitlines())
