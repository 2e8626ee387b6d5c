"""Layout of the explorer's page, and the data of its side view and plan."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.colors import to_hex
from trame.ui.vuetify3 import VAppLayout
from trame.widgets import html, vtk
from trame.widgets import vuetify3 as v3
from trame_client.widgets.core import AbstractElement

from meshtrace.explorer.controls import CONTROLS, Control, State, slider_range
from meshtrace.explorer.readings import BITS
from meshtrace.explorer.scene import SCATTERED_COLOR, UNSCATTERED_COLOR, LiveScene
from meshtrace.link import Link
from meshtrace.viz.style import LED_COLOR, RECEIVER_COLOR, water_map

_STATUS = """working === "" ? "up to date" : ({
  gain: "tracing the gain …", rays: "tracing rays …", fading: "moving the sea …",
  map: "mapping …"})[working]"""


_KEY = {
    "lamp, half-power cone": LED_COLOR,
    "receiver, field of view": RECEIVER_COLOR,
    "received, unscattered": UNSCATTERED_COLOR,
    "received, scattered": SCATTERED_COLOR,
}

_WORDS = {"Sea": {"water": "Water"}, "Bits": {"light": "Daylight"}}

_ENTER = "{name} = $event.target.value === '' ? null : Number($event.target.value)"

_EVENTS = ("movelamp", "movereceiver", "seek")


class SceneView(vtk.VtkLocalView):
    """View that is drawn by the browser.

    Parameters
    ----------
    window : vtkRenderWindow
        Window of the scene.
    **options
        Attributes of the element.
    """

    def __init__(self, window: Any, **options: Any) -> None:
        super().__init__(window, **options)
        self._window = window
        # the description of a scene lacks the angle of view
        name = self.server.trigger_name(lambda: self.push_camera())
        self.on_ready = f"if ($event && !framed) {{ framed = true; trigger('{name}') }}"

    def push_changes(self) -> None:
        """Send the parts that have changed to the open page.

        `update` describes the whole scene besides, for a page that is loaded later, which takes as
        long again: it follows at the end of the work.
        """
        if self.server.protocol:
            changes = self._helper.scene(self._window, new_state=False)
            self.server.protocol.publish("trame.vtk.delta", changes)


def _part(name: str, **options: Any) -> AbstractElement:
    """Add one of the components of assets/page.js."""
    events = [key for key in options if key in _EVENTS]
    props = [key for key in options if key not in events]
    return AbstractElement(f"mt-{name}", __properties=props, __events=events, **options)


def build(server: Any, window: Any, actions: Any, link: Link) -> Any:
    """Build the page of a server; return the view of the render window."""
    values = {control.name: server.state[control.name] for control in CONTROLS}
    with VAppLayout(server), html.Div(classes="mt-page"):
        _head(actions)
        with html.Div(classes="mt-left"):
            for group in dict.fromkeys(c.group for c in CONTROLS if c.group):
                _group(group, [c for c in CONTROLS if c.group == group], values)
            html.Div("{{ refused }}", v_if="refused", classes="mt-card mt-note", id="refused")
        view = _scene(window)
        _views(link)
        _readings(actions)
        with v3.VDialog(v_model=("text_shown",), max_width=760), v3.VCard(classes="pa-4"):
            html.H2("{{ text_title }}", style="font-size:16px;font-weight:500;margin-bottom:8px")
            html.Pre("{{ text }}", classes="mt-text", id="text")
            with html.Div(style="display:flex;gap:10px;justify-content:flex-end;margin-top:10px"):
                _part("copy", text=("text",))
                v3.VBtn("Close", click="text_shown = false", variant="text", id="close")
    return view


def _head(actions: Any) -> None:
    with html.Div(classes="mt-head"):
        html.H1("meshtrace explorer")
        html.Span("{{ title }}", classes="mt-name")
        html.Span(f"{{{{ {_STATUS} }}}}", classes="mt-status", id="status")
        button: Any = {"size": "small", "variant": "tonal", "density": "comfortable"}
        v3.VBtn("Copy as TOML", click=(actions.show_text, "['TOML']"), id="toml", **button)
        v3.VBtn("Copy as Python", click=(actions.show_text, "['Python']"), id="python", **button)
        v3.VBtn("Save picture", click="trame.refs.scene.captureImage()", id="picture", **button)


def _group(group: str, controls: list[Control], values: dict[str, Any]) -> None:
    with html.Div(classes="mt-card"):
        html.H2(group)
        for control in controls:
            _control(control, values[control.name])
        for name, label in _WORDS.get(group, {}).items():
            with html.Div(classes="mt-control"):
                html.Label(label)
                with html.Select(v_model=(name,), id=name):
                    html.Option(
                        "{{ word }}", v_for=f"word in choices.{name}", key=("word",),
                        value=("word",),
                    )  # fmt: skip


def _control(control: Control, value: float | None) -> None:
    """Add a slider with a number field; both are disabled for links without the value."""
    name, absent = control.name, value is None
    low, high = slider_range(control, 1.0 if value is None else value)
    slider: Any = {"min": low, "max": high, "step": control.step, "model_value": (f"{name} ?? 0",),
                   "update_modelValue": f"{name} = Number($event.toFixed(4))"}  # fmt: skip
    if control.log:
        slider |= {"min": math.log10(low), "max": math.log10(high)}
        slider["model_value"] = (f"Math.log10(Math.max({name} ?? 1, 1e-9))",)
        slider["update_modelValue"] = f"{name} = Number(Math.pow(10, $event).toPrecision(3))"
    with html.Div(classes="mt-control"):
        html.Label(control.label)
        v3.VSlider(
            hide_details=True, density="compact", thumb_size=14, track_size=3, color="#2f6690",
            disabled=absent, id=f"slider-{name}", **slider,
        )  # fmt: skip
        html.Input(
            type="number", classes="mt-number", id=name, disabled=absent, step="any",
            value=(name,), change=_ENTER.format(name=name),
        )  # fmt: skip
        html.Span(control.unit, classes="mt-unit")


def _scene(window: Any) -> SceneView:
    with html.Div(classes="mt-scene"):
        view = SceneView(window, ref="scene", on_image_capture="shot = $event")
        with html.Div(classes="mt-time"):
            v3.VBtn(
                icon=("playing ? 'mdi-pause' : 'mdi-play'",), click="playing = !playing",
                size="small", color="#2f6690", id="play",
            )  # fmt: skip
            html.B("t = {{ time.toFixed(2) }} s", id="time")
        with html.Div(classes="mt-bar-scale", v_if="elevation.length"):
            html.Span("<span>elevation [m]</span>")
            shades = ", ".join(to_hex(water_map()(share)) for share in np.linspace(0.0, 1.0, 9))
            html.Div(style=f"background: linear-gradient(to right, {shades})")
            html.Span("<span>{{ elevation[0] }}</span><span>{{ elevation[1] }}</span>")
        with html.Div(classes="mt-key"):
            for text, color in _KEY.items():
                html.Span(f'<i style="background:{color}"></i>{text}')
        _part("picture", shot=("shot",), caption=("caption",))
    return view


def _views(link: Link) -> None:
    """Add side view and plan; in the side view both ends move the depth or the height."""
    lamp, receiver = link.transmitters[0], link.receivers[0]
    lamp_z = "depth = -$event.y" if lamp.center[2] < 0.0 else "height = $event.y"
    receiver_z = "height = $event.y" if receiver.center[2] > 0.0 else "depth = -$event.y"
    if lamp.center[2] < 0.0 and receiver.center[2] < 0.0:
        receiver_z = ""  # the depth is that of the lamp
    with html.Div(classes="mt-views"):
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
    with html.Div(classes="mt-right"):
        with html.Div(classes="mt-card"):
            html.H2("Channel gain")
            with html.Div(classes=("stale.gain && !playing ? 'mt-faded' : ''",)):
                html.Div("{{ reading.db }}", classes="mt-big", id="db")
                html.Div("{{ reading.gain }}", id="gain", raw_attrs=[':data-value="reading.value"'])
                _rows("reading", {"unscattered": "Unscattered share", "chains": "Sample"})
        with html.Div(classes="mt-card"):
            html.H2("Bits")
            with html.Div(classes=("stale.gain && !playing ? 'mt-faded' : ''",)):
                _rows("reading", BITS)
        with html.Div(classes="mt-card"):
            html.H2("Fading")
            _part("series", time=("fading.time",), gain=("fading.gain",), now=("time",),
                  duration=("fading.duration",), faded=("stale.fading",), id="series",
                  seek=(actions.seek, "[$event]"), classes="mt-tall")  # fmt: skip
            _part("histogram", gain=("fading.gain",), faded=("stale.fading",), id="histogram")
            with html.Div(classes=("stale.fading ? 'mt-faded' : ''",)):
                _rows("fading", {"index": "Scintillation index", "all_waves": "All waves",
                                 "low": "Lowest / mean"})  # fmt: skip
            html.Div("{{ fading.note }}", v_if="fading.note", classes="mt-note")
        with html.Div(classes="mt-card"):
            html.H2("Coverage")
            v3.VBtn(
                "Map the gain", click=actions.make_map, size="small", variant="tonal",
                color="#2f6690", block=True, id="map", disabled=("working === 'map'",),
            )  # fmt: skip
            html.Div("{{ map_note }}", v_if="map_note", classes="mt-note", id="map-note")
            with html.Dl(v_if="map", classes="mt-rows", style="margin-top:5px"):
                html.Dt("Peak")
                html.Dd("{{ map.peak }}", id="peak")
        with html.Div(v_if="reading.notes.length", classes="mt-card mt-note", id="notes"):
            html.Div("{{ note }}", v_for="note in reading.notes", key=("note",))


def _rows(source: str, labels: dict[str, str]) -> None:
    """Add a table of the texts of a reading by the labels of its keys."""
    with html.Dl(classes="mt-rows"):
        for key, label in labels.items():
            html.Dt(label)
            html.Dd(f"{{{{ {source}.{key} }}}}", id=f"{source}-{key}")


def views(state: State, scene: LiveScene) -> dict[str, Any]:
    """Return the data of the side view and the plan: limits, lamp, receiver and waves [m]."""
    stage, link = scene.stage, state.scenario.link
    (x, y), half = stage.center, stage.half
    lamp, receiver = link.transmitters[0], link.receivers[0]
    direction = getattr(state.scenario.surface, "wind_direction_deg", None)
    side = {
        "frame": {"x0": x - half, "x1": x + half, "y0": stage.bottom, "y1": stage.top},
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
    elevation = [] if scene.shows_daylight else list(scene.elevation_range)
    return {"side": side, "plan": plan, "elevation": elevation}


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
