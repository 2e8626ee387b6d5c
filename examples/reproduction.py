"""Print two hypotheses about the published gains and ranges: the Lambertian order, few photons.

Neither is stated in the paper. Both are computed from the stated parameters.
"""

import math
import warnings

import numpy as np

import meshtrace as mt
from meshtrace.surfaces import FlatSea, JonswapSea

PRINTED = {5.0: 6.8e-5, 10.0: 1.58e-5, 60.0: 2.6e-6}
RANGES = {47.0: "1 Mbit/s", 43.0: "5 Mbit/s", 36.0: "10 Mbit/s"}
FORMS = {
    "physical": mt.Physics(),
    "E4 and E5 as printed": mt.Physics(fresnel="paper_both", absorption="paper"),
}


def doubled(half_angle_deg):
    """Return the half angle of the order -ln 2 / ln |cos 2 theta|."""
    return math.degrees(math.acos(abs(math.cos(math.radians(2.0 * half_angle_deg)))))


def mean_gain(half_angle_deg, physics, seas=12):
    """Return the mean gain at 5 m/s, 10 m deep."""
    link = mt.Link(transmitter=mt.Led(half_angle_deg=half_angle_deg), physics=physics)
    return mt.ensemble(link, seas, JonswapSea(wind_speed=5.0), photons=2048).gain.mean()


def arrivals(depth, b):
    """Return the share of photons that arrive with free paths of 1 / b, whatever their weight."""
    link = mt.Link(water=mt.Water(a=1e-12, b=b), transmitter=mt.Led(depth=depth))
    return mt.simulate(link, FlatSea(), photons=4096).gain


def main():
    """Print both tables."""
    warnings.simplefilter("ignore", mt.DomainWarning)
    print("mean gain   printed    as stated (ratio)      |cos 2 theta| (ratio)")
    for name, physics in FORMS.items():
        logs = []
        print(name)
        for angle, printed in PRINTED.items():
            stated, other = (mean_gain(half, physics) for half in (angle, doubled(angle)))
            logs.append([math.log(stated / printed), math.log(other / printed)])
            print(f"{angle:6g} deg  {printed:.2e}   {stated:.2e} ({stated / printed:.2f})"
                  f"        {other:.2e} ({other / printed:.2f})")  # fmt: skip
        rms = np.sqrt(np.mean(np.square(logs), axis=0))
        print(f"rms of the log ratio    {rms[0]:.3f}                  {rms[1]:.3f}")
    # a realization without a photon has an error rate of 1/2: 0.5 exp(-n) = 1e-3
    few = math.log(0.5 / 1e-3)
    print(f"\nphotons in a realization for which half of exp(-n) is 1e-3: n = {few:.1f}")
    print("range       share (paths by c)  N for n      share (paths by b)  N for n")
    for depth, rate in RANGES.items():
        shares = [arrivals(depth, b) for b in (0.151, 0.037)]
        columns = "          ".join(f"{share:.2e}     {few / share:.1e}" for share in shares)
        print(f"{depth:g} m, {rate:9s} {columns}")


if __name__ == "__main__":
    main()
