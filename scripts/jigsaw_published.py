"""What ISIS's own test of jigsaw expects, digit by digit: the numbers beside which `real_networks.py` puts others.

DOI-USGS/ISIS3, isis/tests/FunctionalTestsJigsaw.cpp, FunctionalTestJigsawCamSolveAll on the fixture ObservationPair.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.geometry.records import Array


class Jigsaw(NamedTuple):
    """What a version expects."""

    mean: float
    """px, AverageResidual: of the measures' residuals, in undistorted pixels."""
    largest: float
    """px, MaximumResidual."""
    places: Array
    """(4, 3) km, mean, standard deviation, least and largest x, y, z of the 46 adjusted points."""
    ascension: Array
    """(2, 4) deg, adjusted coefficients of L's and R's first angle (RA + 90 deg), of time scaled to -1 .. 1."""
    declination: Array
    """(2, 4) deg, the same of the second angle (90 deg - DEC)."""


PUBLISHED = {
    "ISIS 8 and 9": Jigsaw(
        0.123132, 0.379967,
        np.array([
            [1556.64806314499741, 98.326253648503553, 763.0309515939565],
            [10.663072757957551, 1.3218686492693708, 19.783664466904419],
            [1540.43360835455860, 96.795117686735381, 728.82827218510067],
            [1574.6528854394717, 100.04990583087032, 793.9672179283682],
        ]),
        np.array([[123.9524918, -1.51532975, 0.2691039, 1.208684781],
                  [121.4164029, -1.510464718, 0.253046705, 1.203832854]]),
        np.array([[104.8575294, -1.399416621, -0.26159502200533, 0.365064224],
                  [106.11241033284, -1.4160602752902001, -0.26704142, 0.365717165]]),
    ),
    "an older ISIS": Jigsaw(
        0.123064, 0.381344,
        np.array([
            [1556.7584771783206, 98.208738223507225, 762.82251432110763],
            [10.631498543565199, 1.3673015631587004, 19.729497110253373],
            [1540.4317622465978, 96.619628964863949, 728.96119308965888],
            [1574.5901321194606, 100.0030959760862, 793.97047228191013],
        ]),
        np.array([[124.09795503794, -1.609431849824, 0.090869904636249, 1.2889643923628],
                  [121.56104785831, -1.6023940678566, 0.075238320019048996, 1.2841024956924001]]),
        np.array([[104.9608424103, -1.4136599605067, -0.40042380396853, 0.35274496855965],
                  [106.21585141044, -1.4288947037887001, -0.40577836111149002, 0.35344945367243003]]),
    ),
}  # fmt: skip
