"""Surfaces, a spectrum and a spreading as a user would write them, in a module of their own."""

import numpy as np

from meshtrace.surfaces import Spectrum, Spreading, Surface


class RingWave(Surface):
    height: float = 0.05
    wavelength: float = 5.0

    def elevation(self, x, y, time=0.0):
        k = 2.0 * np.pi / self.wavelength
        return self.height * np.cos(k * np.sqrt(1.0 + np.square(x) + np.square(y)) - time)

    def slopes(self, x, y, time=0.0):
        k, r = 2.0 * np.pi / self.wavelength, np.sqrt(1.0 + np.square(x) + np.square(y))
        radial = -self.height * k * np.sin(k * r - time) / r
        return radial * x, radial * y


class Box(Spectrum):
    variance: float = 0.01

    @property
    def omega_p(self):
        return 1.5

    def __call__(self, omega):
        inside = np.abs(np.asarray(omega, dtype=float) - self.omega_p) <= 0.5
        return np.where(inside, self.variance, 0.0)


class Isotropic(Spreading):
    def density(self, omega, theta, *, omega_p, wind_speed):
        return np.ones(np.broadcast_shapes(np.shape(omega), np.shape(theta))) / (2.0 * np.pi)
