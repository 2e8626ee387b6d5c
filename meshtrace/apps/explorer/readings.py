"""Texts of the page: answers, the design, the state as a link file and as a program."""

from __future__ import annotations

import base64
import io
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import tomli_w
from matplotlib.colors import to_hex

import meshtrace
from meshtrace import CoverageMap, surfaces
from meshtrace.apps.designs.page import PERIODS, BestValue, Design, Reach
from meshtrace.apps.explorer import stages
from meshtrace.apps.explorer.controls import BY_NAME, CHOICES, STARTS, State, in_words
from meshtrace.apps.explorer.influences import STEPS
from meshtrace.apps.explorer.session import Failed, Session
from meshtrace.apps.explorer.stages import DURATION, FADING_RATE, LIMIT, Fading, Signal
from meshtrace.comms import OokLink
from meshtrace.comms.budget import link_budget
from meshtrace.daylight import Daylight
from meshtrace.errors import Refused
from meshtrace.link import Link
from meshtrace.models import Model, modules_of
from meshtrace.optics import Water
from meshtrace.scenario import MeshFile, Scenario
from meshtrace.scenario.parts import daylight_recipe, detector_config
from meshtrace.studies.neighbours import DECIBELS
from meshtrace.viz import live, scenes

BER_FLOOR = 1e-15
"""Bit error rate below which a number says nothing about a device."""

BITS = {
    "power": "Received power",
    "required": "Required power",
    "margin": f"Margin (BER {LIMIT:g})",
    "ber": "Bit error rate",
    "spread": "Delay spread",
    "light": "Light",
    "background": "Background",
}
"""Labels of the readings of a transmission."""

LABELS = {
    "gain": {"unscattered": "Unscattered share", "chains": "Sample", "lean": "Aircraft leans by"},
    "bits": BITS,
    "fading": {"index": "Scintillation", "all_waves": "… of all waves", "low": "Lowest / mean"},
}
"""Labels of the tables of the page."""

_NO_BITS = dict.fromkeys(BITS, "–")
_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: ""}


def gain_reading(session: Session, running: bool = False) -> dict[str, Any]:
    """Return gain, power, margin and bit error rate as texts, with warnings.

    Parameters
    ----------
    session : Session
        Source of the answers.
    running : bool
        Whether the sea runs: the gain is then that of the series.
    """
    answer = session.answer("gain")
    empty: dict[str, Any] = dict.fromkeys(("db", "unscattered", "chains"), "–")
    empty |= {
        "notes": [],
        "budget": [],
        "value": None,
        "error": "",
        "lean": _lean(session.state),
        "verdict": "",
        "verdict_text": "",
    }
    if isinstance(answer, Failed):
        return empty | _NO_BITS | {"notes": [str(answer)]}
    if not isinstance(answer, Signal):
        return empty | _NO_BITS
    result, gain, sample, share = answer.gain, float(answer.gain.gains[0]), "photons", "–"
    if result.gain_ballistic is not None:
        unscattered = float(np.ravel(result.gain_ballistic)[0])
        sample, share = "chains", f"{100.0 * unscattered / gain if gain > 0.0 else 0.0:.1f} %"
    reading = empty | {
        "value": gain,
        "error": f"± {_digit(_error_db(gain, float(result.stderrs[0])))} dB" if gain > 0.0 else "",
        "stderr": float(result.stderrs[0]),
        "db": decibels(gain),
        "unscattered": share,
        "chains": f"{result.photons} {sample}",
        "notes": list(answer.notes),
    }
    series = session.answer("fading")
    if running and isinstance(series, Fading) and session.fresh("fading"):
        gaps = np.abs(series.time - session.state.time)
        now = float(np.interp(session.state.time, series.time, series.gain))
        if len(gaps) and gaps.min() < 1.0 / FADING_RATE:  # not within a gap of the series
            reading |= {"value": now, "error": "", "db": decibels(now)}
    moving = series if isinstance(series, Fading) and session.fresh("fading") else None
    reading["budget"] = budget(answer, session.state.scenario.link)
    return reading | _bits(answer) | verdict(answer, moving)


