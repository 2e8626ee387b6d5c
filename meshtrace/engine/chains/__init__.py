"""Unscattered light, and scattering chains that are turned to end at the receiver.

A chain is the history of a photon but for its direction of emission w, which is solved for: the
light has to land on a point X of the aperture, of area A. Its contribution to the gain is
A I(w) W dOmega/dX, I the intensity of the source and W scattering and transmission over the density
of the chain: next-event estimation through a refracting surface (Hanika, Droske and Fascione 2015,
doi:10.1111/cgf.12681) for whole histories.

Read `sampling` (chains from uniform numbers), `sets` (which orders, and their Sobol points), `gain`
(crossings and weights over one surface, by `engine.crossing`) and `aimed`, which drives all kernels
of one surface. Unscattered light needs no samples: `unscattered` has the images of smooth facets,
`microfacets`, `pencils` and `random_slopes` have the spots of facets with random slopes (Walter and
others 2007, doi:10.2312/EGWR/EGSR07/195-206), `cells` and `maps` both for the cells of a map.
`wave_sum` is the limit of ever finer meshes, from which the error of a mesh follows.

Each way in which a surface sends light on is a file of kernels; `sets`, `aimed` and `maps`, which
draw and call, are plain Python.
"""
