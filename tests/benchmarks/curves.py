"""Curves of cost: CPU seconds and peak memory against the size of a work, with exponents.

    python tests/benchmarks/curves.py [NAME...]

Each point runs in a separate process, after the smallest work of its curve, which compiles and loads.
The exponent is the slope of ln (CPU seconds) over ln (size) between neighbouring points; memory is that
of the process at its peak. `python tests/benchmarks/curves.py --list` prints the names.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

from clocks import peak_mib
from rows import cpu, in_child


def _forced(chains: int) -> Callable[[], Any]:
    import meshtrace as mt
    from meshtrace.surfaces import FlatSea

    return lambda: mt.simulate(mt.Link(), FlatSea(), photons=chains, threads=1)


def _analog(photons: int) -> Callable[[], Any]:
    import meshtrace as mt
    from meshtrace.surfaces import FlatSea

    options: dict[str, Any] = {"estimator": "analog", "photons": photons, "threads": 1}
    return lambda: mt.simulate(mt.Link(), FlatSea(), **options)


def _meshed(facets: int, estimator: str, photons: int) -> Callable[[], Any]:
    import meshtrace as mt
    from meshtrace.surfaces import JonswapSea

    sea, extent = JonswapSea(wind_speed=5.0, seed=7), 20.0
    spacing = 2.0 * extent / math.sqrt(facets / 2.0)
    mesh = sea.mesh(extent=extent, spacing=spacing)
    options: dict[str, Any] = {"estimator": estimator, "photons": photons, "threads": 1}
    return lambda: mt.simulate(mt.Link(), mesh, **options)


def _facets(n: int) -> Callable[[], Any]:
    return _meshed(n, "forced", 1024)


def _analog_facets(n: int) -> Callable[[], Any]:
    return _meshed(n, "analog", 200_000)


def _waves(n: int) -> Callable[[], Any]:
    import numpy as np
    from test_waves_benchmark import waves_of

    from meshtrace.surfaces.waves import WaveGrid, elevation_and_slopes

    waves, x = waves_of(n, 4.0), np.linspace(-20.0, 20.0, 257)
    return lambda: WaveGrid(waves.kx, waves.ky, x, x).sum(elevation_and_slopes(waves, 1.0))


def _receivers(n: int) -> Callable[[], Any]:
    import meshtrace as mt
    from meshtrace.surfaces import JonswapSea

    places = [(-3.0 + 6.0 * i / n, 3.0 * math.sin(2.4 * i)) for i in range(n)]
    link = mt.Link(receiver=tuple(mt.Receiver(position=place) for place in places))
    sea = JonswapSea(wind_speed=5.0, seed=7)
    return lambda: mt.simulate(link, sea, photons=1024, threads=1)


def _seas(n: int) -> Callable[[], Any]:
    import meshtrace as mt
    from meshtrace.surfaces import JonswapSea

    sea = JonswapSea(wind_speed=5.0, seed=7)
    return lambda: mt.ensemble(mt.Link(), n, sea, photons=608, threads=1)


def _frames(n: int) -> Callable[[], Any]:
    import numpy as np

    import meshtrace as mt
    from meshtrace.surfaces import JonswapSea

    sea, times = JonswapSea(wind_speed=5.0, seed=7), 0.02 * np.arange(n)
    return lambda: mt.time_series(mt.Link(), sea, times, photons=608, threads=1)


CURVES: dict[str, tuple[Callable[[int], Callable[[], Any]], Sequence[int], str]] = {
    "chains": (_forced, [10**k for k in range(3, 7)], "chains of forced detection, still water"),
    "photons": (_analog, [10**k for k in range(4, 8)], "analog photons, still water"),
    "facets": (_facets, [10**k for k in range(3, 8)], "facets, 1,024 chains"),
    "analog-facets": (_analog_facets, [10**k for k in range(3, 8)], "facets, 200,000 photons"),
    "waves": (_waves, [60, 600, 6_000, 100_000], "waves on 257 x 257 points"),
    "receivers": (_receivers, [1, 4, 16, 64, 256, 1024, 4096], "receivers of a list, 1,024 chains"),
    "seas": (_seas, [4, 16, 64, 256], "seas of an ensemble, 608 chains"),
    "frames": (_frames, [4, 16, 64, 256, 1024], "frames of a series, 608 chains"),
}


def main(names: Sequence[str]) -> None:
    """Print the curves, a line for each point as it is measured."""
    for name in names:
        _, sizes, title = CURVES[name]
        print(title, flush=True)
        before: tuple[int, float] | None = None
        for n in sizes:
            seconds, mib = in_child(__file__, "--point", name, n)
            slope = "-"
            if before is not None:
                slope = f"{math.log(seconds / before[1]) / math.log(n / before[0]):.2f}"
            print(f"    {n:>11,}  {seconds:9.4f} CPU s  {slope:>5}  {mib:6.0f} MiB", flush=True)
            before = n, seconds


if __name__ == "__main__":
    arguments = sys.argv[1:]
    if arguments[:1] == ["--point"]:
        make, sizes, _ = CURVES[arguments[1]]
        make(sizes[0])()
        print(json.dumps([cpu(make(int(arguments[2]))), peak_mib()]))
    elif arguments == ["--list"]:
        print(" ".join(CURVES))
    else:
        main(arguments or list(CURVES))