def starts() -> list[dict[str, str]]:
    """Return heading, words, margin and verdict of each link to start from."""
    return [
        {"name": name, "title": start["title"], "words": start["words"],
         "verdict": start["verdict"], "margin": minus(f"{start['margin']:+.1f} dB")}
        for name, start in STARTS.items()
    ]  # fmt: skip


def answer_of_start(link: Scenario) -> dict[str, Any]:
    """Compute quiet time [s], margin [dB] and verdict of a link to start from."""
    time = stages.quiet_time(link)
    state = State(link).at(time)
    *_, signal = stages.gains(state, lambda *_: None)
    *_, series = stages.fading(state, lambda *_: None)
    assert signal.detector is not None  # each has one receiver
    margin, answer = _margin(signal.detector, signal), verdict(signal, series)["verdict"]
    return {"time": time, "margin": round(margin, 1), "verdict": answer}


def verdict(signal: Signal, series: Fading | None) -> dict[str, str]:
    """Return whether a link closes, fades or is dead, with a reason in words.

    A link fades if it closes on average and some gain of the series is too low for it.
    """
    if signal.detector is None:
        return {}
    margin = _margin(signal.detector, signal)
    if not margin >= 0.0:
        lacking = f"{minus(f'{margin:.1f}')} dB" if np.isfinite(margin) else "no light suffices"
        return {"verdict": "dead", "verdict_text": f"Dead: {lacking}"}
    if series is not None and len(series.gain):
        # the margin is in optical decibels, those of the gain
        needed = signal.gain.gains[0] * 10.0 ** (-0.1 * margin)
        short = float((series.gain < needed).mean())
        if short > 0.0:
            return {"verdict": "fades", "verdict_text": f"Fades: too dark in {100.0 * short:.2g} %"}
    return {"verdict": "closes", "verdict_text": f"Closes: {margin:.1f} dB to spare"}


def budget(signal: Signal, link: Link) -> list[dict[str, Any]]:
    """Return names, texts and bars of the budget, from the power of the lamp to the margin.

    The ends are percentages of the range of powers; the steps add up.
    """
    if signal.detector is None or not signal.gain.gains[0] > 0.0:
        return []
    parts = link_budget(signal.detector, float(signal.gain.gains[0]), LIMIT)
    lamp, received = parts.transmitted_dbm, float(parts.received_dbm)
    margin = received - parts.required_dbm
    if not math.isfinite(margin):
        return []
    rest = float(parts.gain_db)
    steps = []
    lamp_at, lens = getattr(link.transmitters[0], "center", None), link.receivers[0].center
    if link.water.layers is None and lamp_at is not None and lamp_at[2] * lens[2] < 0.0:
        # along the straight line between the ends, its part in the water
        share = -min(lamp_at[2], lens[2]) / abs(lamp_at[2] - lens[2])
        water = -DECIBELS * link.water.c * share * math.dist(lamp_at, lens)
        steps, rest = [("lost in the water", water)], rest - water
        unscattered = signal.gain.gain_ballistic
        if unscattered is not None and (direct := float(np.ravel(unscattered)[0])) > 0.0:
            back = 10.0 * math.log10(signal.gain.gains[0] / direct)
            steps, rest = [*steps, ("scattered in", back)], rest - back
    steps += [("spread, surface", rest), ("lens, filter", parts.concentration_db + parts.filter_db)]
    # name, text, powers at both ends of the bar [dBm], kind
    lines: list[tuple[str, str, float | None, float, str]]
    lines, level = [("lamp", f"{lamp:.1f} dBm", None, lamp, "end")], lamp
    for name, change in steps:
        lines.append((name, f"{change:+.1f} dB", level, level + change, "step"))
        level += change
    lines += [("received", f"{received:.1f} dBm", None, received, "end"),
              ("needed", f"{parts.required_dbm:.1f} dBm", None, parts.required_dbm, "end"),
              ("margin", f"{margin:+.1f} dB", parts.required_dbm, received, "margin")]  # fmt: skip
    levels = [line[3] for line in lines]
    low, high = min(levels) - 0.06 * (max(levels) - min(levels)), max(levels)
    place = [100.0 * (level - low) / (high - low) for level in levels]
    begin = [0.0 if line[2] is None else 100.0 * (line[2] - low) / (high - low) for line in lines]
    return [
        {"name": name, "text": minus(text), "kind": kind, "left": min(a, b), "width": abs(b - a)}
        for (name, text, _, _, kind), a, b in zip(lines, begin, place, strict=True)
    ]


