"""Convergence of a gain with the mesh, the time step or the band of waves.

A study repeats one gain with a finer and finer discretisation and common random numbers: the
same scattering chains are aimed over every surface, so that differences of 1e-4 show under a
Monte Carlo error of 1e-3. To the gains g at steps h it fits

    g(h) = g_0 + C h^p

for the order p and the value g_0 at vanishing step (Richardson), and beside it stands the gain
over the exact sum of waves, with the same chains.
"""
