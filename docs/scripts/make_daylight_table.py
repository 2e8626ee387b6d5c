"""Write the table and the figure of daylight.md: range against filter, field of view and light.

python docs/scripts/make_daylight_table.py [SEAS]

Gains are those of an ensemble of seas at each depth and field of view; the background is that of
the same seas. Ranges are those at which the mean bit error rate reaches 1e-3; their intervals are
two standard errors of the background over the seas.
"""

from __future__ import annotations

import math
import sys

import numpy as np
from places import GENERATED, STATIC

import meshtrace as mt
from meshtrace.comms.background import with_background
from meshtrace.comms.budget import depth_at
from meshtrace.surfaces import JonswapSea

DEPTHS = tuple(float(d) for d in (5, 8, 12, 17, 22, 27, 32, 37, 42, 47, 52, 58))
FIELDS = (60.0, 20.0, 6.0)
RATES = (1e6, 5e6, 1e7)
FILTERS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
SEA = JonswapSea(wind_speed=5.0)
LIGHTS = {
    "night": mt.Daylight.night(),
    "full moon": mt.Daylight.moon(),
    "overcast": mt.Daylight.overcast(30.0),
    "sun at zenith angle 60°": mt.Daylight.clear_sky(60.0),
    "sun at zenith angle 30°": mt.Daylight.clear_sky(30.0),
    "sun at zenith angle 10°": mt.Daylight.clear_sky(10.0),
}
TABLE_ROWS = ((10.0, 60.0), (2.0, 20.0), (2.0, 6.0), (0.5, 6.0))  # filter [nm], field of view [deg]


def link(fov):
    return mt.Link(receiver=mt.Receiver(fov_deg=fov)).in_wind(5.0)


def mean_range(ook, fades):
    """Return the depth at which the mean bit error rate reaches 1e-3; 0 for none."""
    from scipy.special import ndtri

    ber = [float(ook.ber(ook.received_power(f.samples.ravel())).mean()) for f in fades]
    if max(ber) < 1e-3:
        return math.inf
    quality = -ndtri(np.clip(ber, 1e-300, 0.5 - 1e-12))
    try:
        return depth_at(DEPTHS, quality, -float(ndtri(1e-3)))
    except ValueError:
        return 0.0


def light_of(day, fov, seas):
    """Return the background, the mean over the seas, with its standard error over them."""
    from dataclasses import replace

    found = [mt.background(link(fov), SEA.with_seed(i), day, photons=1024) for i in range(seas)]
    total = np.array([f.radiance for f in found])
    stderr = float(total.std(ddof=1)) / math.sqrt(seas)
    parts = np.mean([f.part_radiance for f in found], axis=0)
    mean = float(total.mean())
    return replace(found[0], radiance=mean, radiance_stderr=stderr, part_radiance=parts)


def ranges(fades, background, fov, rate, width):
    """Return the range with its lower and upper limit [m]."""
    base = mt.OokLink.of_link(link(fov), bit_rate=rate).replace("optics.filter_width_nm", width)
    base = base.replace(window=base.averaging_window)  # that of the dark, for all backgrounds
    step = 2.0 * background.radiance_stderr / background.radiance
    scales = (1.0, 1.0 + step, max(1.0 - step, 0.0))
    return [mean_range(with_background(base, background, s), fades) for s in scales]


def as_text(found):
    value, low, high = found
    if value == 0.0:
        return "none"
    if math.isinf(value):
        return f"> {DEPTHS[-1]:g}"
    return f"{value:.1f} ({low:.1f}–{high:.1f})" if high - low >= 0.05 else f"{value:.1f}"


def main(seas=16):
    fades, lights = {}, {}
    for fov in FIELDS:
        done = mt.link_performance(
            link(fov), SEA, depths=DEPTHS, realizations=seas, photons=512, bit_rate=1e6
        )
        fades[fov] = done.fades
        lights[fov] = {name: light_of(day, fov, seas) for name, day in LIGHTS.items()}
        print(fov, [f"{b.radiance:.3e}" for b in lights[fov].values()], flush=True)
    write_table(fades, lights)
    draw(fades, lights)


def write_table(fades, lights):
    rows = ["| filter, field of view | light | radiance | 1 Mbit/s | 5 Mbit/s |"
            " 10 Mbit/s |", "|---|---|---|---|---|---|"]  # fmt: skip
    for width, fov in TABLE_ROWS:
        for name, background in lights[fov].items():
            cells = [as_text(ranges(fades[fov], background, fov, r, width)) for r in RATES]
            about = f"{width:g} nm, {fov:g}° | {name.replace(' at zenith angle', '')}"
            rows.append(f"| {about} | {background.radiance:.2e} | {' | '.join(cells)} |")
    (GENERATED / "daylight_table.md").write_text("\n".join(rows) + "\n", encoding="utf-8")


def draw(fades, lights):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    from meshtrace import viz

    viz.use_style()
    figure, axes = plt.subplots(1, len(FIELDS), figsize=(10.0, 4.0), sharey=True)
    for axis, fov in zip(axes, FIELDS, strict=True):
        for i, (name, background) in enumerate(lights[fov].items()):
            found = np.array([ranges(fades[fov], background, fov, 1e6, w) for w in FILTERS])
            found[~np.isfinite(found)] = np.nan  # beyond the depths that were computed
            look = {"color": f"C{i}", "zorder": 3 - 0.1 * i}
            axis.semilogx(FILTERS, found[:, 0], "o-", ms=4, label=name, **look)
            axis.fill_between(FILTERS, found[:, 1], found[:, 2], alpha=0.2, lw=0, **look)
        beyond = {"color": "0.5", "alpha": 0.15, "lw": 0, "label": "not computed"}
        axis.axhspan(DEPTHS[-1], 1.1 * DEPTHS[-1], **beyond)
        axis.set(title=f"field of view {fov:g}°", xlabel="filter width [nm]")
        axis.xaxis.set_major_formatter("{x:g}")
        viz.marks.finished(axis, legend=False)
    axes[0].set(ylabel="range at 1 Mbit/s and a BER of 10$^{-3}$ [m]", ylim=(0.0, 1.1 * DEPTHS[-1]))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    viz.save_picture(figure, STATIC / "daylight_ranges.png")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
