"""Gain through a user-defined surface: a ring wave, as arrays and as a mesh file."""

import tempfile
from pathlib import Path

import numpy as np

import meshtrace as mt
from meshtrace.surfaces import from_trimesh

axis = np.linspace(-60.0, 60.0, 601)
x, y = np.meshgrid(axis, axis, indexing="ij")
distance = np.hypot(x, y)
z = 0.05 * np.cos(2.0 * np.pi * distance / 5.0) * np.exp(-distance / 20.0)

link = mt.Link()
mesh = from_trimesh((axis, axis, z))
result = mt.simulate(link, mesh, seed=1)
print(f"from arrays: gain {result.gain:.3e} +- {result.gain_stderr:.1e}")

with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "ring_wave.ply"
    mesh.to_trimesh().export(file)
    again = mt.simulate(link, from_trimesh(file), seed=1)
print(f"from a file: gain {again.gain:.3e} +- {again.gain_stderr:.1e}")
