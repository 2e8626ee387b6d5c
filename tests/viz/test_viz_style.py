"""Colours are even and distinct, axes carry units, a missing extra is refused in one line."""

import sys

import matplotlib as mpl
import numpy as np
import pytest

from meshtrace import viz
from meshtrace.viz import style
from meshtrace.viz.style import PALETTE


def lightness(rgb):
    """CIE L* of sRGB colours (n, 3)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    y = linear @ [0.2126, 0.7152, 0.0722]
    return np.where(y > 216 / 24389, 116 * np.cbrt(y) - 16, y * 24389 / 27)


# Machado, Oliveira and Fernandes (2009), doi:10.1109/TVCG.2009.113, severity 1, linear RGB
DEUTERANOPIA = np.array(
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
)
PROTANOPIA = np.array(
    [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ]
)


def test_water_map_rises_evenly_in_lightness():
    colors = viz.water_map()(np.linspace(0, 1, 64))[:, :3]
    steps = np.diff(lightness(colors))
    assert steps.min() > 0.0
    assert steps.max() < 1.6 * steps.mean()
    assert lightness(colors)[-1] - lightness(colors)[0] > 50.0


@pytest.mark.parametrize("vision", [np.eye(3), DEUTERANOPIA, PROTANOPIA])
def test_fates_are_distinct_in_every_vision(vision):
    rgb = np.array([mpl.colors.to_rgb(c) for c in style.FATE_COLORS.values()])
    seen = np.clip(rgb**2.2 @ vision.T, 0, 1) ** (1 / 2.2)
    distances = [np.linalg.norm(seen[i] - seen[j]) for i in range(3) for j in range(i)]
    assert min(distances) > 0.2


def test_palette_is_that_of_okabe_and_ito():
    assert PALETTE["vermilion"] == "#D55E00"
    assert len(set(PALETTE.values())) == 7


def test_labels_carry_units():
    assert viz.axis_label("depth") == "depth below still water $d$ [m]"
    assert viz.axis_label("phase_function").endswith("[sr$^{-1}$]")
    assert viz.axis_label("half_angle_deg").endswith("[°]")
    assert "[" not in viz.axis_label("gain")


def test_use_style_can_be_undone():
    with mpl.rc_context():
        viz.use_style()
        assert mpl.rcParams["legend.frameon"] is False


@pytest.mark.parametrize("missing", ["pyvista", "matplotlib", "imageio", "trame_client"])
def test_missing_extra_is_reported_in_one_line(monkeypatch, missing):
    monkeypatch.delitem(sys.modules, "meshtrace.viz")
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ImportError) as caught:
        __import__("meshtrace.viz")
    text = f'viz: {missing} is not installed: pip install "meshtrace[viz]"'
    assert (str(caught.value), caught.value.name) == (text, missing)


def test_every_public_name_resolves():
    for name in viz.__all__:
        assert callable(getattr(viz, name)) or name in ("marks", "style"), name


def test_names_of_a_user_are_drawn_without_tex():
    import xarray as xr

    names = ["$x^{2$", "$a$", r"\alpha$", "two\nlines"]
    data = xr.Dataset(
        {"gain": (("case", "depth"), np.ones((4, 2)))}, {"case": names, "depth": [1, 2]}
    )
    ax = viz.plot_curves(data, "gain")
    ax.figure.canvas.draw()
    shown = [text.get_text() for text in ax.get_legend().get_texts()]
    assert shown == [r"\$x^{2\$", r"\$a\$", r"\alpha\$", "two lines"]
