"""Colours are even and distinct, axes carry units, a missing extra is refused in one line."""

import sys

import matplotlib as mpl
import numpy as np
import pytest
from looks import faults, lightness

from meshtrace import viz
from meshtrace.viz import style
from meshtrace.viz.style import PALETTE

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


@pytest.mark.parametrize(
    ("draw", "fault"),
    [
        (lambda ax: ax.set_title("a title of many words " * 8), "beyond the figure"),
        (lambda ax: [ax.text(0.5, y, "a label") for y in (0.5, 0.51)], "overlap"),
        (lambda ax: [ax.plot([0, 1], [y, 1], label=str(y)) for y in range(3)], "alike in grey"),
        (lambda ax: ax.set_xticks([0, 0.01], ["left", "right"]), "overlap"),
        (lambda ax: ax.plot([0, 0.1, 1], [0, 0.05, 1], "o", label="a long name"), "legend over"),
        (lambda ax: ax.bar(*np.eye(2), label="-3 dB"), "hyphen for a minus"),
    ],
)
def test_faults_that_an_art_editor_would_see_are_found(draw, fault):
    ax = viz.marks.axes(None)
    draw(ax)
    if ax.get_legend_handles_labels()[1]:
        ax.legend(loc="lower left")
    assert any(text.startswith(fault) for text in faults(ax.figure))
    mpl.pyplot.close("all")


def test_curves_and_bars_of_every_color_are_told_apart_in_grey():
    """Two to thirteen curves with and without markers, and groups of bars."""
    import xarray as xr

    for n, look in ((7, "-"), (7, "o-"), (7, "o"), (12, "-")):
        names = [f"name {i}" for i in range(n)]
        data = xr.Dataset(
            {"gain": (("case", "depth"), 1.0 + np.arange(2.0 * n).reshape(n, 2))},
            {"case": names, "depth": [1.0, 2.0]},
        )
        viz.plot_curves(data, "gain", style=look)
    viz.marks.bars(None, data.isel(case=slice(7)), "gain")
