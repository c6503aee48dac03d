"""OpenCV, which only matching needs."""

from types import ModuleType

from mgsgraph.errors import InputError


def opencv() -> ModuleType:
    """The module.

    Raises
    ------
    InputError
        Where it is not installed, or cannot be loaded.
    """
    try:
        import cv2  # heavy
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == "cv2"
        found = "OpenCV is not installed" if missing else f"OpenCV can't be imported ({' '.join(str(error).split())})"
        raise InputError("matching", found, remedy='pip install "mgsgraph[match]"') from None
    module: ModuleType = cv2  # typed or not, as the installed version is
    return module
