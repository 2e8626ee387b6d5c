"""Answers of a session as the texts and numbers of the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from meshtrace.explorer import texts
from meshtrace.explorer.session import Session
from meshtrace.explorer.stages import LIMIT, Fading, Failed, Gain

_NO_BITS = dict.fromkeys(("power", "required", "margin", "ber", "light", "background"), "–")


def gain_reading(session: Session, running: bool = False) -> dict[str, Any]:
    """Return gain, power, margin and bit error rate as texts, with warnings.

    Parameters
    ----------
    session : Session
        Source of the answers.
    running : bool
        Whether the sea runs: the gain is then that of the series.
    """
    found = session.answer("gain")
    empty: dict[str, Any] = dict.fromkeys(("gain", "db", "unscattered", "chains"), "–")
    empty |= {"notes": [], "value": None}
    if isinstance(found, Failed):
        return {**empty, **_NO_BITS, "notes": [found.reason]}
    if not isinstance(found, Gain):
        return {**empty, **_NO_BITS}
    share = found.unscattered / found.gain if found.gain > 0 and found.unscattered else 0.0
    texts_of = {
        "value": found.gain,
        "gain": texts.with_error(found.gain, found.stderr),
        "db": texts.decibels(found.gain),
        "unscattered": f"{100.0 * share:.1f} %" if found.unscattered is not None else "–",
        "chains": f"{found.photons} {'photons' if found.unscattered is None else 'chains'}",
        "notes": list(found.notes),
    }
    series = session.answer("fading")
    if running and isinstance(series, Fading) and session.fresh("fading"):
        now = float(np.interp(session.state.time, series.time, series.gain))
        texts_of |= {"value": now, "gain": f"{now:.3e}", "db": texts.decibels(now)}
    return {**texts_of, **_bits(found)}


def _bits(gain: Gain) -> dict[str, str]:
    bits = gain.bits
    if bits is None:
        return dict(_NO_BITS)
    error = bits.power_stderr / bits.power if bits.power > 0.0 else 0.0
    return {
        "power": f"{texts.power(bits.power)} ± {100.0 * error:.1g} %",
        "required": texts.power(bits.required) if np.isfinite(bits.required) else "none suffices",
        "margin": f"{bits.margin_db:+.1f} dB".replace("-", "\N{MINUS SIGN}")
        if np.isfinite(bits.margin_db)
        else "–",
        "ber": texts.bit_error_rate(bits.ber),
        "light": bits.light or "dark",
        "background": "–" if bits.background is None else texts.rate(bits.background),
    }


def fading_reading(session: Session) -> dict[str, Any]:
    """Return the series relative to its mean, the scintillation index and the lowest gain."""
    found = session.answer("fading")
    empty: dict[str, Any] = {"time": [], "gain": [], "duration": 12.0, "note": ""}
    empty |= dict.fromkeys(("index", "all_waves", "low"), "–")
    if isinstance(found, Failed):
        return {**empty, "note": found.reason}
    if not isinstance(found, Fading) or not found.gain.any():
        return empty
    relative = found.gain / found.gain.mean()
    index = "…"
    if found.index is not None:
        low, high = max(found.index.low, 0.0), found.index.high
        index = f"{found.index.value:.2g} ({low:.2g} … {high:.2g})"
    return {
        "time": found.time.tolist(),
        "gain": [round(float(g), 5) for g in relative],
        "duration": found.duration,
        "index": index,
        "all_waves": "–" if found.index_of_all is None else f"{found.index_of_all:.2g}",
        "low": texts.decibels(float(relative.min())),
        "note": f"left out for errors above 20 %: {found.left_out}" if found.left_out else "",
    }


def map_note(session: Session) -> str:
    """Return the reason for the lack of a map, or nothing."""
    found = session.answer("map")
    return found.reason if isinstance(found, Failed) and session.fresh("map") else ""


def caption(session: Session) -> str:
    """Return link, wind, seed and gain as the caption of a picture."""
    scenario, values = session.state.scenario, session.state.values
    gain = session.answer("gain")
    parts = [f"wind {scenario.wind_speed:g} m/s"]
    for name, unit in (("depth", "m deep"), ("height", "m high")):
        if values[name] is not None:
            parts.append(f"{name} {values[name]:g} {unit.split()[0]}")
    seed = getattr(scenario.surface, "seed", None)
    parts += [f"seed of the sea {seed}"] if seed is not None else []
    parts += [f"time {session.state.time:.2f} s"]
    if isinstance(gain, Gain) and session.fresh("gain"):
        parts.append(f"gain {texts.with_error(gain.gain, gain.stderr)}")
    return "meshtrace: " + ", ".join(parts)


MARGIN_LABEL = f"Margin (BER {LIMIT:g})"
