"""Background light: rays and photons from the receiver back to the sky and the sun.

Radiance over the squared index is constant along a ray but for losses (Mobley 1994, *Light and
Water*), so that light may be followed from the small receiver to the wide sky: the power collected
is

    P = A int L cos(theta) dOmega = pi A sin^2(psi) <L>

with <L> the mean over directions drawn by the cosine law inside the field of view, psi half of it.
The sun is too small to be met by chance, and is connected at each reflection, crossing or
collision.

Read `background` (the parts of the light, and the public function), `view` (rays of a receiver, and
facets that bend the sun to it) and `walk` (photons that scatter in the water). The laws of glint
and of light out of the water are those of `meshtrace.daylight.upward`.

Rays and photons are apart: rays end at the water and meet the sun by a closed form, photons scatter
in the water and are those of `engine.photons`, run backwards. The room has no kernels of its own.
"""