def influences(session: Session) -> list[dict[str, str]]:
    """Return the three inputs whose step changes the margin most, in words, with the changes.

    Changes within two of their standard errors are left out.
    """
    answer = session.answer("influences")
    sure = [] if isinstance(answer, Failed) or answer is None else [
        i for i in answer if abs(i.change) > max(2.0 * i.stderr, 5e-3)
    ]  # fmt: skip
    return [{"step": _step_words(i.name), "change": _with_error(i.change, i.stderr)}
            for i in sure[:3]]  # fmt: skip


def _step_words(name: str) -> str:
    """Return the step of an input in words.

    Examples
    --------
    >>> _step_words("wind"), _step_words("bit_rate")
    ('+1 m/s of wind', '+10 % of bit rate')
    """
    control = BY_NAME[name]
    step = f"{STEPS[name]:g} {control.unit}" if name in STEPS else "10 %"
    return f"+{step} of {control.label[0].lower()}{control.label[1:]}"


def _with_error(change: float, error: float) -> str:
    """Format a change [dB] to hundredths, with its standard error unless it is exact."""
    text = minus(f"{change:+.2f}")
    return f"{text} ± {max(error, 0.01):.2f} dB" if error > 0.0 else f"{text} dB"


def _margin(detector: OokLink, signal: Signal) -> float:
    """Return the optical margin of the mean gain [dB]."""
    return float(link_budget(detector, signal.gain.gain, LIMIT).margin_optical_db)


def _lean(state: State) -> str:
    """Return the tilt of the aircraft in the mean wind."""
    uav = state.scenario.uav
    if uav is None:
        return "–"
    return f"{math.degrees(float(uav.tilt((state.scenario.wind_speed, 0.0, 0.0)).angle)):.1f} deg"


def _bits(signal: Signal) -> dict[str, str]:
    detector = signal.detector
    if detector is None:
        return dict(_NO_BITS)
    received, error = (float(detector.received_power(float(g))) for g in
                       (signal.gain.gain, signal.gain.gain_stderr))  # fmt: skip
    share = error / received if received > 0.0 else 0.0
    required = detector.required_power(LIMIT)
    margin = _margin(detector, signal)
    return {
        "power": f"{power(received)} ± {100.0 * share:{'.0f' if share > 0.095 else '.1g'}} %",
        "required": power(required) if np.isfinite(required) else "none suffices",
        "margin": minus(f"{margin:+.1f} dB") if np.isfinite(margin) else "–",
        "ber": bit_error_rate(signal.ber),
        "spread": _spread(detector),
        "light": signal.daylight or "dark",
        "background": f"{detector.background_rate:.2g} counts/s" if signal.daylight else "–",
    }


def _spread(detector: OokLink) -> str:
    """Return the rms delay spread of the channel and, if it matters, its power penalty."""
    if detector.response is None:
        return "–"
    text = f"{1e9 * detector.response.rms_spread:.2g} ns"
    if detector.filters.response is None:
        return f"{text}, short"
    text = f"{text}, {detector.spread_in_bits:.2g} bit"
    # what the spread of the pulses costs in power
    cost = detector.required_power(LIMIT) / detector.replace(response=None).required_power(LIMIT)
    return f"{text}, costs {10.0 * math.log10(cost):.1f} dB" if np.isfinite(cost) else text


