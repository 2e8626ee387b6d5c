"""Hostile files of the program itself: results, stores of sweeps, study files."""

from __future__ import annotations

import json
import warnings
from functools import cache

import numpy as np
from hostile_foreign_files import twist
from hostile_parts import LINKS, VALUES, Wrong, damage, invoke, replace


@cache
def _results(folder):
    import meshtrace as mt
    from meshtrace.surfaces import FlatSea, JonswapSea

    folder.mkdir(exist_ok=True)
    link, sea = mt.Link(), JonswapSea(wind_speed=5.0, seed=7, waves="paper")
    one = mt.simulate(link, FlatSea(), photons=32, threads=1)
    series = mt.time_series(link, sea, [0.0, 1.0], photons=32, threads=1)
    made = {}
    for kind, result in ((mt.GainResult, one), (mt.GainSeries, series)):
        path = folder / f"{kind.__name__}.nc"
        result.save(path)
        made[kind] = path.read_bytes(), np.asarray(result.gain)
    return made


def results(random, folder):
    """Damaged result files; one that loads must hold the gains that were saved."""
    made = _results(folder.parent / "results")
    kind = random.choice(list(made))
    content, gain = made[kind]
    content, how = damage(random, content)
    path = folder / "result.nc"
    path.write_bytes(content)

    def call():
        loaded = np.asarray(kind.load(path).gain)
        if not np.array_equal(loaded, gain):
            raise Wrong(f"silently changed: {loaded} for {gain}")

    return f"{kind.__name__}: {how}", call


@cache
def _datasets():
    """Return results of several kinds as datasets."""
    import meshtrace as mt
    from meshtrace.scenario import Scenario

    warnings.simplefilter("ignore")  # few samples
    link, day = Scenario.from_toml(LINKS[0]), mt.Daylight(direct=1.4, diffuse=0.3)
    series = mt.ensemble(link, 3, photons=64, threads=1)
    made = [
        mt.simulate(link, photons=64, threads=1),
        series,
        series.fading(),
        mt.coverage_map(link, extent=1.0, step=0.5, photons=64, threads=1),
        mt.compare({"a": link, "b": link}, realizations=2, photons=64),
        mt.link_performance(link, bit_rate=5e6, realizations=2, photons=64),
        mt.background(link, daylight=day, photons=64),
    ]
    return [result.to_dataset() for result in made]


def origins(random, folder):
    """Results whose provenance has values of other types or amounts, read and viewed."""
    from meshtrace.stored import load, write_dataset

    data = random.choice(_datasets()).copy()
    provenance = json.loads(data.attrs["provenance"])
    how = replace(random, provenance, VALUES)
    data.attrs["provenance"] = json.dumps(provenance)
    write_dataset(data, folder / "result.nc")

    def call():
        invoke(["view", "result.nc", "--html", "a.html", "--paths", "0", "--spacing", "2"], folder)
        found = load(folder / "result.nc")
        found.summary()
        found._repr_html_()

    return f"{data.attrs['kind']}: {how}", call


def forged(random, folder):
    """Results with other values and dimensions, written with their digests: read and shown."""
    from meshtrace.stored import load, write_dataset

    data = random.choice(_datasets()).copy()
    if random.random() < 0.5:
        data, how = twist(random, data)
    else:
        key = random.choice(list(data.attrs))
        value = random.choice([*VALUES, "{}", "[1, 2]", np.arange(3.0), np.array(["a", "b"])])
        data, how = data.assign_attrs({key: value}), f"{key} = {value!r:.60}"
    path = folder / "result.nc"
    try:
        write_dataset(data, path)
    except Exception:  # values that no file holds
        path = folder / "none.nc"

    def call():
        found = load(path)
        found.summary()
        found._repr_html_()
        found.save(folder / "again.nc")

    return f"{data.attrs.get('kind')!r:.30}: {how}", call


SWEEP = {"parameters": {"transmitter.depth": [5.0, 10.0], "wind_speed": [5.0, 9.0]}}


def swept(path, gain):
    """Open a store, filled with a gain where it waits for one, and return its gains."""
    from meshtrace.studies import sweeps as module

    original = module.Cluster.map

    def fill(self, setup, tasks):
        for i in range(len(tasks)):
            yield i, (np.full((1, 4), gain), '[""]')

    module.Cluster.map = fill
    try:
        link = {"bubbles": "none"}
        return module.sweep(link, **SWEEP, store=path, photons=32, rtol=None)
    finally:
        module.Cluster.map = original


@cache
def _store(path):
    swept(path, 3e-5)
    return path.read_bytes()


def stores(random, folder):
    """Damaged stores of sweeps; gains that are read must be those that were written."""
    content, how = damage(random, _store(folder.parent / "kept.store"))
    store = folder / "kept.store"
    store.write_bytes(content)

    def call():
        gain = np.asarray(swept(store, 3e-5)["gain"])
        if not np.array_equal(gain, np.full((2, 2, 1), 3e-5)):
            raise Wrong(f"silently changed: {gain.ravel()}")

    return how, call


def forged_stores(random, folder):
    """Lines of right digests and other values in stores of sweeps."""
    from meshtrace.studies.store import _line

    store, changes = folder / "kept.store", []
    lines = []
    for line in _store(folder.parent / "kept.store").splitlines():
        content = json.loads(line.partition(b" ")[2])
        if random.random() < 0.3:
            if random.random() < 0.2:
                key = random.choice(list(content))
                changes.append(f"without {key}")
                del content[key]
            elif random.random() < 0.1:
                content = {"list": [content]}
            else:
                changes += replace(
                    random, content, [*VALUES, [1, 4], [2, 2], "AAAA", "AAAAAAAAAAA="]
                )
        try:
            lines.append(_line(content))
        except (ValueError, TypeError, RecursionError):  # no JSON holds it
            lines.append(line + b"\n")
    store.write_bytes(b"".join(lines))
    return str(changes), lambda: np.asarray(swept(store, 3e-5)["gain"]).ravel() * 0.0


def studies(random, folder):
    """Study files with values replaced, or letters."""
    import tomli_w

    from meshtrace.studies import sweeps as module

    table = {"realizations": 2, "photons": 32, "seed": 1, "rtol": 0.1, **SWEEP}
    config = {"wind_speed": 5.0, "transmitter": {"depth": 5.0}, "sweep": table}
    config = json.loads(json.dumps(config))
    if random.random() < 0.5:
        how = replace(random, config, [v for v in VALUES if v is not None])
        text = tomli_w.dumps(config)
    else:
        content, how = damage(random, tomli_w.dumps(config).encode(), text=True)
        text = content.decode(errors="replace")
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8", newline="")

    def call():
        original, module.Cluster.map = module.Cluster.map, lambda *rest: (one for one in ())
        try:
            module.read_study(path)[0].run(None)
        finally:
            module.Cluster.map = original

    return str(how), call
