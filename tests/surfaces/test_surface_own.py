"""A user's own surface, spectrum and spreading: used, written, read back, refused."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Literal

import numpy as np
import own_waves
import pytest
from own_waves import Box, Isotropic, RingWave

import meshtrace as mt
from meshtrace import SurfaceModel
from meshtrace.errors import Refused
from meshtrace.results import GainResult
from meshtrace.scenario import Scenario
from meshtrace.surfaces import (
    Band,
    FlatSea,
    JonswapSea,
    SpectralSea,
    Spreading,
    Surface,
    sea_from_config,
)
from meshtrace.surfaces.statistics import components_hs

OWN_SEA = SpectralSea(spectrum=Box(wind_speed=7.0), spreading=Isotropic())
OWN_BAND = Band(omega_min=1.01, omega_max=1.99, d_omega=0.09, d_theta=0.1)


@pytest.mark.parametrize("sea", [RingWave(height=0.1), OWN_SEA])
def test_own_surface_has_graded_meshes_with_exact_normals(sea):
    assert isinstance(sea, SurfaceModel)
    mesh = sea.mesh(time=0.3, extent=4.0, spacing=0.5, fine_extent=1.0)
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(z, sea.elevation(x, y, 0.3), atol=1e-6)
    sx, sy = sea.slopes(x, y, 0.3)
    np.testing.assert_allclose(
        -mesh.vertex_normals[:, 0] / mesh.vertex_normals[:, 2], sx, atol=1e-7
    )
    np.testing.assert_allclose(
        -mesh.vertex_normals[:, 1] / mesh.vertex_normals[:, 2], sy, atol=1e-7
    )
    assert np.ptp(np.diff(np.unique(x))) > 0.1
    assert sea.unresolved_slopes(0.5) is None or sea is OWN_SEA


def test_own_spectrum_sets_the_height_of_the_sea():
    sea = SpectralSea(spectrum=Box(), waves=OWN_BAND, capillary=False)
    assert components_hs(sea.components) ** 2 / 16.0 == pytest.approx(0.98 * 0.01)


def test_own_spreading_has_waves_in_all_directions():
    waves = OWN_SEA.components
    power = waves.amplitude**2
    assert abs(np.sum(power * waves.kx)) < 1e-3 * np.sum(power * np.hypot(waves.kx, waves.ky))
    heading = np.arctan2(waves.ky, waves.kx)
    assert np.ptp(heading[power > 0.0]) > 1.5 * np.pi


@pytest.mark.parametrize("sea", [RingWave(height=0.1), OWN_SEA])
def test_own_models_survive_plain_data_and_pickles(sea):
    plain = json.loads(json.dumps(sea.to_config()))
    for loaded in (sea_from_config(plain), pickle.loads(pickle.dumps(sea))):
        assert loaded == sea
        assert type(loaded) is type(sea)
    assert sea_from_config({"kind": "own_waves:RingWave", "height": 0.1}) == RingWave(height=0.1)
    named = SpectralSea(spectrum="own_waves:Box", spreading={"kind": "own_waves:Isotropic"})
    assert (named.spectrum, named.spreading) == (Box(), Isotropic())


@pytest.mark.parametrize("sea", [RingWave(height=0.1), OWN_SEA])
@pytest.mark.thorough
@pytest.mark.slow_but("sea0")
def test_a_fresh_process_reads_own_models_from_a_result(sea, tmp_path):
    mt.simulate(mt.Link(), sea, photons=64, seed=1, extent=4.0, spacing=0.5).save(tmp_path / "r.nc")
    code = (
        "import sys\n"
        "from meshtrace.results.gain import GainResult\n"
        "from meshtrace.scenario import Scenario\n"
        "result = GainResult.load(sys.argv[1])\n"
        "assert 'own_waves' not in sys.modules\n"
        "try:\n"
        "    Scenario.from_provenance(result.provenance)\n"
        "except ValueError as error:\n"
        "    assert 'own_waves.py' in str(error), error\n"
        "assert 'own_waves' not in sys.modules\n"
        "import own_waves\n"
        "print(Scenario.from_provenance(result.provenance).surface == eval(sys.argv[2]))\n"
    )
    expression = f"__import__('pickle').loads({pickle.dumps(sea)!r})"
    env = {**os.environ, "PYTHONPATH": str(Path(own_waves.__file__).parent)}
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "r.nc"), expression],
        env=env, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.stdout == "True\n", run.stderr
    assert GainResult.load(tmp_path / "r.nc").provenance["surface"] == sea.to_config()


@pytest.mark.parametrize(
    ("table", "surface"),
    [
        ('[sea]\nspectrum = "own_waves:RingWave"\nheight = 0.1', RingWave(height=0.1)),
        (
            '[sea]\nspectrum = "own_waves:Box"\nvariance = 0.02\nspreading = "own_waves:Isotropic"',
            SpectralSea(spectrum=Box(wind_speed=6.0, variance=0.02), spreading=Isotropic()),
        ),
    ],
)
def test_link_files_take_import_paths(table, surface):
    scenario = Scenario.from_toml(f"wind_speed = 6.0\n{table}\n")
    assert scenario.surface == surface
    assert Scenario.from_toml(scenario.to_toml()).surface == surface


@pytest.mark.parametrize(
    "path", ["own_waves:Nothing", "no_such_module:Sea", "own_waves:Box", "json:dumps", ":", "a:"]
)
def test_wrong_import_paths_are_refused_in_one_line(path):
    with pytest.raises(
        Refused, match=r"^kind: .* allowed: flat, .*jonswap, .*module:Surface"
    ) as info:
        sea_from_config({"kind": path})
    assert "\n" not in str(info.value)
    with pytest.raises(ValueError, match=r"sea\.spectrum"):
        Scenario.from_toml(f'[sea]\nspectrum = "{path}x"')


def test_values_of_own_models_are_checked():
    with pytest.raises(Refused, match="height"):
        sea_from_config({"kind": "own_waves:RingWave", "height": "tall"})
    with pytest.raises(Refused, match="depth"):
        sea_from_config({"kind": "own_waves:RingWave", "depth": 1.0})


def test_own_kinds_are_names_of_their_own():
    class Basin(Surface):
        kind: Literal["basin"] = "basin"

        def elevation(self, x, y, time=0.0):
            return np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))

        def slopes(self, x, y, time=0.0):
            return self.elevation(x, y), self.elevation(x, y)

    try:
        assert sea_from_config({"kind": "basin"}) == Basin()
        with pytest.raises(Refused, match=r"Impostor\.kind: 'basin'"):
            type("Impostor", (Basin.__base__,), {**_methods(Basin), **_kind("basin")})
    finally:
        del Surface.registered["basin"]


def _methods(cls):
    return {name: cls.__dict__[name] for name in ("elevation", "slopes")}


def _kind(kind):
    return {"__annotations__": {"kind": Literal[kind]}, "kind": kind, "__module__": __name__}


def test_subclass_of_a_sea_does_not_take_its_kind():
    class Calmer(JonswapSea):
        gamma: float = 1.0

    path = f"{__name__}:test_subclass_of_a_sea_does_not_take_its_kind.<locals>.Calmer"
    try:
        assert Calmer().kind == path
        assert type(sea_from_config(Calmer().to_config())) is Calmer
        assert type(sea_from_config({"kind": "jonswap"})) is JonswapSea
    finally:
        del Surface.registered[path]


def test_families_are_apart_and_bases_are_no_members():
    assert "flat" in Surface.registered
    assert "flat" not in Spreading.registered
    assert all("Surface" not in name for name in Surface.registered)
    assert FlatSea().kind == "flat"
