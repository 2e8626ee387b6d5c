"""Figures of the mean gain over a parameter of the link."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from meshtrace.fields import attrs
from meshtrace.paper.canvas import WIND_COLORS, mark_printed, panels, wind_name
from meshtrace.paper.links import (
    FORM_NAMES,
    FORMS,
    PAPER_NOTE,
    WINDS,
    Form,
    Mean,
    decibel,
    mean_gain,
    ratio,
)
from meshtrace.paper.printed import PRINTED
from meshtrace.paper.registry import Drawing, Number, Row, Setting, compared, figure
from meshtrace.viz import plot_sweep

QUICK = {"realizations": 10, "photons": 512}
FULL = {"realizations": 100, "photons": 2048}

Gains = dict[tuple[Form, float], list[Mean]]
_NARROW = (
    "The narrow beams of the paper are far dimmer than its parameters give, the wide one is not; "
    "no single change explains both."
)


def _one_by_one(key: str, table: str, values: Sequence[float], **options: Any) -> Gains:
    """Return gains with one value at a time in a table of the link."""
    setting = options.pop("setting")
    return {
        (form, wind): [
            mean_gain(wind, form, setting, **options, **_table(table, key, value))[0]
            for value in values
        ]
        for form in FORMS
        for wind in WINDS
    }


def _table(table: str, key: str, value: float) -> dict[str, Any]:
    return {table: {key: value}}


def _receivers(
    make: Callable[[float], dict[str, Any]], values: Sequence[float], **options: Any
) -> Gains:
    """Return gains of one receiver for each value, all over the same seas."""
    setting = options.pop("setting")
    receivers = [make(value) for value in values]
    return {
        (form, wind): mean_gain(wind, form, setting, **options, receiver=receivers)
        for form in FORMS
        for wind in WINDS
    }


def _drawing(
    name: str,
    values: Sequence[float],
    gains: Gains,
    rows: list[Row],
    caption: str,
    printed: Sequence[tuple[float, str]] = (),
) -> Drawing:
    """Return the picture of a sweep: right physics beside the printed forms."""
    x = np.asarray(values, dtype=float)
    picture, axes = panels(1, 2, sharey=True)
    for ax, form in zip(axes[0], FORMS, strict=True):
        means = {wind_name(u): _column(gains[form, u], 0) for u in WINDS}
        errors = {wind_name(u): _column(gains[form, u], 1) for u in WINDS}
        ax.set_prop_cycle(color=[WIND_COLORS[u] for u in WINDS])
        plot_sweep(x, means, errors, along=name, ax=ax)
        if printed:
            mark_printed(ax, [p[0] for p in printed], [PRINTED[p[1]].value for p in printed])
        ax.set_title(FORM_NAMES[form])
        ax.legend()
    axes[0, 1].set_ylabel("")
    dims = ("form", "wind_speed", name)
    data = xr.Dataset(
        {
            key: (dims, [[_column(gains[f, u], i) for u in WINDS] for f in FORMS], attrs(key))
            for i, key in enumerate(("gain", "gain_stderr"))
        },
        {
            "form": list(FORMS),
            "wind_speed": ("wind_speed", list(WINDS), attrs("wind_speed")),
            name: (name, x, attrs(name)),
        },
    )
    seas = "Mean over independent seas, times the mean factor of the tilt; bands are two standard "
    return Drawing(picture, data, rows, f"{caption} {seas}errors. {PAPER_NOTE}")


def _column(means: list[Mean], i: int) -> NDArray[np.float64]:
    """Return the values (0) or their standard errors (1)."""
    return np.array([mean.number[i] for mean in means])


def _means(gains: Gains, values: Sequence[float], wind: float, value: float) -> list[Mean]:
    """Return the means of both forms at one value."""
    i = int(np.argmin(np.abs(np.asarray(values) - value)))
    return [gains[form, wind][i] for form in FORMS]


def _at(gains: Gains, values: Sequence[float], wind: float, value: float) -> list[Number]:
    """Return the gains of both forms at one value."""
    return [mean.number for mean in _means(gains, values, wind, value)]


def _loss(reference: list[Mean], other: list[Mean]) -> list[Number]:
    """Return the losses [dB] from a reference, of both forms."""
    return [decibel(a.over(b)) for a, b in zip(reference, other, strict=True)]


@figure("gain-half-angle", "12", "gain over the half angle", quick=QUICK, full=FULL)
def gain_half_angle(setting: Setting, **effort: int) -> Drawing:
    """Draw the mean gain over the lamp's half angle."""
    values = (5.0, 10.0, 20.0, 30.0, 45.0, 60.0)
    gains = _one_by_one("half_angle_deg", "transmitter", values, setting=setting, **effort)
    narrow, wide = (_means(gains, values, 5.0, angle) for angle in (5.0, 60.0))
    rows = [
        compared(
            "mean gain at 5 degrees, 5 m/s",
            [m.number for m in narrow],
            _NARROW,
            printed="gain-half-angle-5",
        ),
        compared(
            "mean gain at 10 degrees, 5 m/s",
            _at(gains, values, 5.0, 10.0),
            _NARROW,
            printed="gain-5",
        ),
        compared(
            "mean gain at 60 degrees, 5 m/s",
            [m.number for m in wide],
            _NARROW,
            printed="gain-half-angle-60",
        ),
        compared(
            "loss from 5 to 60 degrees, 5 m/s",
            _loss(narrow, wide),
            "More than printed, since our narrow beam is brighter.",
            printed="loss-half-angle",
        ),
    ]
    printed = [(5.0, "gain-half-angle-5"), (10.0, "gain-5"), (60.0, "gain-half-angle-60")]
    caption = "Mean gain over the half angle of the lamp; stars: printed for 5 m/s."
    return _drawing("half_angle_deg", values, gains, rows, caption, printed)


