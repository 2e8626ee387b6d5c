"""Faults of a figure that its artists show: what grey print, a frame or another text hides."""

import itertools
import re

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.container import BarContainer
from matplotlib.lines import Line2D
from matplotlib.patches import StepPatch
from matplotlib.text import Text

LEAST_LIGHTNESS = 10.0
"""Difference of L* that tells thin lines apart: two patches of a printer's grey scale of 20."""


def lightness(rgb):
    """CIE L* of sRGB colours (n, 3)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    y = linear @ [0.2126, 0.7152, 0.0722]
    return np.where(y > 216 / 24389, 116 * np.cbrt(y) - 16, y * 24389 / 27)


def stroke(artist):
    """Return dashes, marker and hatch, and the lightness, of a curve or bars; None of others."""
    if isinstance(artist, BarContainer) and len(artist):
        color, form = artist[0].get_facecolor(), (artist[0].get_hatch() or "",)
    elif isinstance(artist, Line2D):
        filled = to_rgb(artist.get_markerfacecolor()) != (1.0, 1.0, 1.0)
        dashes = artist._dash_pattern  # the pattern itself has no public name
        wide = artist.get_linewidth() > 3.0
        form = artist.get_linestyle(), str(dashes), artist.get_marker(), filled, wide
        color = artist.get_color()
    elif isinstance(artist, StepPatch) and not artist.get_fill():
        color, form = artist.get_edgecolor(), (str(artist.get_linestyle()),)
    else:
        return None
    return form, float(lightness(np.array([to_rgb(color)]))[0])


def alike_in_grey(ax):
    """Return pairs of names of a legend whose curves differ in hue alone."""
    handles, names = ax.get_legend_handles_labels()
    drawn = [(name, s) for name, s in zip(names, map(stroke, handles), strict=True) if s]
    return [
        (one, other)
        for (one, (form, grey)), (other, (form_2, grey_2)) in itertools.combinations(drawn, 2)
        if form == form_2 and abs(grey - grey_2) < LEAST_LIGHTNESS
    ]


def _beyond(axis):
    """Yield the labels of ticks beyond the ends of an axis, which are not drawn."""
    low, high = sorted(axis.get_view_interval())
    room = 1e-9 * (high - low)
    for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
        if not low - room <= tick.get_loc() <= high + room:
            yield tick.label1
            yield tick.label2


def faults(figure):
    """Draw a figure; return what lies over what: texts, legends, curves and the frame."""
    figure.canvas.draw()
    found = []
    hidden = {
        label for ax in figure.axes for axis in (ax.xaxis, ax.yaxis) for label in _beyond(axis)
    }
    texts = [
        t for t in figure.findobj(Text) if t.get_visible() and t.get_text() and t not in hidden
    ]
    frame = figure.bbox.padded(1.0)  # [pixel] rounding of the layout
    boxes = {text: text.get_window_extent() for text in texts}
    for text, box in boxes.items():
        if box.width and not (frame.contains(box.x0, box.y0) and frame.contains(box.x1, box.y1)):
            found.append(f"beyond the figure: {text.get_text()!r}")
    shown = [
        (text, box.padded(-1.0)) for text, box in boxes.items() if min(box.width, box.height) > 2.0
    ]
    found += [
        f"overlap: {one.get_text()!r} and {other.get_text()!r}"
        for (one, box), (other, other_box) in itertools.combinations(shown, 2)
        if box.overlaps(other_box) and not one.get_rotation() % 90 and not other.get_rotation() % 90
    ]
    found += [
        f"hyphen for a minus: {text.get_text()!r}"
        for text in texts
        if re.search(r"(^|[ (:])-\.?\d", text.get_text())
    ]
    for ax in figure.axes:
        found += [f"alike in grey: {pair}" for pair in alike_in_grey(ax)]
        legend = ax.get_legend()
        found += [
            f"legend over {line.get_label()!r}"
            for line in ax.get_lines()
            if legend
            if _passes(line, legend.get_window_extent(), ax)
        ]
    return found


def _passes(line, box, ax):
    """Return whether a curve or a marker of it, within the axes, lies in a box."""
    x, y = (np.asarray(ax.convert_xunits(v), float) for v in line.get_data())
    with np.errstate(all="ignore"):
        points = line.get_transform().transform(np.column_stack([x, y]))
    if len(points) > 1 and line.get_linestyle() != "None":  # between its points as well
        at = np.arange(len(points))
        finer = np.linspace(0.0, len(points) - 1.0, 20 * len(points))
        points = np.column_stack([np.interp(finer, at, column) for column in points.T])
    return any(box.contains(*point) and ax.bbox.contains(*point) for point in points)
