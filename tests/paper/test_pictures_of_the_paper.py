"""Figures of the paper show what their legends name, in one scale."""

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from looks import faults
from matplotlib.colors import to_rgb

import meshtrace as mt
from meshtrace import viz
from paper import Setting, gains, optics
from paper.links import WIND_COLORS, form_panels, wind_lines
from paper.registry import load


def test_maps_share_one_colour_bar_and_scale(monkeypatch):
    axis = np.linspace(-5.0, 5.0, 21)

    def coverage_map(link, surface, **options):
        gain = 1e-5 * np.exp(-(axis[:, None] ** 2 + axis**2) / link.transmitters[0].depth)
        return mt.CoverageMap(axis, axis, gain, 0.01 * gain)

    monkeypatch.setattr(mt, "coverage_map", coverage_map)
    made = gains.coverage_depth(Setting(), photons=1, times=1, step=0.5)
    maps = [ax for ax in made.picture.axes if "0 dB" in ax.get_title()]
    assert (len(maps), len(made.picture.axes)) == (12, 13)
    assert {ax.collections[0].get_clim() for ax in maps} == {(-gains.DEPTH, 0.0)}
    assert sum("depth 15 m" in ax.get_title() for ax in maps) == 1
    assert not faults(made.picture)


def test_light_lost_by_tilts_is_named_and_makes_no_spike():
    rng = np.random.default_rng(1)
    names = [f"gain_{form}_{wind:g}" for form in gains.FORMS for wind in gains.ROUGH]
    data = xr.Dataset({
        name: ("i", 1e-5 * (i + 1) * rng.normal(1.0, 0.02 / (4 - i), 1000))
        for i, name in enumerate(names)
    })  # fmt: skip
    data["gain_physical_13"][:20] = 0.0
    for ax in gains._densities(data).axes:
        bars = [patch.get_data() for patch in ax.patches]
        assert ax.get_ylim()[1] >= max(bar.values.max() for bar in bars)
        assert min(bar.edges.min() for bar in bars) > 0.0
        labels = [text.get_text() for text in ax.get_legend().get_texts()]
        if ax.get_title() == "default":
            assert labels == ["5 m/s", "13 m/s, 2 % dark"]
            share = np.sum(bars[1].values * np.diff(bars[1].edges))
            assert share == pytest.approx(0.98)


def test_a_flat_sea_is_dashed_above_the_curves_that_cover_it():
    data = xr.Dataset(
        {"gain": (("wind_speed", "depth"), np.ones((3, 2)))},
        {"wind_speed": [0.0, 5.0, 13.0], "depth": [5.0, 10.0]},
    )
    _, axes = form_panels()
    flat, *rough = wind_lines(axes["paper"], data, "gain", "o-").get_lines()
    assert (flat.get_linestyle(), flat.get_zorder() > rough[0].get_zorder()) == ("--", True)


def test_published_bubbles_are_seen_beside_ours():
    ours, published = np.array_split(
        optics.bubble_density(Setting()).picture.axes[0].get_lines(), 2
    )
    for line, wide, wind in zip(ours, published, gains.ROUGH, strict=True):
        assert wide.get_linewidth() > 3.0 * line.get_linewidth()
        assert to_rgb(wide.get_color()) == to_rgb(line.get_color()) == to_rgb(WIND_COLORS[wind])


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["bubble-scattering", "ff-cdf", "stations", "wind", "h-alpha"])
def test_a_figure_has_no_fault_that_its_artists_show(name):
    figure = load(name)
    with mpl.rc_context(viz.style.RC):
        assert not faults(figure.make(Setting(), **figure.effort(True)).picture)
