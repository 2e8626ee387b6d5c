"""Layout of the explorer's page, and the data of its side view and plan."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.colors import to_hex
from trame.ui.html import DivLayout
from trame.widgets import html
from trame_client.widgets.core import AbstractElement

from meshtrace.explorer.controls import BY_NAME, CHOICES, CONTROLS, Choice, Control, State
from meshtrace.explorer.readings import BITS
from meshtrace.explorer.scene import SCATTERED_COLOR, UNSCATTERED_COLOR, LiveScene, light_color
from meshtrace.link import Link
from meshtrace.viz.style import RECEIVER_COLOR, to_srgb

_STATUS = """working === "" ? "up to date" : ({
  gain: "tracing the gain …", rays: "tracing rays …", fading: "moving the sea …",
  map: "mapping …"})[working]"""

_KEY = {
    "lamp and beam": "var(--lamp)",
    "receiver and view": RECEIVER_COLOR,
    "unscattered light": UNSCATTERED_COLOR,
    "scattered light": SCATTERED_COLOR,
}

_ENTER = "{name} = $event.target.value === '' ? null : Number($event.target.value)"

_SCENE = "Scene in 3D: drag or arrow keys turn it, wheel or plus and minus zoom, Home resets"

_EVENTS = ("movelamp", "movereceiver", "seek", "ready", "drawn", "restore", "close")


def _part(name: str, **options: Any) -> AbstractElement:
    """Add one of the components of assets/."""
    events = [key for key in options if key in _EVENTS]
    props = [key for key in options if key not in events]
    return AbstractElement(f"mt-{name}", __properties=props, __events=events, **options)


def _button(text: str, click: Any, name: str, **options: Any) -> None:
    html.Button(text, type="button", click=click, id=name, **options)


def build(server: Any, actions: Any, link: Link) -> None:
    """Build the page of a server."""
    groups = dict.fromkeys(control.group for control in CONTROLS)
    with DivLayout(server), html.Div(classes="mt-page", style=("`--lamp: ${lamp_color}`",)):
        _head(actions)
        with html.Main(classes=("kept ? 'mt-main-part mt-two' : 'mt-main-part'",)):
            _scene(actions)
            with html.Div(classes="mt-left"):
                html.Div("{{ refused }}", v_if="refused", classes="mt-card mt-note", id="refused",
                         raw_attrs=['role="alert"'])  # fmt: skip
                for group in groups:
                    _group(group)
            _views(link)
            _readings(actions)
        _part("text", title=("text_title",), text=("text",), shown=("text_shown",),
              close="text_shown = false")  # fmt: skip
        _part("design", design=("design",), shown=("design_shown",), stale=("stale.design",),
              close="design_shown = false")  # fmt: skip


def _head(actions: Any) -> None:
    with html.Header(classes="mt-head"):
        html.H1("meshtrace explorer")
        html.Span("{{ title }}", classes="mt-name")
        html.Span(f"{{{{ {_STATUS} }}}}", classes="mt-status", id="status",
                  raw_attrs=['role="status"'])  # fmt: skip
        with html.Div(classes="mt-actions"):
            _button("{{ kept ? 'End comparison' : 'Compare' }}", actions.compare, "compare")
            _button("Swap A and B", actions.swap, "swap", v_if="kept")
            _part("link", moves=("moves",), base=("base",), restore=(actions.restore, "[$event]"))
            _button("TOML", (actions.show_text, "['TOML']"), "toml")
            _button("Python", (actions.show_text, "['Python']"), "python")
            _button("Save picture", "trame.refs.scene.save()", "picture")


def _group(group: str) -> None:
    choices = {name: choice for name, choice in CHOICES.items() if choice.group == group}
    with html.Details(classes="mt-card", raw_attrs=["open"]):
        with html.Summary():
            html.H2(group)
        for name, choice in choices.items():
            _choice(name, choice)
        for control in CONTROLS:
            if control.group == group:
                _control(control)


def _choice(name: str, choice: Choice) -> None:
    with html.Div(classes="mt-control"):
        html.Label(choice.label, raw_attrs=[f'for="{name}"'])
        with html.Select(v_model=(name,), id=name):
            html.Option(
                "{{ word }}{{ barred." + name + "?.[word] }}", v_for=f"word in choices.{name}",
                key=("word",), value=("word",), disabled=(f"barred.{name}?.[word] !== undefined",),
            )  # fmt: skip


def _control(control: Control) -> None:
    """Add a slider with a number field; both are disabled for links without the value."""
    name = control.name
    shown, entered = f"{name} ?? ends.{name}[0]", f"{name} = Number($event.target.value)"
    if control.log:
        shown = f"Math.log10(Math.max({name} ?? 1, 1e-9))"
        entered = f"{name} = Number(Math.pow(10, $event.target.value).toPrecision(3))"
    label = f"{control.label} [{control.unit}]" if control.unit else control.label
    absent: Any = (f"{name} === null",)
    with html.Div(classes="mt-control"):
        html.Label(control.label, raw_attrs=[f'for="{name}"'])
        html.Input(
            type="range", min=(f"ends.{name}[0]",), max=(f"ends.{name}[1]",), step=control.step,
            value=(shown,), input=entered, disabled=absent, id=f"slider-{name}",
            raw_attrs=[
                f'aria-label="{label}, slider"',
                f':aria-valuetext="{name} + \' {control.unit}\'"',
            ],
        )  # fmt: skip
        html.Input(
            type="number", classes="mt-number", id=name, disabled=absent, step="any",
            value=(name,), change=_ENTER.format(name=name), raw_attrs=[f'aria-label="{label}"'],
        )  # fmt: skip
        html.Span(control.unit, classes="mt-unit", raw_attrs=['aria-hidden="true"'])


def _scene(actions: Any) -> None:
    with html.Section(classes="mt-scene", raw_attrs=['aria-label="Scene"']):
        _part("scene", ref="scene", label=_SCENE, caption=("caption",), ready=actions.scene_ready,
              drawn=actions.drawn)  # fmt: skip
        with html.Div(classes="mt-time"):
            html.Button(
                "{{ playing ? '❚❚' : '▶' }}",
                type="button", click="playing = !playing", id="play",
                raw_attrs=[":aria-label=\"playing ? 'Stop the sea' : 'Let the sea run'\""],
            )  # fmt: skip
            html.B("t = {{ time.toFixed(2) }} s", id="time")
        html.B("{{ reading.db }}", classes="mt-chip", raw_attrs=['aria-hidden="true"'])
        html.Button(
            "⌂", type="button", click="trame.refs.scene.home()", id="home",
            raw_attrs=['aria-label="Home: the view at the start"', 'title="Home"'],
        )  # fmt: skip
        with html.Div(classes="mt-key"):
            for text, color in _KEY.items():
                html.Span(f'<i style="background:{color}"></i>{text}')


def _views(link: Link) -> None:
    """Add side view and plan; in the side view both ends move the depth or the height."""
    lamp, receiver = link.transmitters[0], link.receivers[0]
    lamp_z = "depth = -$event.y" if lamp.center[2] < 0.0 else "height = $event.y"
    receiver_z = "height = $event.y" if receiver.center[2] > 0.0 else "depth = -$event.y"
    if lamp.center[2] < 0.0 and receiver.center[2] < 0.0:
        receiver_z = ""  # the lamp has the depth
    with html.Section(classes="mt-views", raw_attrs=['aria-label="Side view and plan"']):
        side: Any = {"title": "Side view", "across": "x", "up": "z", "side": True}
        _part(
            "drag", id="side", frame=("side.frame",), lamp=("side.lamp",),
            receiver=("side.receiver",), profile=("side.profile",), **side,
            movelamp=f"lamp_x = $event.x; {lamp_z}",
            movereceiver=f"offset_x = $event.x; {receiver_z}",
        )  # fmt: skip
        plan: Any = {"title": "Plan", "across": "x", "up": "y"}
        _part(
            "drag", id="plan", frame=("plan.frame",), lamp=("plan.lamp",),
            receiver=("plan.receiver",), wind=("plan.wind",), image=("map",), **plan,
            movelamp="lamp_x = $event.x; lamp_y = $event.y",
            movereceiver="offset_x = $event.x; offset_y = $event.y",
        )  # fmt: skip


def _readings(actions: Any) -> None:
    stale = "stale.gain && !playing ? 'mt-faded' : ''"
    with html.Section(classes="mt-right", raw_attrs=['aria-label="Results"']):
        with html.Div(classes="mt-card", v_if="kept", id="kept"):
            html.H2("A, left, and B, right")
            html.Div("{{ line }}", v_for="line in kept.lines", key=("line",))
        with html.Div(classes="mt-card"):
            html.H2("Channel gain")
            with html.Div(classes=(stale,)):
                html.Div("{{ reading.db }}", classes="mt-big", id="db")
                html.Div("{{ reading.gain }}", id="gain", raw_attrs=[':data-value="reading.value"'])
                html.Div("{{ kept && `A: ${kept.reading.db}, ${kept.reading.gain}` }}", v_if="kept",
                         id="kept-gain")  # fmt: skip
                _rows(
                    "reading",
                    {
                        "unscattered": "Unscattered share",
                        "chains": "Sample",
                        "lean": "Aircraft leans by",
                    },
                )
        with html.Div(classes="mt-card"):
            html.H2("Bits")
            with html.Div(classes=(stale,)):
                _rows("reading", BITS)
        _design(actions)
        with html.Div(classes="mt-card"):
            html.H2("Fading")
            other: Any = ("kept && kept.fading",)
            _part("series", time=("fading.time",), gain=("fading.gain",), now=("time",),
                  duration=("fading.duration",), faded=("stale.fading",), id="series",
                  other=other, seek=(actions.seek, "[$event]"), classes="mt-tall")  # fmt: skip
            _part("histogram", gain=("fading.gain",), faded=("stale.fading",), id="histogram",
                  other=other)  # fmt: skip
            with html.Div(classes=("stale.fading ? 'mt-faded' : ''",)):
                _rows("fading", {"index": "Scintillation", "all_waves": "… of all waves",
                                 "low": "Lowest / mean"})  # fmt: skip
            html.Div("{{ fading.note }}", v_if="fading.note", classes="mt-note")
        with html.Div(classes="mt-card"):
            html.H2("Coverage")
            _button("Map the gain", actions.make_map, "map", disabled=("working === 'map'",),
                    classes="mt-wide")  # fmt: skip
            html.Div("{{ map_note }}", v_if="map_note", classes="mt-note", id="map-note")
            with html.Dl(v_if="map", classes="mt-rows"), html.Div():
                html.Dt("Peak")
                html.Dd("{{ map.peak }}", id="peak")
        with html.Div(v_if="reading.notes.length", classes="mt-card mt-note", id="notes"):
            html.Div("{{ note }}", v_for="note in reading.notes", key=("note",))


def _design(actions: Any) -> None:
    with html.Div(classes="mt-card", id="design-card"):
        html.H2("Design")
        _button("{{ designing === null ? 'Design this link' : `Stop (${designing} s)` }}",
                actions.design, "design", classes="mt-wide")  # fmt: skip
        html.Div("{{ design.problem }}", v_if="design?.problem", classes="mt-note")
        with html.Div(v_if="design?.answer", classes=("stale.design ? 'mt-faded' : ''",)):
            html.P("{{ line }}", v_for="line in design.answer", key=("line",))
            _button("Figures and best values", "design_shown = true", "design-page",
                    classes="mt-wide")  # fmt: skip


def _rows(source: str, labels: dict[str, str]) -> None:
    """Add a table of the texts of a reading, and of state A, by the labels of its keys."""
    with html.Dl(classes="mt-rows"):
        for key, label in labels.items():
            with html.Div():
                html.Dt(label)
                html.Dd(f"{{{{ kept.{source}.{key} }}}}", v_if="kept", classes="mt-a")
                html.Dd(f"{{{{ {source}.{key} }}}}", id=f"{source}-{key}")


def limits(state: State) -> dict[str, Any]:
    """Return the ends of the sliders, and the words that the wavelength bars, with the reason."""
    logs = {name: BY_NAME[name].log for name in BY_NAME}
    ends = {
        name: [math.log10(v) if logs[name] else v for v in pair]
        for name, pair in state.ranges.items()
    }
    return {"ends": ends, "barred": {"water": {k: f" ({v})" for k, v in state.barred.items()}}}


def views(state: State, scene: LiveScene) -> dict[str, Any]:
    """Return the data of the side view and the plan: limits, lamp, receiver and waves [m].

    With the colour of the light of the lamp.
    """
    stage, link = scene.stage, state.scenario.link
    (x, y), half = stage.center, stage.half
    lamp, receiver = link.transmitters[0], link.receivers[0]
    direction = getattr(state.scenario.surface, "wind_direction_deg", None)
    room = 0.05 * (stage.top - stage.bottom)  # for the marks of lamp and receiver
    low, high = stage.bottom - room, stage.top + room
    side = {
        "frame": {"x0": x - half, "x1": x + half, "y0": low, "y1": high},
        "lamp": _end(lamp, (0, 2), getattr(lamp, "spread_deg", 0.0), 1.0),
        "receiver": _end(receiver, (0, 2), 0.5 * receiver.fov_deg, -1.0),
        "profile": scene.profile(),
    }
    plan = {
        "frame": {"x0": x - half, "x1": x + half, "y0": y - half, "y1": y + half},
        "lamp": _end(lamp, (0, 1), 0.0, 1.0),
        "receiver": _end(receiver, (0, 1), 0.0, 1.0),
        "wind": direction,
    }
    nm = lamp.wavelength_nm
    color = to_hex(to_srgb(np.minimum(0.12 + 0.9 * np.array(light_color(nm)), 1.0)))
    return {"side": side, "plan": plan, "lamp_color": color}


def _end(part: Any, axes: tuple[int, int], half: float, sign: float) -> dict[str, Any] | None:
    """Return place and cone of a lamp or receiver in two of the axes; None for sun and sky."""
    if not hasattr(part, "depth") and not hasattr(part, "height"):
        return None
    i, j = axes
    across, up = (sign * part.axis[k] for k in (0, 2))
    return {
        "x": part.center[i], "y": part.center[j], "half": half, "axis": math.atan2(across, up),
        "air": part.center[2] > 0.0,
    }  # fmt: skip
