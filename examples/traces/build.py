"""Build the data set W2A-Traces 1.0: channels of a link from the water into the air over time.

python build.py FOLDER [--seconds 3600] [--rate 50] [--workers N] [--only 5m-s_10m]
python build.py --check sample

Each case is a file `{wind}m-s_{depth}m.nc`, and its background by day `{wind}m-s_day.nc`, besides
`SHA256SUMS`. A stopped run goes on where it stopped. `--check` computes the first 20 frames of
each file in a folder again and compares them.
"""

from __future__ import annotations

import argparse
import hashlib
from itertools import product
from pathlib import Path

import numpy as np

import meshtrace as mt

WINDS, DEPTHS = (4.0, 6.0, 8.0, 10.0, 13.0), (5.0, 10.0, 20.0, 40.0)  # m/s, m
RADII, VIEWS = (0.025, 0.05, 0.1), (20.0, 60.0)  # m, deg
SUN_ZENITH = 30.0  # deg
CHAINS, SEED = 1024, 1


def link_of(depth: float) -> mt.Link:
    """Return the link of the paper with six receivers: radii in turn, then fields of view."""
    receivers = tuple(
        mt.Receiver(radius=radius, fov_deg=view) for view, radius in product(VIEWS, RADII)
    )
    return mt.Link(receiver=receivers).at_depth(depth)


def trace_of(wind: float, depth: float, seconds: float, rate: float, **run) -> mt.ChannelTrace:
    """Return the trace of a case."""
    sea = mt.surfaces.sea_in_wind(wind).with_seed(SEED)
    options = {"hours": seconds / 3600.0, "rate": rate, "photons": CHAINS, "seed": SEED, **run}
    return mt.channel_trace(link_of(depth), sea, **options)


def background_of(wind: float, seconds: float, **run) -> mt.ChannelTrace:
    """Return a trace with the background of the receiver of the paper, two times per second."""
    sea = mt.surfaces.sea_in_wind(wind).with_seed(SEED)
    day = mt.Daylight.clear_sky(SUN_ZENITH)
    options = {"hours": seconds / 3600.0, "rate": 2.0, "background_rate": 2.0, "seed": SEED, **run}
    return mt.channel_trace(mt.Link(), sea, photons=256, daylight=day, down=None, **options)


def build(folder: Path, seconds: float, rate: float, only: str | None, workers: int | None) -> None:
    """Write the files of the data set."""
    folder.mkdir(parents=True, exist_ok=True)
    for wind, depth in product(WINDS, (*DEPTHS, None)):
        name = f"{wind:g}m-s_{'day' if depth is None else f'{depth:g}m'}"
        path, store = folder / f"{name}.nc", folder / f"{name}.store"
        if path.exists() or only not in (None, name):
            continue
        run = {"store": store, "workers": workers}
        found = (
            background_of(wind, seconds, **run)
            if depth is None
            else trace_of(wind, depth, seconds, rate, **run)
        )
        found.save(path)
        store.unlink()
        print(
            f"{name}: {len(found.time):,} frames, mean gain {found.gain.mean(axis=0)}", flush=True
        )
    sums = (f"{hashlib.sha256(p.read_bytes()).hexdigest()}  {p.name}" for p in files(folder))
    (folder / "SHA256SUMS").write_text("".join(f"{line}\n" for line in sums))


def check(folder: Path) -> None:
    """Compare the check sums of a folder, and the first frames with newly computed ones."""
    sums = dict(reversed(line.split()) for line in (folder / "SHA256SUMS").read_text().splitlines())
    for path in files(folder):
        assert hashlib.sha256(path.read_bytes()).hexdigest() == sums[path.name], path
        kept = mt.ChannelTrace.load(path)
        frames = min(20, len(kept.time))
        wind, of = path.stem.split("m-s_")
        if of == "day":
            again = background_of(float(wind), frames / kept.rate)
        else:
            again = trace_of(float(wind), float(of[:-1]), frames / kept.rate, kept.rate)
        np.testing.assert_allclose(again.gain, kept.gain[:frames], rtol=1e-6)
        print(f"{path.name}: {frames} frames agree")


def files(folder: Path) -> list[Path]:
    """Return the files of a data set."""
    return sorted(folder.glob("*.nc"))


def main() -> None:
    """Build or check the data set."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--only")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--check", action="store_true")
    given = parser.parse_args()
    if given.check:
        check(given.folder)
    else:
        build(given.folder, given.seconds, given.rate, given.only, given.workers)


if __name__ == "__main__":
    main()
