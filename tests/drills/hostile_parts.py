"""What hostile inputs are made of: values, links, damage to files; and the judge of commands."""

from __future__ import annotations

import contextlib
import math

import numpy as np

NUMBERS = [math.nan, math.inf, -math.inf, -1, 0, -0.0, 1, 2.5, 90.0, 180.0, 1e-300, 1e-30, 1e-9,
           1e6, 1e30, 1e77, 1e300, 2**31, 2**63, -(2**63) - 1, 10**400]  # fmt: skip
WORDS = ["", "nan", "none", "flat", "paper", "forced", "\x00", "\x1b[2J", "é", "../..", "a" * 5000]
VALUES = [*NUMBERS, *NUMBERS, *WORDS, True, None, [], {}, [[]], [1, 2, 3, 4], {"kind": "x"}]
ARRAYS = [np.array([]), np.full(3, np.nan), np.float32(3.0), np.array("x")]
LINKS = [
    "wind_speed = 5.0\n[sea]\nspacing = 0.5",
    "wind_speed = 13.0\nphysics = 'paper'\n[sea]\nomega_max = 6.0\nspacing = 0.5",
    "whitecaps = { wind_speed = 3.0 }\n[sea]\nspectrum = 'tma'\ndepth = 9.0\nspacing = 0.5\n"
    "[[receiver]]\n[[receiver]]\nkind = 'water-aperture'\n[run]\nestimator = 'analog'",
    "[sea]\nspectrum = 'flat'\nspacing = 0.5\n[water]\nlayers = [[0.0, 0.1, 0.2], [9.0, 0.2, 0.1]]\n"
    "[water.phase]\nmodel = 'mixture'\ncomponents = ['petzold', 'rayleigh']\nweights = [1.0, 2.0]",
    "[sea]\nspectrum = 'sinusoid'\namplitude = 0.1\nwavelength = 2.0\nspacing = 0.5\n"
    "[transmitter]\nkind = 'sun'\n[run]\nestimator = 'analog'",
    "[sea]\nspacing = 0.5\n[transmitter]\nkind = 'air-led'\n[receiver]\nkind = 'water-receiver'\n"
    "[daylight]\nmodel = 'clear'\nsun_zenith_deg = 40.0",
]


def places(table, path=()):
    """Yield the path of every value, tables and lists included."""
    items = table.items() if isinstance(table, dict) else enumerate(table)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def replace(random, config, values):
    """Replace one or two values of nested plain data, and return what was done."""
    done = []
    for _ in range(random.choice([1, 1, 2])):
        *parents, last = random.choice(list(places(config)))
        table = config
        for key in parents:
            table = table[key]
        new = random.choice(values)
        old = table[last]
        if isinstance(old, float) and random.random() < 0.6:
            new = old * random.choice([-1.0, 1e-9, 1e-3, 0.3, 3.0, 1e3, 1e9])
        table[last] = new
        done.append(f"{'.'.join(map(str, (*parents, last)))} = {new!r:.80}")
    return done


def damage(random, content, text=False):
    """Return bytes that are cut, emptied, overwritten or flipped, and what was done."""
    how = random.choice(["flip", "flip", "flip", "cut", "empty", "zeros", "twice", "noise"])
    start = random.randrange(max(1, len(content)))
    length = random.choice([1, 4, 64, 4096])
    if how == "flip":
        bit = 1 << random.randrange(7 if text else 8)
        spoilt = content[:start] + bytes([content[start] ^ bit]) + content[start + 1 :]
    elif how == "cut":
        spoilt = content[:start]
    elif how == "empty":
        spoilt = b""
    elif how == "twice":
        spoilt = content[: start + length] + content[start:]
    else:
        patch = bytes(length) if how == "zeros" else random.randbytes(length)
        spoilt = content[:start] + patch + content[start + length :]
    return spoilt, f"{how} at {start} ({length})"


def short(scenario):
    """Simulate with few photons on one thread; a Mie table of its own would take minutes."""
    from meshtrace.optics import HallNovarini
    from meshtrace.scenario import Run

    few: dict = {"photons": 32}
    if scenario.run.estimator.kind == "analog":
        few = {"photons": 64, "max_events": 1000}
    run = Run(**{**scenario.run.to_config(), "rtol": None, "threads": 1, **few})
    bubbles, plain = scenario.link.bubbles, HallNovarini(wind_speed=5.0)
    table = ("n_water", "wavelength_nm", "r_min", "r_max")
    if bubbles and any(getattr(bubbles, key) != getattr(plain, key) for key in table):
        bubbles = None
    link = scenario.link.model_copy(update={"bubbles": bubbles})
    result = scenario.model_copy(update={"link": link, "run": run}).simulate()
    return result.gain, result.gain_stderr


def invoke(line, folder):
    """Run a command line in this process; return its numbers or raise what it printed."""
    from typer.testing import CliRunner

    from meshtrace import cli

    with contextlib.chdir(folder):
        done = CliRunner().invoke(cli.app, line)
    return judged(done.exit_code, done.stdout, done.stderr, done.exception)


class Wrong(Exception):
    """A failure of a command that is no refusal."""


class Line(ValueError):
    """The only line of a refused command."""


def judged(code, stdout, stderr, error=None):
    """Return nothing for a command that succeeded; raise its refusal, or what is wrong with it."""
    if error is not None and not isinstance(error, SystemExit):
        raise error
    if code < 0 or code not in (0, 2) or "Traceback" in stderr:
        raise Wrong(f"exit code {code}: {stderr[-300:]}")
    lines = [line for line in stderr.splitlines() if not line.startswith(("warning", "compiling"))]
    if code == 2:
        if len(lines) != 1 or stdout or not lines[0].startswith("error: "):
            raise Wrong(f"not one line: {stdout[:100]!r} {stderr[-300:]!r}")
        raise Line(f"{lines[0][:900]} (allowed: )")
    shown = stdout.partition("\nwritten to ")[0]  # a file may be called nan
    if any(word.strip("[],()") in ("nan", "+-nan") for word in shown.split()):
        raise Wrong(f"nan in {stdout[:300]!r}")
