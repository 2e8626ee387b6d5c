"""Photograph the explorer in three states for explorer.md, in headless Chromium.

python docs/make_explorer_pictures.py
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from browser import chromium, until

STATIC = Path(__file__).with_name("_static")
ENTER = (
    "const e = document.getElementById(arguments[0]); e.value = arguments[1];"
    "e.dispatchEvent(new Event('change'))"
)
DOWNLINK = """[transmitter]
kind = "air-led"
height = 5.0

[receiver]
kind = "water-receiver"
depth = 10.0
"""
STATES = {
    "explorer": (None, {"wind": 9, "depth": 12, "height": 7, "offset_x": 2}, None),
    "explorer_day": (None, {"wind": 5, "depth": 15}, "clear"),
    "explorer_downlink": (DOWNLINK, {"wind": 7, "depth": 8}, None),
}


def photograph(name: str, link: str | None, moves: dict[str, float], light: str | None) -> None:
    """Write a picture of the page after some moves."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "meshtrace", "explore", "--no-browser", "--port", "0"]
        if link is not None:
            file = Path(folder, "downlink.toml")
            file.write_text(link)
            command.insert(4, str(file))
        with (
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server,
            chromium(1400, 1043) as driver,
        ):
            assert server.stdout is not None
            found = re.search(r"http\S+", server.stdout.readline())
            assert found
            driver.get(found[0])
            until(lambda: driver.find_elements("id", "gain"), "no page", 120.0)
            for control, value in moves.items():
                driver.execute_script(ENTER, control, value)
            if light is not None:
                driver.execute_script("window.trame.state.set('light', arguments[0])", light)
            time.sleep(2.0)
            until(lambda: idle(driver), "no answer", 300.0)
            driver.find_element("id", "map").click()
            time.sleep(2.0)
            until(lambda: idle(driver), "no map", 300.0)
            time.sleep(1.0)
            shot = Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")
            server.terminate()
    shot.save(STATIC / f"{name}.png", optimize=True)


def idle(driver: object) -> bool:
    """Return whether the page has answered."""
    return driver.find_element("id", "status").text == "up to date"  # type: ignore[attr-defined]


if __name__ == "__main__":
    for name, state in STATES.items():
        photograph(name, *state)
