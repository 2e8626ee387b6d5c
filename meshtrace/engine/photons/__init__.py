"""Photons followed one by one: analog, or joined to the receivers at every event.

Both draw free paths from the attenuation, directions from the phase function, and what the surface
does from Fresnel's law; absorption and the bottom reduce the weight. An analog photon scores where
it hits an aperture. A joined one scores at each collision and crossing the expected value of what
it would bring, W exp(-tau) p A cos / r^2 in one medium: next-event estimation (Lux and
Koblinger 1991, *Monte Carlo Particle Transport Methods*), through the surface by the crossing and
the slope that lead to the aperture.

Read `state` (the record of a photon), `flight` (its steps, shared by both) and `analog` (chunks of
photons and their sums). Joined photons: `targets` (the ends that they are joined to), `joined_walk`
(steps and weight window), `next_event` (connections through the surface), `in_medium` (those
without), and `joined`, their driver. `arriving` runs analog photons for forced detection.

What a photon does and what it scores are files of their own: joined photons, and those that run
backwards, take steps of analog ones. `analog`, `joined` and `arriving` are plain Python, the others
kernels.
"""
