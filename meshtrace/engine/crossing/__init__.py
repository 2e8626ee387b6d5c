"""The point of the surface that sends light from one point to another."""
