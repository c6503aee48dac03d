"""What the papers print, digit by digit: the numbers beside which `reproduce_papers.py` puts its own.

PE&RS: Yoon & Shan, Combined Adjustment of MOC Stereo Imagery and MOLA Altimetry Data, PE&RS 71 (2005).
ISPRS: Yoon & Shan, Combined Bundle Adjustment of MOC Stereo Images and MOLA Altimetry Data, ISPRS XXXV (2004).
ISPRS 2002: Shan, Yoon et al., on Eos alone; its "left" image is PE&RS's right one.
Left and right as in PE&RS. Minutes of arc as printed are minutes and seconds; here seconds.
"""

from typing import NamedTuple


class Scatter(NamedTuple):
    """Mean and RMSE, as the papers print them."""

    mean: tuple[float, ...]
    spread: tuple[float, ...]


class ImageRow(NamedTuple):
    """PE&RS Table 1, one image."""

    emission_deg: float
    exposure_ms: float
    lines: int
    samples: int
    pixel_m: float
    shots: int
    spacing_m: float


TABLE_1: dict[str, tuple[ImageRow, ImageRow]] = {
    "eos": (ImageRow(0.16, 1.8078, 9856, 672, 5.5, 174, 305.0), ImageRow(17.97, 1.2052, 7424, 1024, 4.1, 76, 341.0)),
    "gusev": (ImageRow(0.2, 1.4462, 10112, 1024, 4.4, 142, 305.0), ImageRow(22.1, 1.4462, 8960, 1024, 4.9, 124, 341.0)),
    "isidis": (ImageRow(13.0, 0.9642, 7680, 1024, 3.3, 71, 340.0), ImageRow(0.2, 1.4462, 7680, 1024, 4.4, 107, 304.0)),
}
TIES = {"eos": 162, "gusev": 154, "isidis": 41}
BASE_TO_HEIGHT = {"eos": 0.41, "gusev": 0.41, "isidis": 0.24}

# X, Y, Z in m; omega, phi, kappa in seconds of arc; SPICE against refined, 31 places
TABLE_2: dict[str, tuple[Scatter, Scatter]] = {
    "eos": (
        Scatter((13.288, -24.029, 123.972, -245.13, 15.13, 25.07), (0.190, 0.539, 2.109, 337.25, 38.65, 27.37)),
        Scatter((0.756, 22.347, -86.055, 19.13, 5.93, 1173.96), (35.027, 110.955, 417.77, 57.15, 28.31, 1235.68)),
    ),
    "gusev": (
        Scatter((-4.727, 21.005, 29.444, -3.20, 43.36, 18.74), (0.537, 0.194, 2.156, 7.65, 3.68, 6.83)),
        Scatter((24.715, -1.879, -148.94, 34.05, 6.60, -75.91), (0.477, 0.253, 1.784, 3.91, 2.27, 4.14)),
    ),
    "isidis": (
        Scatter((-5.817, 28.040, -56.158, 28.71, 1.49, -54.47), (0.292, 0.196, 2.294, 0.14, 0.80, 0.38)),
        Scatter((2.219, -6.830, 56.878, -24.13, -1.50, 21.35), (0.049, 0.035, 0.382, 6.39, 0.47, 7.94)),
    ),
}

# m, X, Y, Z: ties by the combined adjustment against their intersection with SPICE; PE&RS Table 3, ISPRS Table 2
TIE_CORRECTIONS: dict[str, dict[str, Scatter]] = {
    "PE&RS": {
        "eos": Scatter((-91.23, 106.91, 54.80), (117.68, 151.43, 59.59)),
        "gusev": Scatter((-1.79, 0.37, 6.75), (2.72, 0.34, 1.07)),
        "isidis": Scatter((0.22, -1.79, 3.07), (0.16, 0.99, 2.72)),
    },
    "ISPRS": {
        "eos": Scatter((-91.232, 106.913, 54.799), (117.676, 151.426, 59.585)),
        "gusev": Scatter((-1.794, 0.371, 6.750), (2.723, 0.340, 1.10)),
        "isidis": Scatter((0.222, -1.786, 3.144), (0.189, 1.011, 3.148)),
    },
}
# m, footprints: ISPRS Table 2 alone
MOLA_CORRECTIONS: dict[str, Scatter] = {
    "eos": Scatter((0.001, -0.001, 0.004), (0.256, 0.366, 0.188)),
    "gusev": Scatter((-0.001, 0.001, 0.001), (0.299, 0.098, 0.135)),
    "isidis": Scatter((0.0004, 0.0001, 0.023), (0.056, 0.222, 0.746)),
}


