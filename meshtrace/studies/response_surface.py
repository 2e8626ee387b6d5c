"""Response surface of a quantity over inputs, fitted to noisy runs, with its own error."""

from __future__ import annotations

import warnings

import numpy as np

from meshtrace.errors import extra
from meshtrace.models import Floats

# correlation lengths over the range of an axis. Physics is smooth over it: shorter ones follow the
# noise of few runs, and a surface that needs them shows in its residuals
_LENGTHS = 0.5, 20.0
_RESTARTS = 4  # of the search for the correlation lengths, whose likelihood has several maxima


class ResponseSurface:
    """Gaussian process through runs with noise of unknown size (kriging with a nugget).

    Parameters
    ----------
    places : ndarray, shape (n, axes)
        Inputs of the runs, 0 ... 1 along each axis.
    values : ndarray, shape (n,)
        Their results; equal ones are taken for exact.
    noise : ndarray, shape (n,), or float
        Standard error of each result as far as it is known; w is added to it.

    Attributes
    ----------
    residuals : ndarray, shape (n,)
        Each run minus the surface through all others, its own noise included.

    Notes
    -----
    The covariance is u^2 (x . x' + v^2)^2 + s^2 exp(-sum_k (x_k - x'_k)^2 / (2 l_k^2)) + w^2 delta,
    of a quadratic trend, departures from it and noise, with u, v, s, l_k >= 1/2 and w of the
    largest likelihood. With its inverse K^-1 the residual of run i against the surface of all
    others is (K^-1 y)_i / (K^-1)_ii, of the expected variance 1 / (K^-1)_ii (Rasmussen and Williams
    2006, eq. 5.12). Where residuals are larger than that, errors of the surface are raised by
    their ratio.
    """

    def __init__(self, places: Floats, values: Floats, noise: Floats | float) -> None:
        self._mean, self._model = float(values.mean()), None
        self.residuals, self._factor = np.zeros(len(values)), 1.0
        if np.ptp(values) < 1e-9 * max(abs(self._mean), 1.0):
            return
        with extra("availability", "scikit-learn"):
            from sklearn.exceptions import ConvergenceWarning
            from sklearn.gaussian_process import GaussianProcessRegressor
            from sklearn.gaussian_process.kernels import (
                RBF,
                ConstantKernel,
                DotProduct,
                WhiteKernel,
            )
        trend = ConstantKernel(1.0, (1e-3, 1e4)) * DotProduct(1.0, (0.1, 100.0)) ** 2
        lengths = RBF(np.ones(places.shape[1]), _LENGTHS)
        signal = trend + ConstantKernel(1.0, (1e-4, 1e2)) * lengths
        with warnings.catch_warnings():
            # an input without effect has an infinite length, which the bounds cut off
            warnings.simplefilter("ignore", ConvergenceWarning)
            known = np.broadcast_to((noise / values.std()) ** 2, values.shape)
            search = GaussianProcessRegressor(
                signal + WhiteKernel(1e-3, (1e-6, 2.0)), alpha=known,
                n_restarts_optimizer=_RESTARTS, normalize_y=True, random_state=0,
            )  # fmt: skip
            fitted = search.fit(places, values).kernel_
        # the noise belongs to the runs and not to the surface, whose errors are asked for
        self._model = GaussianProcessRegressor(
            fitted.k1,
            alpha=known + fitted.k2.noise_level,
            optimizer=None,
            normalize_y=True,
            random_state=0,
        ).fit(places, values)
        self._places, self._scale = places, float(values.std())
        self._inverse = np.linalg.inv(self._model.L_ @ self._model.L_.T)
        precision = np.diag(self._inverse)
        self.residuals = self._scale * self._model.alpha_.ravel() / precision
        standard = self.residuals * np.sqrt(precision) / self._scale
        self._factor = max(1.0, float(np.sqrt(np.mean(standard**2))))

    @property
    def error(self) -> float:
        """Root mean square of the residuals: leave-one-out error, with the noise of a run."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    def values(self, places: Floats) -> Floats:
        """Return the surface at places (n, axes)."""
        if self._model is None:
            return np.full(len(places), self._mean)
        return np.asarray(self._model.predict(places))

    def errors_of_sums(self, places: Floats, weights: Floats) -> Floats:
        """Return the standard errors (k,) of sums of weights (k, n) times the surface at places."""
        if self._model is None:
            return np.zeros(len(weights))
        kernel = self._model.kernel_
        known = weights @ kernel(places, self._places)
        variance = ((weights @ kernel(places)) * weights).sum(axis=1)
        variance -= ((known @ self._inverse) * known).sum(axis=1)
        return self._factor * self._scale * np.sqrt(np.maximum(variance, 0.0))
