"""Scans of a design: best values with their flat ranges, each alone and together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from meshtrace.comms.background import filter_shift_nm
from meshtrace.comms.capacity import capacity, hard_information
from meshtrace.errors import Refused, require_keys, require_pair
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.parallel import results_of
from meshtrace.studies.designs.model import COLOUR, LENS, RATE, VIEW, WIDTH, LinkModel
from meshtrace.studies.designs.page import LIGHTS, BestValue
from meshtrace.studies.keys import Variant

_FLAT_DB = 0.5
_POINTS = 49  # of a scan
_NODES, _VIEWS = 4, 13  # links of a scan over a key that changes the light, and over the view
_FEW_COUNTS = 100.0  # in a one
_WINDOWS = 6  # intervals of bit rates between those whose averaging windows are sought
_COLOURS = 9  # wavelengths with common paths
_COLOURS_NM = 400.0, 650.0
_DB = 10.0 / math.log(10.0)
OPTICS = LENS, VIEW, WIDTH
"""Keys of which the best values are also sought together."""

Bounds = Mapping[str, tuple[float, float]]


class Scan(NamedTuple):
    """Reserves over the values of a key."""

    choice: BestValue
    values: Floats
    reserves: Floats


class Scans(LinkModel):
    """Reserves over the values of each key, and the best of them."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.windows: dict[str, tuple[Floats, Floats]] = {}  # shares of a bit over ln(bit rate)

    def bounds(self, over: Bounds | None) -> dict[str, tuple[float, float]]:
        """Return the bounds of each key that is scanned."""
        name, end = self.link.air_end
        x = end.position[0]
        radius, reach = self.link.only_receiver.radius, 0.5 * (end.height + self.link.depth)
        found = {
            LENS: (radius / 4.0, 4.0 * radius),
            VIEW: (2.0, 120.0),
            WIDTH: (1.0, 40.0),
            f"{name}.position.0": (x, x + reach),
            f"{name}.height": (0.5 * end.height, 2.0 * end.height),
            RATE: (0.1 * self.dark.bit_rate, min(30.0 * self.dark.bit_rate, 1e10)),
        }
        spectrum = self.link.water.spectrum
        if spectrum is not None and len(self.link.transmitters) == 1:
            low, high = spectrum.limits_nm
            found[COLOUR] = max(low, _COLOURS_NM[0]), min(high, _COLOURS_NM[1])
        elif over and COLOUR in over:
            self.link.at_wavelength(over[COLOUR][0])  # refused
        require_keys({} if over is None else over, found, "over")
        for key, pair in (over or {}).items():
            low, high = require_pair(pair, f"over.{key}", "(low, high), low < high")
            if not low < high:
                raise Refused(f"over.{key}", pair, "(low, high), low < high")
            found[key] = (float(low), float(high))
        return found

    def scans(self, key: str, bounds: tuple[float, float]) -> list[Scan]:
        """Return the reserves over the values of a key under the lights that have it."""
        values = self._values(key, bounds)
        if key == RATE:
            return [self._bit_rates(light, values) for light in LIGHTS]
        if key == COLOUR:
            return self._colours(values)
        logs, errors = self._logs(key, values)
        name, found = {LENS: "radius", VIEW: "fov_deg", WIDTH: "width"}.get(key), []
        for light in LIGHTS:
            rows = [
                self.reserve(light, log, **({name: v} if name else {}))
                for v, log in zip(values.tolist(), logs[light], strict=True)
            ]
            found.append(self._scan(light, key, values, np.array(rows), _DB * errors))
        return found

    def _values(self, key: str, bounds: tuple[float, float]) -> Floats:
        """Return the values of a scan, the link's among them."""
        given = self._given(key)
        spaced = np.linspace if key.endswith("position.0") else np.geomspace
        values = spaced(*bounds, _POINTS)
        if bounds[0] <= given <= bounds[1]:
            values[np.abs(values - given).argmin()] = given
        return values

    def _given(self, key: str) -> float:
        """Return the value of a key of the link or of the detector."""
        return float(Variant(self.link, None, self.dark).value(key))

    def _logs(self, key: str, values: Floats) -> tuple[dict[str, Floats], Floats]:
        """Return the log ratios of the gains to the link's by light, and their errors.

        Less the power that the response of the channel costs.
        """
        if key == WIDTH:
            return dict.fromkeys(LIGHTS, np.zeros(len(values))), np.zeros(len(values))
        straight = key.endswith("position.0")
        at = values if straight else np.log(values)
        step, links, places = 2 if key == VIEW else 1, self._at(key, values), at[_nodes(key)]
        logs, errors = np.array([self.means.ratio(link) for link in links]).T
        found = dict.fromkeys(LIGHTS, _through(places, logs, at))
        if key == LENS:  # which changes no delays
            return found, np.interp(at, places, errors)
        for light in LIGHTS:
            losses = np.array([self.pulse_loss(light, link) for link in links[::step]])
            found[light] = found[light] - _through(places[::step], losses, at)
        return found, np.interp(at, places, errors)

    def _at(self, key: str, values: Floats) -> list[Link]:
        """Return the links at the nodes of a scan."""
        base = Variant(self.link, None)
        return [base.set(key, value).link for value in values[_nodes(key)].tolist()]

    def prepare(self, bounds: dict[str, tuple[float, float]]) -> None:
        """Find what all parts of the page share: gains, lights and needs, and the own response."""
        keys = (key for key in bounds if key not in (WIDTH, RATE, COLOUR))
        links = [link for key in keys for link in self._at(key, self._values(key, bounds[key]))]
        results_of(
            self.campaign.threads,
            lambda: self.fades,
            partial(self.means.find, links),  # with common random numbers
            *(partial(self.need, light) for light in LIGHTS),
            lambda: self.spreads and self.response(self.link),
        )

    def _bit_rates(self, light: str, values: Floats) -> Scan:
        """Return the reserves over bit rates; the best has the largest rate of hard decisions."""
        error = self.quantile_stderr
        gain = self.quantile(self.link.only_receiver.fov_deg)
        nodes = values[:: len(values) // _WINDOWS]
        shares = [self.at_rate(light, v).averaging_window * v for v in nodes.tolist()]
        self.windows[light] = np.log(nodes), np.array(shares)
        ooks = [self.at_rate(light, v, self.window_at(light, v)) for v in values.tolist()]
        some = [self.above(gain, ook, ook.required_power(self.limit)) for ook in ooks[::2]]
        rows = np.interp(np.log(values), np.log(values[::2]), some)
        carried, errors = [], []
        for ook in ooks:
            powers = ook.received_power(np.exp(gain + error * np.array([0.0, -1.0, 1.0])))
            hard, *ends = hard_information(ook.ber(powers)).tolist()
            if ook.levels(powers[0])[1] * ook.bit_time < _FEW_COUNTS:  # bounded by full counts
                hard = capacity(ook, [math.exp(gain)]).hard / ook.bit_rate
            carried.append(hard * ook.bit_rate)
            errors.append(ends)
        low, high = 5.0 * np.log10(np.maximum(np.array(errors), 1e-9)).T
        merit = 10.0 * np.log10(np.maximum(carried, 1e-3))
        return self._scan(light, RATE, values, rows, np.abs(high - low), merit)

    def window_at(self, light: str, bit_rate: float) -> float:
        """Return the averaging window at a bit rate, interpolated in the scan [s]."""
        return float(np.interp(math.log(bit_rate), *self.windows[light])) / bit_rate

    def _colours(self, values: Floats) -> list[Scan]:
        """Return the reserves over wavelengths from common paths, by night and by day."""
        own = self.link.transmitters[0].wavelength_nm
        nodes = np.unique([*np.linspace(values[0], values[-1], _COLOURS), own])
        links = [self.link.at_wavelength(nm) for nm in nodes.tolist()]
        logs, errors = self.colours(links, int(np.searchsorted(nodes, own)))
        found = []
        for light in LIGHTS:
            try:
                bright = self.brightness(light, nodes.tolist())
                each = zip(links, logs, bright.tolist(), strict=True)
                rows = [self.at_colour(light, *one) for one in each]
            except Refused:  # irradiances of one wavelength
                continue
            curve = _through(nodes, np.array(rows), values)
            bars = _DB * np.interp(values, nodes, errors)
            found.append(self._scan(light, COLOUR, values, curve, bars))
        return found

    def _least_width(self, fov_deg: float) -> float:
        """Return the shift of an interference filter at the edge of a view [nm]."""
        return filter_shift_nm(self.link.transmitters[0].wavelength_nm, 0.5 * fov_deg)

    def _scan(
        self, light: str, key: str, values: Floats, rows: Floats, errors: Floats,
        merit: Floats | None = None,
    ) -> Scan:  # fmt: skip
        """Return the scan of a key with its best value, by a merit in dB other than the reserve."""
        given = self._given(key)
        allowed, notes = np.ones(len(values), bool), []
        sought, own = rows, self.reserve(light)
        if merit is not None:
            sought, own = merit, float(np.interp(math.log(given), np.log(values), merit))
        if key == WIDTH:
            least = self._least_width(self.link.only_receiver.fov_deg)
            allowed = values >= min(least, values[-1])
            sought = rows = np.where(allowed, rows, math.nan)
            notes.append(f"shift at the edge of the view {least:.2g} nm")
        best = int(np.argmax(np.where(allowed, sought, -np.inf)))
        inside = allowed & (sought >= sought[best] - np.maximum(_FLAT_DB, errors))
        low = high = best
        while low > 0 and inside[low - 1]:
            low -= 1
        while high < len(values) - 1 and inside[high + 1]:
            high += 1
        if best in (0, len(values) - 1) and values[best] != given:
            notes.append("at the bound")
        if merit is not None:
            notes.append(f"{10.0 ** (0.1 * merit[best]) / 1e6:.3g} Mbit/s after hard decisions")
        gained = sought[best] - own if math.isfinite(own) else math.nan
        unit = {"deg": "deg", "nm": "nm", "rate": "bit s-1"}.get(key.rpartition("_")[2], "m")
        flat = float(values[low]), float(values[high])
        choice = BestValue(light, key, unit, given, float(values[best]), float(gained),
                           float(errors[best]), flat, "; ".join(notes))  # fmt: skip
        return Scan(choice, values, rows)

    def optics(
        self, bounds: dict[str, tuple[float, float]]
    ) -> tuple[dict[str, list[Scan]], list[BestValue]]:
        """Return the scans of lens, view and filter, each alone, and their best values together."""
        alone = {key: self.scans(key, bounds[key]) for key in OPTICS}
        return alone, [row for light in LIGHTS for row in self._together(light, bounds)]

    def _together(
        self, light: str, bounds: dict[str, tuple[float, float]]
    ) -> tuple[BestValue, ...]:
        """Return the best lens, view and filter together, with their gain by a separate run."""
        radii, views = (self._values(key, bounds[key]) for key in (LENS, VIEW))
        by_radius, by_view = (
            self._logs(key, x)[0][light] for key, x in ((LENS, radii), (VIEW, views))
        )
        radii, views, by_radius, by_view = (x[::2] for x in (radii, views, by_radius, by_view))
        least = bounds[WIDTH][0]
        rows = np.array([
            [
                self.reserve(light, r + v, radius=radius, fov_deg=view,
                             width=max(least, self._least_width(view)))
                for view, v in zip(views.tolist(), by_view, strict=True)
            ]
            for radius, r in zip(radii.tolist(), by_radius, strict=True)
        ])  # fmt: skip
        i, j = np.unravel_index(int(np.argmax(rows)), rows.shape)
        near = rows >= rows[i, j] - _FLAT_DB
        best = {"radius": float(radii[i]), "fov_deg": float(views[j])}
        width = max(least, self._least_width(best["fov_deg"]))
        link = self.link.replace(LENS, best["radius"]).replace(VIEW, best["fov_deg"])
        reserve, error = self.run(light, link, width)
        gained = reserve - self.reserve(light)
        note = f"by a separate run; {rows[i, j]:+.1f} dB by the scans"
        widths = [max(least, self._least_width(v)) for v in views[near.any(axis=0)].tolist()]
        own = self.dark.optics
        table = (
            (LENS, "m", own.radius, best["radius"], radii[near.any(axis=1)]),
            (VIEW, "deg", own.fov_deg, best["fov_deg"], views[near.any(axis=0)]),
            (WIDTH, "nm", own.filter_width_nm, width, np.array(widths)),
        )
        return tuple(
            BestValue(light, key, unit, given, value, gained, error,
                   (float(flat.min()), float(flat.max())), note)
            for key, unit, given, value, flat in table
        )  # fmt: skip


def _nodes(key: str) -> NDArray[np.intp]:
    """Return the numbers of the values of a scan at which there are links."""
    count = _VIEWS if key == VIEW else _NODES
    return np.linspace(0, _POINTS - 1, count).round().astype(np.intp)


def _through(places: Floats, rows: Floats, at: Floats) -> Floats:
    """Return a smooth curve through finite values at places."""
    if len(places) == len(at):
        return rows
    finite = np.isfinite(rows)
    if finite.sum() < 2:
        return np.full(len(at), -math.inf)
    return np.asarray(PchipInterpolator(places[finite], rows[finite])(at))
