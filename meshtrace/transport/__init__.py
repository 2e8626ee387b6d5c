"""Transport of light through water and surface: analog photons and forced detection."""
