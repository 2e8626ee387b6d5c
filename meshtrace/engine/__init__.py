"""The ways to follow light through water and surface, each with its kernels beside its driver."""
