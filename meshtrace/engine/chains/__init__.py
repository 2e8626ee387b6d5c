"""Unscattered light, and scattering chains rotated to end at the receiver."""
