"""Links of the paper by wind, correct or as published, their means, and panels to draw them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import meshtrace as mt
from meshtrace import viz
from meshtrace.errors import Refused
from meshtrace.uav import UAVS
from paper.registry import Entry, Floats, Number, Setting, row

WIND_COLORS = {
    0.0: viz.style.PALETTE["black"],
    5.0: viz.style.PALETTE["blue"],
    13.0: viz.style.PALETTE["vermilion"],
}


def panels(
    rows: int = 1, columns: int = 1, *, width: float = 5.2, height: float = 3.9, **options: Any
) -> tuple[Figure, Any]:
    """Return a figure off screen and its axes (rows, columns); sizes of a panel in inches."""
    picture = Figure(figsize=(columns * width, rows * height), layout="constrained")
    FigureCanvasAgg(picture)
    return picture, picture.subplots(rows, columns, squeeze=False, **options)


def form_panels(**options: Any) -> tuple[Figure, dict[Form, Any]]:
    """Return a figure and its axes by form: correct physics beside the forms as published."""
    picture, axes = panels(1, len(FORMS), **options)
    for ax, form in zip(axes[0], FORMS, strict=True):
        ax.set_title(FORM_NAMES[form])
    return picture, dict(zip(FORMS, axes[0], strict=True))


def wind_name(speed: float) -> str:
    """Return the name of a wind in legends."""
    return "flat sea" if speed == 0.0 else f"{speed:g} m/s"


def wind_lines(ax: Any, data: xr.Dataset, quantity: str, style: str = "-") -> Any:
    """Draw a quantity over (wind_speed, along), a curve in its colour for each wind.

    That of a flat sea is dashed and on top: it shows where another one is equal.
    """
    winds = data["wind_speed"].values.tolist()
    named = data.assign_coords(wind_speed=[wind_name(u) for u in winds])
    shown, colors = named.transpose("wind_speed", ...), [WIND_COLORS[u] for u in winds]
    styles = [style.replace("-", "--") if u == 0.0 else style for u in winds]
    ax = viz.marks.lines(ax, shown, quantity, styles, colors)
    for wind, line in zip(winds, ax.get_lines(), strict=False):
        line.set_zorder(2.0 if wind else 3.0)
    return ax


def wind_rows(key: str, numbers: Mapping[tuple[Form, float], Number | float]) -> list[Entry]:
    """Return a row of rows.toml for each rough sea, of numbers by form and wind."""
    return [row(key, [numbers[form, u] for form in FORMS], wind=wind_name(u), u=u) for u in ROUGH]


Form = Literal["physical", "paper"]
WINDS = (0.0, 5.0, 13.0)
ROUGH = WINDS[1:]
UAV = UAVS["dji-m300-rtk"]
FORMS: tuple[Form, Form] = ("physical", "paper")
FORM_NAMES = {"physical": "default", "paper": "paper preset"}
RADIUS = 0.25
"""Radius of an aperture large enough for the analog estimator, at 15 m from the lamp [m]."""
BUBBLE_SEAS = 8
"""Seas over which the effect of the bubbles is averaged."""


class Mean(NamedTuple):
    """Mean over seas: the gain over each sea, and the error common to all from the chains."""

    samples: Floats
    chain_error: float

    @property
    def number(self) -> Number:
        """Mean with its standard error; one sea has no spread."""
        n = len(self.samples)
        spread = self.samples.std(ddof=1) / np.sqrt(n) if n > 1 else 0.0
        return Number(float(self.samples.mean()), float(np.hypot(spread, self.chain_error)))

    @property
    def fluctuation(self) -> Number:
        """Standard deviation over the seas relative to the mean, with the error of normal gains."""
        n = len(self.samples)
        value = float(self.samples.std(ddof=1) / self.samples.mean())
        return Number(value, value / float(np.sqrt(2.0 * (n - 1))))

    def over(self, other: Mean) -> Number:
        """Return the quotient of two means over the same seas, whose spreads cancel."""
        quotient = ratio(self.number, other.number)
        if len(self.samples) != len(other.samples) or len(self.samples) == 1:
            return quotient
        a, b = (m.samples / m.samples.mean() for m in (self, other))
        chains = [m.chain_error / m.samples.mean() for m in (self, other)]
        error = np.hypot((a - b).std(ddof=1) / np.sqrt(len(a)), np.hypot(*chains))
        return Number(quotient.value, float(quotient.value * error))


def scenario(wind: float, form: Form, **tables: Any) -> mt.Scenario:
    """Return the paper's link and sea in a wind.

    Parameters
    ----------
    wind : float
        Wind at 10 m [m s-1]; 0 is a flat sea without foam and bubbles.
    form : {"physical", "paper"}
        Correct physics, or every form as published.
    **tables
        Keys of a link file that replace those of the paper's link.
    """
    waves = "paper" if wind in ROUGH else "scaled"
    sea = {"waves": waves, **tables.pop("sea", {})}
    config: dict[str, Any] = {"wind_speed": wind, "physics": form, "sea": sea, **tables}
    if wind == 0.0:
        config |= {"whitecaps": "none", "bubbles": {"model": "none"}, "sea": {"spectrum": "flat"}}
    return mt.Scenario.from_config(config)


def forced(wind: float, form: Form, **tables: Any) -> mt.Scenario:
    """Return the link for forced detection, without bubbles in the published forms.

    Their free paths through bubbles (E6) need the analog estimator: see `bubble_factor`.
    """
    if form == "paper":
        tables["bubbles"] = {"model": "none"}
    return scenario(wind, form, **tables)


def gusts(wind: float, form: Form, height: float = 5.0) -> mt.Dryden:
    """Return the gusts at a height in the correct or the published form."""
    return mt.Dryden.preset(form, wind_speed=wind, height=height)


def mean_h_alpha(wind: float, form: Form, height: float = 5.0) -> float:
    """Return the mean factor of the tilt; the published law is the Gamma fit."""
    if wind == 0.0:
        return 1.0
    kind: Literal["exact", "gamma"] = "exact" if form == "physical" else "gamma"
    law = UAV.tilt_law(gusts(wind, form, height), kind)
    return law.h_moment(1, np.radians(mt.Receiver().fov_deg))


def bubble_factor(wind: float, form: Form, setting: Setting, analog: int, **tables: Any) -> Number:
    """Return the gain with bubbles over that without, by the analog estimator.

    Parameters
    ----------
    wind, form, **tables
        As in `scenario`, with one source and one receiver.
    setting : Setting
        Seed and threads.
    analog : int
        Photons over each of `BUBBLE_SEAS` seas.

    Returns
    -------
    Number
        Ratio of the sums over seas, with its jackknife error.

    Raises
    ------
    Refused
        If photons are received over fewer than two of the seas.

    Notes
    -----
    Both runs share seas and photons, so that all photons that meet no bubble cancel. The aperture
    is larger than that of the link, in proportion to the distance.
    """
    plain = scenario(wind, form, **tables).link
    distance = plain.receivers[0].center[2] - plain.transmitters[0].center[2]
    wide = {**tables.get("receiver", {}), "radius": RADIUS * distance / 15.0}
    given: Any = {**tables, "receiver": wide, "run": {"estimator": "analog"}}
    clear = {"bubbles": {"model": "none"}}
    pair = [scenario(wind, form, **given), scenario(wind, form, **given, **clear)]
    gains = np.empty((BUBBLE_SEAS, 2))
    for i in range(BUBBLE_SEAS):
        seed = int(np.random.SeedSequence([setting.seed, i]).generate_state(1)[0])
        options: Any = {"estimator": "analog", "photons": analog, "threads": setting.threads}
        for j, made in enumerate(pair):
            sea = made.surface.with_seed(seed)
            gains[i, j] = mt.simulate(made.link, sea, seed=seed, **options).gain
    without_one = gains.sum(axis=0) - gains
    if not without_one.all():
        raise Refused("analog", analog, "photons enough to receive some over two seas")
    jackknife = without_one[:, 0] / without_one[:, 1]
    error = np.sqrt((BUBBLE_SEAS - 1) * jackknife.var())
    with_bubbles, without = gains.sum(axis=0)
    return Number(float(with_bubbles / without), float(error))


def mean_gain(
    wind: float,
    form: Form,
    setting: Setting,
    *,
    realizations: int,
    photons: int,
    analog: int,
    **tables: Any,
) -> list[Mean]:
    """Return the gain of each receiver, averaged over seas and tilts.

    Parameters
    ----------
    wind, form, **tables
        As in `forced`.
    setting : Setting
        Seed and threads.
    realizations : int
        Independent seas; a flat sea is taken once.
    photons : int
        Chains, common to all seas; ten times as many over a flat sea.
    analog : int
        Photons of `bubble_factor`, by which the published forms count the bubbles.

    Returns
    -------
    list of Mean
        Standard errors join the spread of the seas, that of the chains and that of the factor.
    """
    made = forced(wind, form, **tables)
    options = setting.run
    if wind == 0.0:
        result = mt.simulate(made.link, made.surface, photons=10 * photons, **options)
        gains, chains = np.atleast_2d(result.gain), np.atleast_1d(result.gain_stderr)
    else:
        series = mt.ensemble(made.link, realizations, made.surface, photons=photons, **options)
        gains, chains = series.gain.reshape(realizations, -1), np.atleast_1d(series.mean_stderr)
    tilt = [mean_h_alpha(wind, form, r.center[2]) for r in made.link.receivers]
    bubbles = [Number(1.0)] * len(tilt)
    if form == "paper" and wind > 0.0:
        bubbles = _bubble_factors(wind, setting, analog, **tables)
    return [
        Mean(f * b * g, float(f * np.hypot(b * e, db * g.mean())))
        for f, (b, db), g, e in zip(tilt, bubbles, gains.T, chains, strict=True)
    ]


def _bubble_factors(wind: float, setting: Setting, analog: int, **tables: Any) -> list[Number]:
    """Return the effect of the bubbles on each receiver; apertures in one place share it."""
    receivers = tables.pop("receiver", {})
    receivers = receivers if isinstance(receivers, list) else [receivers]
    places = [{key: one[key] for key in one if key != "radius"} for one in receivers]
    first = [places.index(place) for place in places]
    known = {
        i: bubble_factor(wind, "paper", setting, analog, receiver=places[i], **tables)
        for i in sorted(set(first))
    }
    return [known[i] for i in first]


def ratio(a: Number, b: Number) -> Number:
    """Return a / b with its standard error, as of independent numbers."""
    value = a.value / b.value
    return Number(value, abs(value) * float(np.hypot(a.stderr / a.value, b.stderr / b.value)))


def difference(a: Number, b: Number) -> Number:
    """Return a - b with its standard error, as of independent numbers."""
    return Number(a.value - b.value, float(np.hypot(a.stderr, b.stderr)))


def decibel(number: Number) -> Number:
    """Return 10 log10 of a number with its standard error."""
    error = 10.0 / np.log(10.0) * number.stderr / number.value
    return Number(10.0 * float(np.log10(number.value)), float(error))
