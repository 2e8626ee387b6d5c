"""Puts hostile inputs into a worker process, one after the other, and collects the failures.

`python drill.py KIND FIRST LAST [KIND FIRST LAST ...]` is the worker: it prints a line of JSON before
and after each input, so that the input is known that ends it with a signal or makes it hang.
"""

from __future__ import annotations

import faulthandler
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import traceback
import warnings
from pathlib import Path
from random import Random

import numpy as np

SEED = os.environ.get("MESHTRACE_DRILL_SEED", "20240229")  # another one draws other inputs
HANG = 90.0  # [s] for one input; most kernels are compiled before
PATIENCE = 300.0  # [s] for a process of its own, which may find no cache of kernels
START = 400.0  # [s] to compile those
MEMORY = 6 * 2**30  # [B]
LONGEST = 1000  # letters of a refusal


def outcome(call):
    """Return "number", "refusal" or a description of a failure."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            value = call()
    except ValueError as error:
        text = str(error)
        if "allowed: " in text and text.isprintable() and len(text) < LONGEST:
            return "refusal"
        return "".join(traceback.format_exception(error)[-3:])
    except BaseException as error:
        return "".join(traceback.format_exception(error)[-3:])
    for number in () if value is None else value:
        if not np.isfinite(np.asarray(number, dtype=float)).all():
            return f"not finite: {value}"
    return "number"


def work(plan):
    """Put in some inputs of each kind, and print a line before and after each."""
    import resource  # here: Windows lacks it, and needs the judge of outcomes alone

    from hostile import KINDS
    from hostile_parts import LINKS

    from meshtrace import parallel
    from meshtrace.surfaces import surface

    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

    def answer(**parts):
        answers.write(json.dumps(parts) + "\n")

    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    if {kind for kind, _, _ in plan} & {"links", "arguments", "commands", "meshes", "origins"}:
        for base in LINKS:
            warm(base)
    answer(outcome="ready")
    # larger meshes and works are allowed, and take minutes
    parallel.announce = surface.announce = refuse_long
    surface.MOST_VERTICES = 40_000
    with tempfile.TemporaryDirectory(prefix="drill-") as root:
        for kind, i in ((kind, i) for kind, first, last in plan for i in range(first, last)):
            folder = Path(root) / "input"
            folder.mkdir()
            text, call = KINDS[kind](Random(f"{SEED}/{kind}/{i}"), folder)
            answer(kind=kind, number=i, input=text)
            faulthandler.dump_traceback_later(0.9 * HANG)  # shows where an input hangs
            answer(kind=kind, number=i, outcome=outcome(call))
            faulthandler.cancel_dump_traceback_later()
            shutil.rmtree(folder, ignore_errors=True)


def refuse_long(seconds, work, least=HANG):
    """Refuse a work at the place where its expected time is announced."""
    from meshtrace.errors import Refused

    if seconds > 0.2 * min(least, HANG):
        raise Refused("time", seconds, f"less work than {work}")


def warm(base):
    """Compile the kernels that a link needs."""
    from hostile_parts import short

    from meshtrace.scenario import Scenario

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        short(Scenario.from_toml(base))


class _Worker:
    """One process, and the lines it prints."""

    def __init__(self, plan):
        command = [sys.executable, __file__, *(str(part) for row in plan for part in row)]
        self.errors = tempfile.TemporaryFile()
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=self.errors, stdin=subprocess.DEVNULL, text=True
        )
        self.lines = queue.Queue()
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.put(json.loads(line))
        self.lines.put(None)

    def answer(self, timeout):
        """Return the next line, None at the end; raise queue.Empty after a time."""
        return self.lines.get(timeout=timeout)

    def end(self):
        """End the process, and return its exit code and the end of what it wrote to stderr."""
        self.process.kill()
        code = self.process.wait()
        self.reader.join()
        self.process.stdout.close()
        with self.errors:
            self.errors.seek(0)
            return code, self.errors.read().decode(errors="replace")[-2000:]


def drill(plan):
    """Return how many inputs of each kind gave numbers and refusals, and (input, failure) of others.

    `plan` has rows (kind, first, last).
    """
    counts = {kind: {"number": 0, "refusal": 0} for kind, _, _ in plan}
    failures, done = [], 0
    order = [(kind, i) for kind, first, last in plan for i in range(first, last)]
    while done < len(order):
        rest = [(kind, max(first, order[done][1]) if kind == order[done][0] else first, last)
                for kind, first, last in plan if (kind, last - 1) in order[done:]]  # fmt: skip
        worker, text, timeout = _Worker(rest), "start", START
        try:
            while True:
                line = worker.answer(timeout)
                if line is None:
                    worker.process.wait(HANG)
                    break
                timeout = PATIENCE if line.get("kind") == "environment" else HANG
                if "input" in line:
                    text = line["input"]
                elif line["outcome"] != "ready":
                    found, kind = line["outcome"], line["kind"]
                    done += 1
                    if found in counts[kind]:
                        counts[kind][found] += 1
                    else:
                        failures.append((f"{kind} {line['number']}: {text}", found))
        except (queue.Empty, subprocess.TimeoutExpired):
            _, stderr = worker.end()
            at = "{} {}".format(*order[done])
            failures.append((f"{at}: {text}", f"no answer in {timeout:g} s: {stderr}"))
            done += 1
            continue
        code, stderr = worker.end()
        if done < len(order):  # it ended by itself before the last input
            at = "{} {}".format(*order[done])
            failures.append((f"{at}: {text}", f"ended with {code}: {stderr}"))
            if text == "start":
                break
            done += 1
    return counts, failures


if __name__ == "__main__":
    words = sys.argv[1:]
    work([(words[k], int(words[k + 1]), int(words[k + 2])) for k in range(0, len(words), 3)])
