"""Latency of the explorer: from a move of a control to the new gain and to the new scene.

`python tests/benchmarks/explorer_latency.py [MOVES]` opens the page in headless Chromium and prints
a table. CPU seconds are those of the server, which other work on the machine does not change.
"""

import os
import re
import statistics
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from browser import chromium, until

from meshtrace.apps.explorer import controls, stages
from meshtrace.apps.explorer.scene import LiveScene
from meshtrace.scenario import Scenario

PARTS = ("CPU of the state", "CPU of the first gain", "CPU of its bits", "CPU of a new scene",
         "CPU of a scene in time", "CPU of the refined gain and bits")  # fmt: skip
FRAMES = 5.0  # time over which frames are counted [s]

# The canvas is drawn only when the scene changes: the first drawing after a move shows it.
MEASURE = """
const [name, value, done] = arguments;
const gain = document.getElementById('gain'), before = gain.dataset.value;
const start = performance.now();
let drawn = null;
window.onDraw = () => { drawn ??= performance.now() - start; };
const input = document.getElementById(name);
input.value = value;
input.dispatchEvent(new Event('change'));
const look = () => {
  const fresh = !gain.parentElement.className.includes('mt-faded');
  if (fresh && gain.dataset.value !== before) {
    const answered = performance.now() - start;
    setTimeout(() => done([answered, drawn]), 300);
  } else requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""
PATCH = """
for (const name of ['drawArrays', 'drawElements']) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...all) {
    window.onDraw && window.onDraw();
    return draw.apply(this, all);
  };
}
"""
COUNT = """
const [seconds, done] = arguments;
let frames = 0, last = -100;
window.onDraw = () => {
  const now = performance.now();
  if (now - last > 20) frames++;
  last = now;
};
setTimeout(() => done(frames / seconds), 1000 * seconds);
"""


def cpu_seconds(pid):
    """Return the processor time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def idle(driver):
    return driver.find_element("id", "status").text == "up to date"


def measure(driver, pid, first, moves):
    """Move the lamp down from a first depth, as the page keeps what it has seen; return rows of time to the gain [ms], to the scene [ms], and CPU time to both [ms]."""
    rows = []
    for i in range(moves):
        until(lambda: idle(driver), "the page stays at work", 120.0)
        before = cpu_seconds(pid)
        answered, drawn = driver.execute_async_script(MEASURE, "depth", first + 0.1 * i)
        rows.append((answered, drawn, 1e3 * (cpu_seconds(pid) - before)))
    return rows


def processor_times(moves):
    """Return the CPU time of the parts of a move in this process [ms]."""
    state = controls.State(Scenario.from_toml(""))
    scene, rows = LiveScene(state), []
    for i in range(moves + 1):
        times = [time.process_time()]
        moved = state.moved({"depth": 11.0 + 0.1 * i})
        moved.settings, moved.ranges, moved.barred  # noqa: B018
        times.append(time.process_time())
        gains = stages.gains(moved, lambda *_: None)
        for _ in range(2):
            next(gains)
            times.append(time.process_time())
        scene.update(moved)
        times.append(time.process_time())
        scene.update(moved.at(0.1 * i), running=True)
        times.append(time.process_time())
        list(gains)
        times.append(time.process_time())
        rows.append([1e3 * (b - a) for a, b in pairwise(times)])
    return [statistics.median(column) for column in zip(*rows[1:], strict=True)]


def main(moves):
    command = [sys.executable, "-m", "meshtrace", "explore", "--no-browser", "--port", "0"]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server,
        chromium(1400, 1043) as driver,
    ):
        driver.set_script_timeout(120)
        url = re.search(r"http\S+", server.stdout.readline())[0]
        start = time.monotonic()
        driver.get(url)
        until(lambda: driver.find_elements("id", "gain"), "no page")
        page = time.monotonic() - start
        until(lambda: idle(driver), "no answer", 300.0)
        driver.execute_script(PATCH)
        measure(driver, server.pid, 10.1, 2)
        rows = measure(driver, server.pid, 11.0, moves)
        driver.find_element("id", "play").click()
        time.sleep(1.0)
        before = cpu_seconds(server.pid)
        rate = driver.execute_async_script(COUNT, FRAMES)
        busy = (cpu_seconds(server.pid) - before) / FRAMES
        server.terminate()
    print(f"load of the machine           {os.getloadavg()[0]:8.1f}")
    print(f"page shown after              {page:8.2f} s")
    for name, column in (("move to new gain", 0), ("move to new scene", 1)):
        times = [row[column] for row in rows if row[column] is not None]
        ordered = sorted(times)
        print(
            f"{name:<30}{statistics.median(times):8.0f} ms median, "
            f"{ordered[int(0.9 * (len(ordered) - 1))]:.0f} ms 90 % of {len(times)}"
        )
    print(f"{'CPU until 0.3 s after the gain':<30}{statistics.median(r[2] for r in rows):8.0f} ms")
    for name, value in zip(PARTS, processor_times(moves), strict=True):
        print(f"{name:<30}{value:8.0f} ms")
    print(f"{'running sea':<30}{rate:8.1f} frames/s, {100.0 * busy:.0f} % of a core")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
