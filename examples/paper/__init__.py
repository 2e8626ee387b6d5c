"""Every numbered figure of the paper, redrawn from this package's own simulation.

Each figure is a picture, its data, and a table of the published numbers beside those of the correct
physics and of the forms as published. `make_figures` draws them into a folder with an index
page. Texts and printed numbers are in rows.toml. Needs the `viz` extra.
"""

from paper.registry import FIGURES, Figure, FigureOutput, Number, Setting, TableRow
from paper.runner import make_figures

__all__ = ["FIGURES", "Figure", "FigureOutput", "Number", "Setting", "TableRow", "make_figures"]
