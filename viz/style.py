"""Style of the pictures: colours, fonts, sizes, and the labels of axes."""

from __future__ import annotations

import re
from typing import Any

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.colors import ListedColormap
from matplotlib.font_manager import findfont

from meshtrace.errors import one_line, require_word
from meshtrace.fields import FIELDS

PALETTE = {
    "blue": "#0072B2",
    "vermilion": "#D55E00",
    "green": "#009E73",
    "purple": "#CC79A7",
    "orange": "#E69F00",
    "sky": "#56B4E9",
    "black": "#000000",
}
"""Okabe and Ito's colours, distinguishable with every kind of colour vision."""

STROKES: Any = dict(
    zip(
        PALETTE.values(),
        [
            ("-", "o", ""),
            ("--", "s", "///"),
            ("-.", "^", "..."),
            (":", "D", "xxx"),
            ((0, (6, 1.5, 1, 1.5, 1, 1.5)), "v", "+++"),
            ((0, (10, 3)), "P", "---"),
            ("-", "o", ""),
        ],
        strict=True,
    )
)
"""Dashes, marker and hatch of a curve or bars of each colour, for print in grey.

Vermilion and green have a lightness L* of 54 and 58, sky and orange of 69 and 70. Black is solid as
blue is, from which it is 46 apart.
"""

FATE_COLORS = {
    "received": "#FFB02E",
    "landed elsewhere": "#8FDCFF",
    "ended in the water": "#3D86D1",
}
"""Colours of photon paths by fate, bright in dark water and in the night."""

INK = "#1F2933"
BODY_COLORS = {"lambert": "#B7AA96", "mirror": "#DDE5EC", "black": "#30343A"}
"""Colours of the bodies of a link, by the way they reflect."""

LED_COLOR = "#F0C419"
RECEIVER_COLOR = PALETTE["vermilion"]
NIGHT, DUSK = "#070D16", "#20384F"
"""Background of a scene, below and above."""

SHALLOW, DEEP = "#2F7F9E", "#061726"
"""Colours of the block of water in a scene, at the surface and in the dark below."""

CHALK = "#E4EBF2"
"""Texts of a scene."""

SEQUENTIAL: Any = "viridis"
"""Colour map of quantities without a centre."""

FONT_FILE = findfont("DejaVu Sans")
"""Font of scenes, which comes with matplotlib and has degrees and Greek letters."""

SLIDE = (1600, 1000)
"""Pixels of a scene."""

RC: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": INK,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 11,
    "axes.prop_cycle": cycler(color=list(PALETTE.values())),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 11,
    "figure.constrained_layout.use": True,
    "figure.figsize": (6.4, 4.2),
    "font.size": 10,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "image.cmap": SEQUENTIAL,
    "legend.fontsize": 9.5,
    "legend.frameon": False,
    "lines.linewidth": 1.7,
    "savefig.dpi": 150,
}


def use_style() -> None:
    """Set the defaults of matplotlib to the style of the gallery."""
    mpl.rcParams.update(RC)


def axis_label(name: str) -> str:
    r"""Return the label of an axis: long name, symbol and units of a registered variable.

    Parameters
    ----------
    name : str
        Name in `meshtrace.fields`.

    Returns
    -------
    str
        Text with TeX.

    Examples
    --------
    >>> axis_label("spectrum")
    'wave frequency spectrum $S(\\omega)$ [m$^{2}$ s rad$^{-1}$]'
    """
    require_word(name, FIELDS, "name")
    field = FIELDS[name]
    label = f"{field.long_name} ${field.symbol}$"
    return label if field.units == "1" else f"{label} [{printed_units(field.units)}]"


def printed_units(units: str) -> str:
    """Format units for print: exponents in TeX, and ° for degrees."""
    raised = re.sub(r"(?<=[A-Za-z])(-?\d+)", r"$^{\1}$", units)
    return "°" if units in ("degree", "deg") else raised


def label_of(name: str) -> str:
    """Return the label of a registered variable or of a dotted key of a link file.

    Keys whose last part is not registered keep their name, with the unit of its suffix.
    """
    last = name.rpartition(".")[2]
    if last in FIELDS:
        return axis_label(last)
    unit = next((unit for end, unit in (("_deg", "°"), ("_nm", "nm")) if last.endswith(end)), "")
    return f"{verbatim(name)} [{unit}]" if unit else verbatim(name)


def number(value: float, form: str = "g") -> str:
    r"""Format a number for print: with a minus sign, and powers of ten in TeX.

    Examples
    --------
    >>> number(-3.0), number(2.7e-6, ".2g"), number(1e-9)
    ('−3', '2.7×10$^{-6}$', '10$^{-9}$')
    """
    digits, _, power = f"{value:{form}}".partition("e")
    digits = digits.replace("-", "\N{MINUS SIGN}")
    if not power:
        return digits
    return (f"{digits}×" if digits != "1" else "") + f"10$^{{{int(power)}}}$"


def verbatim(text: object) -> str:
    r"""Return the text of a user as one line that matplotlib draws without TeX.

    Examples
    --------
    >>> verbatim("$x^{2$")
    '\\$x^{2\\$'
    """
    return one_line(text).replace("$", r"\$")


def plain_label(name: str) -> str:
    """Return the long name and units of a registered variable without TeX.

    Examples
    --------
    >>> plain_label("elevation")
    'sea surface elevation [m]'
    """
    field = FIELDS[name]
    return field.long_name if field.units == "1" else f"{field.long_name} [{field.units}]"


def water_map() -> ListedColormap:
    """Return a colour map from deep blue to pale green with uniform lightness steps.

    Notes
    -----
    Piecewise linear in OKLab with linearly increasing lightness: equal steps look equal, in grey as
    well.

    References
    ----------
    B. Ottosson, "A perceptual color space for image processing" (2020).
    """
    # lightness, chroma and hue [deg] of the ends and the middle
    lightness, chroma, hue = np.array(
        [(0.25, 0.075, 262.0), (0.44, 0.085, 248.0), (0.63, 0.085, 225.0), (0.82, 0.06, 195.0)]
    ).T
    at = np.linspace(0.0, len(hue) - 1.0, 256)
    lightness_at, c, h = (
        np.interp(at, np.arange(len(hue)), row) for row in (lightness, chroma, hue)
    )
    lab = np.stack([lightness_at, c * np.cos(np.radians(h)), c * np.sin(np.radians(h))], axis=1)
    # OKLab has the cube roots of the responses of the cones (Ottosson 2020)
    linear = np.clip((lab @ _TO_LMS.T) ** 3 @ _TO_RGB.T, 0.0, 1.0)
    return ListedColormap(to_srgb(linear), name="water")


_TO_LMS = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def to_srgb(linear: Any) -> Any:
    """Convert linear intensity, 0 to 1, to sRGB."""
    # linear near black, where a power would have no finite slope
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