def fading_reading(session: Session) -> dict[str, Any]:
    """Return the series relative to its mean, the scintillation index and the lowest gain."""
    fading = session.answer("fading")
    empty: dict[str, Any] = {"time": [], "gain": [], "duration": DURATION, "note": ""}
    empty |= dict.fromkeys(("index", "all_waves", "low"), "–")
    if isinstance(fading, Failed):
        return empty | {"note": str(fading)}
    if not isinstance(fading, Fading) or not fading.gain.any():
        return empty
    shines, mean = fading.gain > 0.0, fading.gain.mean()
    relative = fading.gain / mean
    signal, lacks = session.answer("gain"), math.nan
    if isinstance(signal, Signal) and signal.detector is not None and session.fresh("gain"):
        lacks = 10.0 * math.log10(max(signal.gain.gains[0], 1e-300) / mean)
        lacks -= _margin(signal.detector, signal)
    index = "…"
    if fading.index is not None:
        low, high = max(fading.index.low, 0.0), fading.index.high
        index = f"{fading.index.value:#.2g} ({low:#.2g} … {high:#.2g})"
    return {
        "time": fading.time[shines].tolist(),
        "gain": np.round(10.0 * np.log10(relative[shines]), 4).tolist(),
        "duration": DURATION,
        "least": lacks if math.isfinite(lacks) else None,
        "index": index,
        "all_waves": "–" if fading.index_of_all is None else f"{fading.index_of_all:#.2g}",
        "low": decibels(float(relative.min())),
        "note": f"left out for errors above 20 %: {fading.left_out}" if fading.left_out else "",
    }


def refusal(name: str, error: Refused) -> str:
    """Return the refusal of a control in words of the page and its unit.

    Examples
    --------
    >>> refusal("fov", Refused("receiver.fov_deg", 400.0, "0 < fov_deg <= 180"))
    'Field of view: above 0 to 180 degrees'
    """
    control = BY_NAME.get(name)
    if control is None:
        return str(error)
    last = re.split(r"[.\[\]]+", error.field.rstrip("]"))[-1]
    if last not in {name, *(key.rpartition(".")[2] for key in control.keys)}:
        return f"{control.label}: {error}"  # what its value makes of another part of the link
    text, unit = error.allowed, {"deg": "degrees"}.get(control.unit, control.unit)
    if limits := re.match(r"(?:(\S+) (<=?) \w+ (<=?) ([^\s,]+)|(>=?) (\S+))", text):
        low, above, below, high, only, least = limits.groups()
        ends = [f"{float(end) * control.per_unit:g}" for end in (low or least, high or "inf")]
        text = "above " * ("<" == above or ">" == only) + ends[0]
        text += " or more" * (only == ">=")
        text += f" to {'below ' * (below == '<')}{ends[1]}" if ends[1] != "inf" else ""
        text = f"{text} {unit}".rstrip()
    return f"{control.label}: {_PLAIN.get(text, text)}"


_PLAIN = {"an integer": "a whole number", "finite numbers": "a number"}


def gain_difference(a: Mapping[str, Any], b: Mapping[str, Any]) -> str:
    """Return the gain ratio B / A in decibels, with its standard error.

    The errors of both runs are taken for independent.

    Examples
    --------
    >>> gain_difference({"value": 2e-5, "stderr": 4e-8}, {"value": 1e-5, "stderr": 3e-8})
    '−3.01 ± 0.02 dB'
    """
    if not (a["value"] and b["value"]):
        return "–"
    error = math.hypot(*(_error_db(r["value"], r["stderr"]) for r in (a, b)))
    change = 10.0 * math.log10(b["value"] / a["value"])
    digits = max(_digit(error)[::-1].find("."), 2)
    return f"{minus(f'{change:+.{digits}f}')} ± {_digit(error)} dB"


def _error_db(value: float, stderr: float) -> float:
    """Return the standard error of a value in decibels."""
    return DECIBELS * stderr / value


def _digit(error: float) -> str:
    """Return an error with its first digit, at least hundredths."""
    return f"{error:.{min(max(2, -math.floor(math.log10(error))), 4) if error > 0.0 else 2}f}"


def differences(before: State, now: State) -> list[str]:
    """List the controls that differ between two states as lines "label: A, B unit"."""
    a, b = before.settings, now.settings
    lines = []
    for name, control in BY_NAME.items():
        if a[name] != b[name]:
            values = ", ".join("–" if v is None else f"{v:g}" for v in (a[name], b[name]))
            lines.append(f"{control.label}: {values} {control.unit}".rstrip())
    words = [n for n in CHOICES if a[n] != b[n]]
    lines += [f"{CHOICES[n].label}: {in_words(a[n])}, {in_words(b[n])}" for n in words]
    return lines or ["Move a control: this state stays as A."]


