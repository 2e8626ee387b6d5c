"""Links and meshes as arrays for the kernels, and the options of a run."""
