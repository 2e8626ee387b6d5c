"""Tests of the explorer need an extra: without it they are skipped.

Server and browser of the page serve all files: each takes seconds to start.
"""

import re
import subprocess
import sys

import pytest
from browser import chromium, until
from extras import lack_of

NOTE = lack_of("tests/apps/explorer", "explore", "trame", "pyvista")
collect_ignore_glob = ["test_*.py"] if NOTE else []


def pytest_report_header():
    return NOTE or None


@pytest.fixture(scope="session")
def url():
    """Start the command and return its address."""
    command = [sys.executable, "-m", "meshtrace", "explore", "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        line = process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+/\S+", line)
        yield found[0]
        process.terminate()
    assert found, line


@pytest.fixture(scope="session")
def browser(url):
    from shown_page import opened

    with chromium(1400, 1043) as driver:
        opened(driver, url)
        yield driver


@pytest.fixture
def page(browser):
    """Return the browser with all controls at the paper's link."""
    from shown_page import PAPER, begun, enter, gain_is, shown, sized

    from meshtrace.apps.explorer import controls

    sized(browser, 1400, 900)
    for name, value in controls.State(PAPER).values.items():
        if value is not None and float(shown(browser, name) or value) != value:
            enter(browser, name, value)
    reset = {
        "text_shown": False,
        "playing": False,
        **controls.State(PAPER).words,
    }
    for name, value in reset.items():
        browser.execute_script("window.trame.state.set(arguments[0], arguments[1])", name, value)
    if browser.execute_script("return trame.state.get('time')") != begun():
        browser.execute_script("trame.trigger('seek', arguments)", begun())
    until(lambda: gain_is(browser, {}), "the page does not return to the paper's link")
    return browser
