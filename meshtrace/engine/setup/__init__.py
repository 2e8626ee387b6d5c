"""Links, meshes and options as the tracers take them: checked, and as arrays for the kernels.

`options` has the options of a run and the `Case` that they make with link and surface; `meshing`
decides how far and how finely the sea is meshed. `arrays` converts water, receivers and mesh to the
NamedTuples of `meshtrace.kernels`, in a local `Frame` whose lengths suit the single precision of
Embree; `bodies` adds solids. `ends` does the same for estimators that aim light at a receiver, and
refuses links that they cannot follow. `tinting` lets several wavelengths share one path: the
logarithm of its weight changes by sums over the path,

    ln(w_j / w) = sum_k ln(b_j p_j / b p) - int (c_j - c) dl

(`kernels.tints`). Read `arrays` first: what it returns is what every kernel reads. Then `options`
and `meshing`, which all estimators take, and `ends`, for those that aim.

Models are checked here once, so that kernels check nothing; a file holds what changes for one
reason: another source or aperture, another way to mesh, another option.
"""
