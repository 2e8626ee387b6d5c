"""Estimators of the gain: the share of the emitted power that arrives at an aperture.

The gain is an integral over histories of light, from the lamp by flights, collisions and crossings
of the surface to the aperture. Each room integrates it in its own way:

- `photons` draws histories and scores those that arrive, or at each event the expected arrival
  (Monte Carlo of radiative transfer: Lux and Koblinger 1991, see docs/algorithms.md).
- `chains` draws all of a history but its direction of emission, and solves for the directions that
  end at the receiver; the estimator is that of `forced`, with its equation.
- `backward` follows the light of sun and sky from the receiver.
- `setup` makes arrays of links, meshes and options, for all of them.

Read `simulate`, the way from a call to a result. By default it takes `forced`, for which `plan` and
`choice` decide which samples each receiver gets, and how many; `parts` and `gains` add up their
light, `outcome` makes the result of it, and warns. `crossing`, where light from point to point
passes the surface, and `bvh`, rays over a mesh, serve several rooms. Other files answer a question
each: `straight`, a lamp and a receiver in one medium; `cell_chains`, maps; `correlated`, several
wavelengths or links by common paths; `mesh_error`; and `paths`, for pictures.

Kernels (compiled functions) and the drivers that call them are files of one room, but apart: an
edit of any kernel compiles all of them anew. Kernels of several rooms are in `meshtrace.kernels`.
"""