def map_note(session: Session) -> str:
    """Return the reason why there is no map, or an empty text."""
    coverage = session.answer("map")
    return str(coverage) if isinstance(coverage, Failed) and session.fresh("map") else ""


def map_image(coverage: CoverageMap) -> dict[str, Any]:
    """Return a map as an image with its limits [m], colour scale and peak."""
    from matplotlib import colormaps
    from PIL import Image

    shades = np.ascontiguousarray(live.map_shades(coverage)[..., :3].transpose(1, 0, 2)[::-1])
    file = io.BytesIO()
    Image.fromarray(shades).save(file, "PNG")
    half = 0.5 * (coverage.x[1] - coverage.x[0])
    low, high = float(coverage.x[0] - half), float(coverage.x[-1] + half)
    i, j = np.unravel_index(int(coverage.gain.argmax()), coverage.gain.shape)
    peak = float(coverage.gain[i, j])
    return {
        "url": f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}",
        "x0": low, "x1": high, "y0": low, "y1": high, "most": decibels(peak, 0),
        "least": decibels(peak * 10.0 ** (-0.1 * live.MAP_DB), 0),
        "peak": f"{decibels(peak)} at ({coverage.x[i]:.1f}, {coverage.y[j]:.1f}) m",
        "colors": [to_hex(colormaps["viridis"](v)) for v in np.linspace(0, 1, 9)],
    }  # fmt: skip


def caption(session: Session) -> str:
    """Return link, sea and gain as the caption of a picture."""
    scenario, time, signal = session.state.scenario, session.state.time, session.answer("gain")
    gain = signal.gain if isinstance(signal, Signal) and session.fresh("gain") else None
    return f"meshtrace: {scenes.caption(scenario.link, scenario.surface, time, gain)}"


def decibels(ratio: float, digits: int = 2) -> str:
    """Return a ratio in decibels.

    Examples
    --------
    >>> decibels(1e-4), decibels(0.0)
    ('−40.00 dB', 'none')
    """
    if ratio <= 0.0:
        return "none"
    return minus(f"{10.0 * math.log10(ratio):.{digits}f} dB")


def minus(number: str) -> str:
    """Format a number with a typographic minus sign."""
    return number.replace("-", "\N{MINUS SIGN}")


def power(watt: float) -> str:
    """Return an optical power with a prefix.

    Examples
    --------
    >>> power(2.5014e-8), power(0.0)
    ('25.01 nW', '0 W')
    """
    if watt <= 0.0:
        return "0 W"
    thousand = max(min(3 * math.floor(math.log10(watt) / 3.0), 0), -15)
    return f"{watt / 10.0**thousand:.4g} {_PREFIXES[thousand]}W"


def bit_error_rate(ber: float) -> str:
    """Return a bit error rate, with a floor.

    Examples
    --------
    >>> bit_error_rate(1.234e-4), bit_error_rate(1e-300)
    ('1.23e-04', '< 1e-15')
    """
    return f"< {BER_FLOOR:g}" if ber < BER_FLOOR else f"{ber:.2e}"


def design_reading(design: Design) -> dict[str, Any]:
    """Return the page of a design as texts: answer, tables of (title, head, rows) and notes.

    Values are in the units of the controls.
    """
    values, remarks = ("", "given", *PERIODS), []
    for choice in design.choices:
        remarks += [f"{_scale(choice.key, '')[0]}: {choice.note}"] if choice.note else []
    gained = {c.period: f"{c.gained:+.1f} ± {c.gained_stderr:.1f} dB" for c in design.together}
    together = ["Change", "", *(minus(gained.get(period, "–")) for period in PERIODS)]
    tables = (
        ("Figures", ("", *PERIODS), _figures(design)),
        ("Best values, each alone", values, _by_key(design.choices, _best_alone)),
        ("Best lens, view and filter together", values,
         [*_by_key(design.together, _best), together]),
        ("Just closes, each alone", values, _by_key(design.reach, _closing)),
        ("Budget", ("", *PERIODS, "unit"), _budget(design)),
    )  # fmt: skip
    return {
        "answer": [line.strip().replace("+-", "±") for line in design.answer],
        "tables": [dict(zip(("title", "head", "rows"), table, strict=True)) for table in tables],
        "notes": [*dict.fromkeys(remarks), *design.notes, *filter(None, [design.status])],
        "text": design.summary(),
    }


