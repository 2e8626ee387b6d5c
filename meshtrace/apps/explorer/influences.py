"""Influences of the inputs on the margin, the answer of the explorer that compares links."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

from meshtrace import Analog, Background, compare
from meshtrace.apps.explorer.controls import BITS_ALONE, State, begun_at
from meshtrace.apps.explorer.stages import (
    LIMIT,
    Check,
    Signal,
    gains,
    light_above,
    unless_refused,
    with_warnings,
)
from meshtrace.comms import OokLink
from meshtrace.comms.background import with_background
from meshtrace.comms.budget import link_budget

INPUTS = (
    "power",
    "pde",
    "bit_rate",
    "filter",
    "depth",
    "a",
    "half_angle",
    "fov",
    "height",
    "wind",
    "wavelength",
    "b",
    "tilt",
    "offset_x",
    "chlorophyll",
    "aperture",
    "fetch",
)
"""Controls whose influence on the margin is computed; those that matter seldom come last."""

STEPS = {"wind": 1.0, "offset_x": 1.0, "tilt": 5.0, "wavelength": 10.0}
"""Steps of inputs whose value may be 0, in the units of the page; of others it is 10 %."""

_COMPARED = (1024, 50_000)  # chains and photons of a pair of gains, of a tenth of a second
_OF_SEA = ("wind", "fetch")  # inputs that change the waves themselves, and with them each crest
_SEAS = 8  # over which their influence is averaged: over one sea it would be that of its phases
_LONGEST = 20.0  # after which no further input is tried [s]


class Influence(NamedTuple):
    """Change of the margin with a step of one control.

    Attributes
    ----------
    name : str
        Name of the control.
    change, stderr : float
        Change of the optical margin and its standard error [dB].
    """

    name: str
    change: float
    stderr: float


def influences(state: State, check: Check) -> Iterator[tuple[Influence, ...]]:
    """Compute the change of the margin with a step of each input; yield the largest first.

    The change of the gain is that of `compare`, with common chains and seas. `sensitivities` has no
    derivative by the wind over a sea whose band follows it, nor of links without chains. Pulses
    spread as at the state itself.
    """
    *_, signal = gains(state, check)
    changes, end = [], time.monotonic() + _LONGEST
    if signal.detector is not None and signal.gain.gains[0] > 0.0:
        sky_light = with_warnings(partial(light_above, state))[0]
        for name in INPUTS:
            check()
            value = state.values[name]
            if value is None or time.monotonic() > end:
                continue
            wanted = {name: value + STEPS.get(name, 0.1 * value)}
            moved = unless_refused(partial(state.moved, wanted))
            if moved is None or moved.moves == state.moves:
                continue
            pair = partial(_influence, name, state, moved, signal, sky_light, check)
            influence = with_warnings(partial(unless_refused, pair))[0]
            if influence is not None and math.isfinite(influence.change + influence.stderr):
                changes.append(influence)
    yield tuple(sorted(changes, key=lambda influence: -abs(influence.change)))


def _influence(
    name: str,
    state: State,
    moved: State,
    signal: Signal,
    sky_light: Background | None,
    check: Check,
) -> Influence:
    """Return the change of the margin from one state to another, which differ in one control."""
    change = error = 0.0
    if name not in BITS_ALONE:
        channels = {"now": state.channel, "moved": moved.channel}
        pair = compare(
            {key: begun_at(channel, state.time) for key, channel in channels.items()},
            photons=_COMPARED[isinstance(state.channel.run.estimator, Analog)],
            realizations=_SEAS if name in _OF_SEA else 1, progress=check,
        )  # fmt: skip
        change, error = float(pair.ratio_db[1]), float(pair.ratio_db_stderr[1])
        sky_light = light_above(moved)

    def margin(detector: OokLink, more: float = 0.0) -> float:
        """Return the margin at the gain of the present state, under a share more of light."""
        detector = detector.replace(background_rate=(1.0 + more) * detector.background_rate)
        return float(link_budget(detector, signal.gain.gain, LIMIT).margin_optical_db)

    assert signal.detector is not None
    detector = moved.detector
    if detector.response is None:
        detector = detector.replace(response=signal.detector.response)
    if sky_light is not None:
        detector = with_background(detector, sky_light)
        if name not in BITS_ALONE:  # two backgrounds, taken for independent
            share = math.sqrt(2.0) * float(
                sky_light.radiance_stderr / max(sky_light.radiance, 1e-300)
            )
            error = math.hypot(error, margin(detector, share) - margin(detector))
    return Influence(name, change + margin(detector) - margin(signal.detector), error)