class Sigmas(NamedTuple):
    """Table 4: m in X, Y, Z; pixels."""

    mola: tuple[float, float, float]
    tie: tuple[float, float, float]
    sigma0: float


TABLE_4: dict[str, dict[str, Sigmas]] = {
    "PE&RS": {
        "eos": Sigmas((9.21, 8.94, 10.18), (99.01, 141.64, 43.30), 1.037),
        "gusev": Sigmas((7.87, 10.21, 10.16), (21.27, 5.02, 6.63), 1.059),
        "isidis": Sigmas((9.84, 7.33, 9.85), (6.88, 57.90, 8.31), 1.014),
    },
    "ISPRS": {
        "eos": Sigmas((9.210, 8.941, 10.183), (99.012, 141.643, 43.296), 1.037),
        "gusev": Sigmas((7.869, 10.205, 10.158), (21.270, 5.020, 6.633), 1.059),
        "isidis": Sigmas((18.297, 9.799, 18.302), (7.344, 57.934, 8.684), 1.014),
    },
}

# pixels, left x, left y, right x, right y; x along the flight. PE&RS Table 5 (two digits) = ISPRS Table 3 (three)
TABLE_5: dict[str, Scatter] = {
    "eos": Scatter((12.789, 4.040, -8.419, 47.103), (61.724, 15.915, -18.116, 40.515)),  # the minus is printed
    "gusev": Scatter((-24.176, 3.286, 24.895, -2.695), (0.774, 0.254, 0.104, 0.163)),
    "isidis": Scatter((35.044, -2.711, -24.789, 2.891), (0.082, 0.198, 1.519, 0.357)),
}
TIE_RESIDUALS: dict[str, Scatter] = {
    "eos": Scatter((-0.009, -0.002, 0.009, -0.002), (0.615, 0.055, 0.418, 0.030)),
    "gusev": Scatter((0.086, -0.012, -0.089, 0.009), (0.603, 0.084, 0.621, 0.069)),
    "isidis": Scatter((-0.162, 0.012, 0.119, -0.018), (0.453, 0.035, 0.322, 0.038)),
}
RANGE_RESIDUALS_M = (1.0, 2.0)
"""ISPRS: "vary from about 1 meter up to about 2 meters"."""
STATED_SHIFT_M = 325.0

# ISPRS 2002, Table 1: X, Y, Z in km, omega, phi, kappa in degrees, at the start and end line; by PE&RS's images
EOS_ORIENTATION: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...] = (
    (
        (2743.679, -2453.358, -895.114, 11.3701, -75.9648, -126.576),  # Y: a misprint, the radius is 11 km too large
        (2749.133, -2450.626, -836.828, 12.1810, -76.8692, -125.6728),
    ),
    (
        (2638.162, -2549.221, -891.875, -8.6296, -75.9467, -124.5666),
        (2640.863, -2557.746, -860.101, -8.6392, -75.9452, -124.5345),
    ),
)
# ISPRS 2002, Table 2: km, body-fixed (part of a profile; 341 m apart, so that of the right image)
EOS_FOOTPRINTS: tuple[tuple[float, float, float], ...] = (
    (2469.471, -2191.971, -792.691), (2469.504, -2192.054, -792.363), (2469.540, -2192.134, -792.035),
    (2469.596, -2192.310, -791.380), (2469.625, -2192.397, -791.052), (2469.659, -2192.479, -790.724),
    (2469.701, -2192.552, -790.395), (2469.764, -2192.720, -789.740), (2469.845, -2192.987, -788.758),
    (2469.876, -2193.071, -788.430),
)