def _figures(design: Design) -> list[list[str]]:
    columns = [
        (
            f"{f.outage[0]:.2g} ({f.outage[1]:.2g} … {f.outage[2]:.2g})",
            bit_error_rate(f.ber[0]),
            f"{f.margin:.1f} dB",
            f"{f.reserve:.1f} ± {f.reserve_stderr:.1f} dB",
            f"{f.capacity / 1e6:.3g} Mbit/s",
        )
        for f in design.figures
    ]
    names = ("Outage", "Mean bit error rate", "Margin of the mean",
             f"Reserve, outage {100.0 * design.outage:g} %", "Capacity")  # fmt: skip
    return [list(map(minus, row)) for row in zip(names, *columns, strict=True)]


def _by_key(table: Sequence[Any], cell: Callable[[Any, float], str]) -> list[list[str]]:
    """Return a row for each key: name, value as given, and a cell for each light."""
    lines = []
    for key in dict.fromkeys(value.key for value in table):
        mine = [value for value in table if value.key == key]
        name, scale = _scale(key, mine[0].unit)
        cells = (minus(cell(value, scale)) for value in mine)
        lines.append([name, f"{mine[0].present * scale:.3g}", *cells])
    return lines


def _best(choice: BestValue, scale: float) -> str:
    low, high = (end * scale for end in choice.flat)
    return f"{choice.best * scale:.3g} ({low:.3g} … {high:.3g})"


def _best_alone(choice: BestValue, scale: float) -> str:
    return f"{_best(choice, scale)}, {round(choice.gained, 1) + 0.0:+.1f} dB"


def _closing(row: Reach, scale: float) -> str:
    """Return the limit up to which a link closes, or the end of the scan."""
    if math.isnan(row.value):
        return "none"
    whole = row.note == "end of the scan"
    sides = ("all from", "all to") if whole else ("≥", "≤")
    return f"{sides[row.side == 'at most']} {row.value * scale:.3g}"


def _budget(design: Design) -> list[list[str]]:
    return [
        [
            f"= {line.name}" if line.total else line.name,
            *(minus(f"{round(value, 1) + 0.0:.1f}") for value in (line.night, line.day)),
            line.unit,
        ]
        for line in design.budget
    ]


def _scale(key: str, unit: str) -> tuple[str, float]:
    """Return the label with unit and the scale of the control that has a key."""
    for control in BY_NAME.values():
        if key in control.keys:
            return f"{control.label} [{control.unit}]", control.per_unit
    return f"{key} [{unit}]", 1.0


_WIDTH = 96
_MAKERS = {"clear": "clear_sky"}  # of `Daylight`, where the name is not that of the model
_PHOTONS = 10_000


def as_toml(scenario: Scenario) -> str:
    """Return the text of a link file with the values that differ from the defaults.

    The full configuration if the shorter text would be another scenario.
    """
    # with a detector, or that of the scenario would be printed in full
    default = Scenario.from_toml("").replace(detector=OokLink())
    short = _difference(scenario.to_config(), default.to_config())
    if scenario.detector is not None:
        short.setdefault("detector", {"bit_rate": scenario.detector.bit_rate})
    try:
        if Scenario.from_config(short) == scenario:
            return tomli_w.dumps(short)
    except Refused:
        pass
    return scenario.to_toml()


