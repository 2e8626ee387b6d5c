"""Background light: photons followed from the receiver to the sky and the sun."""
