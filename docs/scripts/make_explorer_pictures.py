"""Photograph the explorer for explorer.md, in headless Chromium: all pictures, or some by name.

python docs/scripts/make_explorer_pictures.py [explorer_phone ...]
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from PIL import Image
from places import ROOT, STATIC

sys.path.insert(0, str(ROOT / "tests"))

from browser import chromium, until

DOWNLINK = """[transmitter]
kind = "air-led"
height = 5.0

[receiver]
kind = "water-receiver"
depth = 10.0
"""
HARBOUR = "#depth=4&half_angle=20&height=7&water=petzold-harbour&wavelength=514&wind=6"
# fragment of the address, then buttons and moves of controls
STATES: dict[str, tuple[str, list[str | tuple[str, float]]]] = {
    "explorer": ("#depth=12&height=7&offset_x=2&wind=9", ["map"]),
    "explorer_day": ("#depth=15&light=clear&sun=65&wind=10", []),
    "explorer_downlink": ("#depth=8&wind=7", []),
    "explorer_compare": ("#depth=8&light=overcast", ["compare", ("depth", 16.0), ("wind", 9.0)]),
    "explorer_design": (
        "#chlorophyll=0.2&light=clear&fov=20&water=chlorophyll&wavelength=490",
        ["design", "design-page"],
    ),
    "explorer_phone": (HARBOUR, []),
}
PHONE = (390, 844)
DESK = (1440, 900)


def photograph(driver: Any, url: str, name: str) -> None:
    """Write a picture of the page in a state; that of a phone in light and in dark colours."""
    fragment, actions = STATES[name]
    phone = name == "explorer_phone"
    show(driver, PHONE if phone else DESK, dark=False)
    driver.get("about:blank")
    driver.get(url + fragment)
    until(lambda: driver.find_elements("id", "gain"), "no page", 120.0)
    rest(driver)
    for action in actions:
        if isinstance(action, str):
            driver.execute_script(f"document.getElementById('{action}').click()")
            if action == "design":
                until(lambda: driver.find_elements("id", "design-page"), "no design", 600.0)
        else:
            driver.execute_script("trame.state.set(...arguments)", *action)
        rest(driver)
    shots = [shot(driver)]
    if phone:
        driver.execute_script("scrollTo(0, 1180)")
        shots.append(shot(driver))
        show(driver, PHONE, dark=True)
        shots.append(shot(driver))
    gap, (width, height) = 16, shots[0].size
    whole = Image.new("RGB", (len(shots) * (width + gap) - gap, height), "white")
    for i, part in enumerate(shots):
        whole.paste(part, (i * (width + gap), 0))
    whole.save(STATIC / f"{name}.png", optimize=True)


def show(driver: Any, size: tuple[int, int], dark: bool) -> None:
    """Set the size of the window [px] and the colours of the system."""
    metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size == PHONE}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})


def rest(driver: Any) -> None:
    """Wait until the page has answered."""
    time.sleep(3.0)
    status = "return document.getElementById('status').textContent"
    until(lambda: driver.execute_script(status) == "up to date", "no answer", 300.0)
    time.sleep(1.0)


def shot(driver: Any) -> Image.Image:
    """Return a picture of the window, its scene in full resolution."""
    full = "const c = document.querySelector('.mt-scene canvas'); return c.width === c.clientWidth"
    while True:
        until(lambda: driver.execute_script(full), "a coarse scene")
        taken = driver.get_screenshot_as_png()
        if driver.execute_script(full):  # not drawn coarsely meanwhile
            return Image.open(io.BytesIO(taken)).convert("RGB")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "downlink.toml")
        file.write_text(DOWNLINK)
        for link in ((), (str(file),)):
            names = [n for n in sys.argv[1:] or STATES if ("downlink" in n) == bool(link)]
            if not names:
                continue
            explore = [sys.executable, "-m", "meshtrace", "explore", *link]
            command = [*explore, "--no-browser", "--port", "0"]
            with (
                subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server,
                chromium(1440, 1043) as driver,
            ):
                assert server.stdout is not None
                found = re.search(r"http\S+", server.stdout.readline())
                assert found
                for name in names:
                    photograph(driver, found[0], name)
                server.terminate()


if __name__ == "__main__":
    main()
