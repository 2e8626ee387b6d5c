"""Wander of a tracked beam, by the width of its spot on the sea and the latency."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from meshtrace.fading.pointing import SAMPLE, Wander, outside
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map
from meshtrace.tables import text_table

_RADII = 0.001, 0.005, 0.02, 0.1  # [m]
_LATENCIES = 0.005, 0.01, 0.03, 0.1  # [s]: mirrors and quadrant diodes, cameras, slow cameras
_CAMERA = 0.03


class TrackedSpot(NamedTuple):
    """Wander that tracking leaves of a beam, by its radius on the sea and by latency.

    Attributes
    ----------
    radius, latency : float
        1/e^2 radius of the beam on the sea [m], and latency of the tracker [s].
    held, predicted : float
        Shares of the variance that are left (`fading.pointing_residual`).
    outage_held, outage_predicted, outage_fixed : float
        Shares of the time that the spot is off the lens (`fading.pointing_outage`), with a tracker
        and without.
    loop_gain : float
        Lever (n - 1) h d / (d + n h) times the rms curvature of the sea over the footprint [1]; a
        beam is followed by its spot where it is well below 1, see `studies.steer`.
    """

    radius: float
    latency: float
    held: float
    predicted: float
    outage_held: float
    outage_predicted: float
    outage_fixed: float
    loop_gain: float


def tracked_spots(link: Link, surface: Any, threads: int = 1) -> tuple[TrackedSpot, ...]:
    """Return the wander left of a beam by radius and latency; none for a link without a beam.

    Those of the link's beam and of its tracker are among them. Over a spectrum whose tail is no
    model of short waves these are Elfouhaily's.
    """
    beam: Any = link.transmitters[0]
    sea = getattr(surface, "short_waves", surface)
    single = len(link.transmitters) == len(link.receivers) == 1
    aimed = single and link.direction == "up" and hasattr(beam, "tracker")
    if not (aimed and hasattr(sea, "slope_spectrum")):
        return ()
    spread = math.tan(math.radians(min(beam.divergence_deg, 89.0)))
    beam_radius = math.hypot(beam.size, beam.depth * spread)
    radii = sorted({*_RADII, float(f"{beam_radius:.2g}")})
    latencies = sorted({*_LATENCIES, beam.tracker.latency if beam.tracker else _CAMERA})
    by_radius = ordered_map(partial(_spots_of, link, sea, latencies), radii, threads)
    return tuple(spot for spots in by_radius for spot in spots)


def _spots_of(link: Link, sea: Any, latencies: Sequence[float], radius: float) -> list[TrackedSpot]:
    """Return the wander of a beam of one radius, as `pointing_residual` and `pointing_outage`."""
    n, end, depth = link.water.n / link.n_air, link.only_receiver, link.depth
    spectrum = sea.slope_spectrum()
    # along the wind: k^2 s^2 cos^4 theta, cos^4 = 3/8 + cos(2 theta) / 2 + cos(4 theta) / 8
    share = 0.375 + 0.5 * spectrum.harmonics[2] + 0.125 * spectrum.harmonics[4]
    footprint = np.exp(-0.25 * (spectrum.k * radius) ** 2)
    curvature = math.sqrt(float(np.sum(spectrum.k**2 * spectrum.variance * share * footprint)))
    loop_gain = (n - 1.0) * end.height * depth / (depth + n * end.height) * curvature
    wander = Wander.from_sea(sea, radius)

    def outage(left: Floats) -> float:
        return outside((n - 1.0) ** 2 * end.height**2 * left, end.radius)

    whole, fixed, spots = wander.variance.sum(), outage(wander.variance.sum(axis=1)), []
    for latency in latencies:
        held, predicted = (
            wander.left(latency, predictor, SAMPLE, None) for predictor in ("hold", "linear")
        )
        shares = float(held.sum() / whole), float(predicted.sum() / whole)
        outages = outage(held), outage(predicted), fixed
        spots.append(TrackedSpot(radius, latency, *shares, *outages, loop_gain))
    return spots


def spot_lines(spots: Sequence[TrackedSpot], outage: float) -> list[str]:
    """Format wander and outage by spot and latency as tables, with a conclusion."""
    camera = {spot.radius: spot for spot in spots if spot.latency == _CAMERA}
    narrow, wide = camera[0.005], camera[0.02]
    texts = [
        f"At 30 ms (a camera) holding leaves {100.0 * narrow.held:.2g} % of the variance of a "
        f"spot of 5 mm; a spot of 2 cm with prediction {_share(100.0 * wide.predicted)} %."
    ]
    for word in ("held", "predicted"):
        least = {
            spot.latency: _radius(spot.radius)
            for spot in reversed(spots)  # the widest first: a narrower one replaces it
            if getattr(spot, f"outage_{word}") <= outage
        }
        latencies = sorted({spot.latency for spot in spots})
        parts = ", ".join(f"{1e3 * t:g} ms {least.get(t, 'none')}" for t in latencies)
        share = f"{100.0 * outage:g} % of the time"
        texts.append(f"Least spot that is off the lens at most {share}, {word}: {parts}.")
    texts.append(
        "Shares are of a beam that crosses the sea at one place: where the loop gain is not well "
        "below 1, a tracker has to see the slopes of the sea, not the spot alone."
    )
    return [
        "share of the variance of the wander that is left, held / predicted", "",
        _table(spots, "loop_gain", "held", "predicted"), "",
        "share of the time that the spot is off the lens, held / predicted", "",
        _table(spots, "outage_fixed", "outage_held", "outage_predicted"), "",
        *(textwrap.fill(text, width=100, subsequent_indent="    ") for text in texts),
    ]  # fmt: skip


def _table(spots: Sequence[TrackedSpot], first: str, held: str, predicted: str) -> str:
    """Return a table by radius and latency; the first column depends on the radius alone."""
    lines = []
    for radius in dict.fromkeys(spot.radius for spot in spots):
        row = [spot for spot in spots if spot.radius == radius]
        pairs = (f"{_share(getattr(s, held))} / {_share(getattr(s, predicted))}" for s in row)
        lines.append((_radius(radius), f"{getattr(row[0], first):.2g}", *pairs))
    heads = (f"{1e3 * latency:g} ms" for latency in dict.fromkeys(s.latency for s in spots))
    return text_table(lines, ("spot", first.replace("_", " "), *heads))


def _share(share: float) -> str:
    return "0" if share < 1e-6 else f"{share:.2g}"


def _radius(radius: float) -> str:
    return f"{1e3 * radius:g} mm" if radius < 0.01 else f"{1e2 * radius:g} cm"