@figure("gain-depth", "14", "gain over the depth", quick=QUICK, full=FULL)
def gain_depth(setting: Setting, **effort: int) -> Drawing:
    """Draw the mean gain over the lamp's depth."""
    values = (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)
    gains = _one_by_one("depth", "transmitter", values, setting=setting, **effort)
    rows = [
        compared(
            f"mean gain at {depth:g} m, {wind_name(u)}",
            _at(gains, values, u, depth),
            "The paper draws the curve and prints no number; printed forms that gain light and "
            "forms that lose it partly cancel.",
        )
        for depth in (20.0, 40.0)
        for u in (5.0, 13.0)
    ]
    first = [
        compared(
            f"mean gain at 10 m, {wind_name(u)}",
            _at(gains, values, u, 10.0),
            _NARROW,
            printed=f"gain-{u:g}",
        )
        for u in (5.0, 13.0)
    ]
    caption = "Mean gain over the depth of the lamp; stars: printed for 5 and 13 m/s."
    return _drawing(
        "depth", values, gains, first + rows, caption, [(10.0, "gain-5"), (10.0, "gain-13")]
    )


@figure("gain-height", "16", "gain over the height", quick=QUICK, full=FULL)
def gain_height(setting: Setting, **effort: int) -> Drawing:
    """Draw the mean gain over the height of the receiver."""
    values = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    gains = _receivers(lambda height: {"height": height}, values, setting=setting, **effort)
    rows = [
        compared(
            f"gain of a flat sea over that at {u:g} m/s, {height:g} m high",
            (
                ratio(a, b)
                for a, b in zip(
                    _at(gains, values, 0.0, height), _at(gains, values, u, height), strict=True
                )
            ),
            "The paper says that a flat sea gives significantly more and prints no number; waves "
            "alone spread a beam of 10 degrees little.",
        )
        for height in (5.0, 10.0)
        for u in (5.0, 13.0)
    ]
    caption = "Mean gain over the height of the receiver; stars: printed for 5 and 13 m/s."
    return _drawing("height", values, gains, rows, caption, [(5.0, "gain-5"), (5.0, "gain-13")])


@figure("gain-radius", "17", "gain over the radius of the aperture", quick=QUICK, full=FULL)
def gain_radius(setting: Setting, **effort: int) -> Drawing:
    """Draw the mean gain over the radius of the aperture."""
    values = (0.01, 0.02, 0.03, 0.05, 0.07, 0.1)
    gains = _receivers(lambda radius: {"radius": radius}, values, setting=setting, **effort)
    rows = []
    for u in WINDS:
        slopes = []
        for form in FORMS:
            g = _column(gains[form, u], 0)
            slopes.append(Number(float(np.polyfit(np.log(values), np.log(g), 1)[0])))
        rows.append(
            compared(
                f"power of the radius that the gain follows, {wind_name(u)}",
                slopes,
                "The gain follows the area: the spot is far wider than the aperture. The paper "
                "prints no number.",
            )
        )
    caption = "Mean gain over the radius of the aperture; stars: printed for 5 and 13 m/s."
    return _drawing("radius", values, gains, rows, caption, [(0.05, "gain-5"), (0.05, "gain-13")])


@figure("gain-offset", "19", "gain over the offset", quick=QUICK, full=FULL)
def gain_offset(setting: Setting, **effort: int) -> Drawing:
    """Draw the mean gain over the horizontal offset of the receiver, down-wind."""
    values = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)
    gains = _receivers(lambda x: {"position": [x, 0.0]}, values, setting=setting, **effort)
    rows = [
        compared(
            f"loss at an offset of 0.5 m, {wind_name(u)}",
            _loss(_means(gains, values, u, 0.0), _means(gains, values, u, 0.5)),
            "The spot of a beam of 10 degrees is metres wide: it cannot fall by that much within "
            "half a metre.",
            printed=f"loss-offset-{u:g}",
        )
        for u in (5.0, 13.0)
    ]
    caption = "Mean gain over the offset of the receiver down-wind of the lamp."
    return _drawing("offset", values, gains, rows, caption)
