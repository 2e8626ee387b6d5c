"""Background light of a receiver: radiance by its parts, power, counts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np

from meshtrace.errors import Refused
from meshtrace.models import Floats
from meshtrace.stored import Stored, Variable

PARTS = ("sky", "glint", "water", "foam", "sun")
"""Parts of the background, in the order of `Background.part_radiance`.

In the air: sky mirrored by the sea or seen directly, sun mirrored, light out of the water, foam,
sun seen directly. Under water: "sky" and "sun" through the surface, scattered light included.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Background(Stored):
    """Radiance of the background, averaged over aperture and field of view of a receiver.

    Attributes
    ----------
    part_radiance, part_radiance_stderr : ndarray, shape (parts,)
        Mean radiance <L> = int L cos dOmega / (pi sin^2 psi) of each of `PARTS`, and its standard
        error [W m-2 sr-1 nm-1].
    radiance, radiance_stderr : float
        Sum of the parts, and its standard error.
    acceptance : float
        Area times projected solid angle of aperture and field of view [m2 sr].
    wavelength_nm : float
        Wavelength [nm].
    provenance : dict
        Link, sea, daylight, seeds and versions.
    """

    part_radiance: Annotated[Floats, Variable("part")]
    part_radiance_stderr: Annotated[Floats, Variable("part")]
    radiance: Annotated[float, Variable("", name="background_radiance")]
    radiance_stderr: Annotated[float, Variable("", name="background_radiance_stderr")]
    acceptance: Annotated[float, Variable("")]
    wavelength_nm: Annotated[float, Variable("")]
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "background"
    title: ClassVar[str] = "meshtrace background light"

    @property
    def parts(self) -> dict[str, float]:
        """Mean radiance of each part [W m-2 sr-1 nm-1]."""
        return dict(zip(PARTS, self.part_radiance.tolist(), strict=True))

    @property
    def parts_stderr(self) -> dict[str, float]:
        """Standard error of each part [W m-2 sr-1 nm-1]."""
        return dict(zip(PARTS, self.part_radiance_stderr.tolist(), strict=True))

    @property
    def light(self) -> str:
        """Name of the light."""
        return str(self.provenance["daylight"]["light"])

    def _origin_lines(self) -> list[str]:
        return [self.light]

    @property
    def power_per_nm(self) -> float:
        """Power into the aperture within the field of view [W nm-1]."""
        return self.radiance * self.acceptance

    def count_rate(self, ook: Any) -> float:
        """Return the primary counts of a receiver [s-1], before saturation.

        r_b = PDE P_b / E_ph,  P_b = <L> dlambda T G,

        or, where the LED, the filter or the efficiency of the detector has a spectrum, the
        integral of L T PDE / E_ph over wavelength and over angles that fill the field of view,
        with the spectrum of the light above the sea (`Daylight.spectrum`).

        Parameters
        ----------
        ook : OokLink
            Optics with the aperture and field of view of the background (`OokLink.of_link`),
            filter and SiPM.

        Notes
        -----
        G = min(A_lens n_med^2 pi sin^2 psi, pi A_det n_c^2) / n_med^2: behind an etendue-limited
        lens a narrower field of view does not reduce the background. In the product the spectrum
        counts as flat over the filter: `Daylight.clear_sky(width_nm=...)` has the mean over a wide
        band.

        Raises
        ------
        Refused
            If the filter is wider than twice the wavelength, which its band is centred on.
        """
        widest, width = 2.0 * self.wavelength_nm, ook.optics.equivalent_width_nm
        if width > widest:
            raise Refused("optics.filter_width_nm", width, f"<= {widest:g}, twice the wavelength")
        return float(ook.background_count_rate(self))

    def _headline(self) -> str:
        return (
            f"{self.light}: {self.radiance:.4e} +- {self.radiance_stderr:.1e} W m-2 sr-1 nm-1 "
            f"at {self.wavelength_nm:g} nm"
        )

    def summary(self) -> str:
        """Return radiance, parts and power as text for a terminal."""
        lines = [self._headline()]
        lines += [
            f"  {name:<6} {self.parts[name]:.4e} +- {self.parts_stderr[name]:.1e}"
            for name in PARTS
            if self.parts[name] > 0.0
        ]
        return "\n".join([*lines, f"  power  {self.power_per_nm:.4e} W nm-1"])


@dataclass(frozen=True, eq=False, repr=False)
class BackgroundSeries(Stored):
    """Background of a receiver over a moving sea, with the same rays at all times.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Times [s].
    part_radiance, part_radiance_stderr : ndarray, shape (n, parts)
        Mean radiance of each of `PARTS`, and its standard error [W m-2 sr-1 nm-1].
    provenance : dict
        Link, sea, daylight, seeds and versions.
    """

    time: Annotated[Floats, Variable("time")]
    part_radiance: Annotated[Floats, Variable("time part")]
    part_radiance_stderr: Annotated[Floats, Variable("time part")]
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "background-series"
    title: ClassVar[str] = "meshtrace background light over time"

    @property
    def radiance(self) -> Floats:
        """Sum of the parts at each time, shape (n,)."""
        return np.asarray(self.part_radiance.sum(axis=1))

    @property
    def parts(self) -> dict[str, Floats]:
        """Mean radiance of each part at each time."""
        return dict(zip(PARTS, self.part_radiance.T, strict=True))

    @property
    def scintillation_index(self) -> float:
        """Variance of the radiance over its squared mean, with the noise of the rays."""
        return float(self.radiance.var() / self.radiance.mean() ** 2)

    def _headline(self) -> str:
        return (
            f"{len(self.time)} times, mean {self.radiance.mean():.4e} W m-2 sr-1 nm-1, "
            f"scintillation index {self.scintillation_index:.3g}"
        )

    def summary(self) -> str:
        """Return mean, extremes and fluctuation as text for a terminal."""
        low, high = self.radiance.min(), self.radiance.max()
        return f"{self._headline()}\n  from {low:.4e} to {high:.4e}"