def _difference(table: Mapping[str, Any], default: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of nested tables that differ from the defaults; other kinds in full."""
    changed: dict[str, Any] = {}
    for key, value in table.items():
        other = default.get(key)
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            same_kind = all(value.get(k) == other.get(k) for k in ("kind", "model", "spectrum"))
            value = _difference(value, other) if same_kind else dict(value)
            if value:
                changed[key] = value
        elif value != other or key == "wind_speed":
            changed[key] = value
    return changed


def as_python(scenario: Scenario) -> str:
    """Return a program that simulates a scenario.

    Objects of classes outside of the public package are read from the text of a link file.
    """
    lines = ["import meshtrace as mt", ""]
    run, mesh = f"photons={_PHOTONS}, seed={scenario.run.seed}", ""
    if scenario.meshing != meshtrace.Meshing():
        mesh = f", mesh={_expression(scenario.meshing, 0)}"
    try:
        link = f"link = {_expression(scenario.link, 0)}"
        if isinstance(scenario.surface, MeshFile):
            path = scenario.surface.file
            sea = f"sea = mt.surfaces.from_trimesh({path!r}, overhangs=True)"
        else:
            sea = f"sea = {_expression(scenario.surface, 0)}"
    except Refused:
        text = scenario.to_toml().replace("\\", "\\\\")
        lines[1:1] = [f"import {module}" for module in modules_of(text)]
        lines += [f'scenario = mt.Scenario.from_toml("""\n{text}""")']
        return "\n".join([*lines, "print(scenario.simulate().summary())", ""])
    with_bits = scenario.detector is not None or scenario.daylight is not None
    receiver = scenario.detector or OokLink()
    # the bits of the page are behind the response of the channel, which needs the arrivals
    through = with_bits and receiver.response is None
    run += mesh + (", record=[mt.Arrivals()]" if through else "")
    lines += [link, sea, f"result = mt.simulate(link, sea, {run})", "print(result.summary())"]
    if with_bits:
        detector = OokLink.model_validate(detector_config(receiver, scenario.link))
        lines += [f"bits = mt.OokLink.of_link(link, {_expression(detector, 0)})"]
        if through:
            lines += [
                "seen = mt.impulse_response(result)",
                "arrivals = seen.delay, seen.weight, seen.angle",
                "response = mt.comms.ChannelResponse.from_arrivals(*arrivals)",
                "bits = bits.replace(response=response)",
            ]
        if scenario.daylight is not None:
            day = _daylight(scenario.daylight)
            background = f"mt.background(link, sea, {day}{mesh})"
            lines += [f"bits = mt.comms.background.with_background(bits, {background})"]
        under = "in the dark" if scenario.daylight is None else f"under {scenario.daylight.light}"
        lines += [
            "ber = float(bits.ber(bits.received_power(result.gain)))",
            f'print(f"BER at {detector.bit_rate:g} bit/s {under}: {{ber:.3g}}")',
        ]
    return "\n".join([*lines, ""])


def _daylight(day: Daylight) -> str:
    """Return a Python expression for a daylight, calling its model where that reproduces it."""
    try:
        recipe = daylight_recipe(day)
    except Refused:
        return _expression(day, 0)
    maker = recipe.pop("model")
    if maker == "moon":
        recipe = {key.removeprefix("sun_"): value for key, value in recipe.items()}
    if day.wavelength_nm != Daylight.model_fields["wavelength_nm"].default:
        recipe["wavelength_nm"] = day.wavelength_nm
    arguments = ", ".join(f"{key}={value!r}" for key, value in recipe.items())
    return f"mt.Daylight.{_MAKERS.get(maker, maker)}({arguments})"


def _expression(value: Any, indent: int) -> str:
    """Return the Python expression of a value, with the fields that differ from their defaults."""
    if isinstance(value, tuple):
        items = [_expression(item, indent + 4) for item in value]
        return f"({', '.join(items)}{',' if len(items) == 1 else ''})"
    if not isinstance(value, Model):
        return json.dumps(value) if isinstance(value, str) else repr(value)
    name = type(value).__name__
    places = (part for module, part in _PUBLIC if getattr(module, name, None) is type(value))
    path = next((f"mt.{part}{name}" for part in places), "")
    if not path:
        raise Refused("", name, "a public class")
    follows = isinstance(value, Water) and value.spectrum is not None  # a, b and others from it
    fields = {
        key: item
        for key, item in value.__repr_args__()
        if key != "kind" and (not follows or key in value.model_fields_set)
    }
    items = [f"{key}={_expression(item, indent + 4)}" for key, item in fields.items()]
    short = f"{path}({', '.join(items)})"
    if len(short) + indent <= _WIDTH and "\n" not in short:
        return short
    pad = " " * (indent + 4)
    return f"{path}(\n" + "".join(f"{pad}{item},\n" for item in items) + " " * indent + ")"


_PUBLIC = ((meshtrace, ""), (surfaces, "surfaces."), (meshtrace.comms, "comms."),
           (meshtrace.optics, "optics."))  # fmt: skip
