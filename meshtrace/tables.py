"""Aligned text tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from io import StringIO


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
