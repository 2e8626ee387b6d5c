"""Every numbered figure of the paper, redrawn from this package's own simulation.

Each figure is a picture, its data, and a table that sets what the paper prints beside what the
right physics and the printed forms give. `make_figures` draws them into a folder with one page
to read through. Needs the `viz` extra.
"""

from meshtrace.paper.registry import FIGURES, Drawing, Figure, Number, Row, Setting
from meshtrace.paper.runner import make_figures

__all__ = ["FIGURES", "Drawing", "Figure", "Number", "Row", "Setting", "make_figures"]
