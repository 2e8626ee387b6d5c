"""Headless Chromium for tests of pages: no host but this machine can be reached."""

import os
import shutil
import time
from contextlib import contextmanager
from importlib.util import find_spec

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
DRIVER = shutil.which("chromedriver")
NEEDED = (
    "needs Chromium, its driver and selenium: apt-get install chromium chromium-driver, "
    "pip install selenium"
)
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    # no network, whatever the machine has
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)


@contextmanager
def chromium(width, height, *flags):
    """Yield a browser with a window of a size; without one the test is left out, or fails in CI."""
    if not (CHROMIUM and DRIVER and find_spec("selenium")):
        # where all is checked, a page that nobody has opened is a failure
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)(NEEDED)
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    for flag in (*FLAGS, f"--window-size={width},{height}", *flags):
        options.add_argument(flag)
    with webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER)) as driver:
        yield driver


def until(condition, problem, seconds=60.0):
    """Wait until a condition holds, and return it; a slow machine draws slowly."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, problem
        time.sleep(0.1)
    return found
