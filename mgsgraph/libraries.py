"""Libraries that an extra brings: imported when they are needed, or one line that says what to install."""

from importlib import import_module
from types import ModuleType

from mgsgraph.errors import InputError


def library(name: str, extra: str, wanted_for: str, called: str = "") -> ModuleType:
    """The module of a library that is there only with an extra.

    Parameters
    ----------
    name : str
        What is imported.
    extra : str
        Extra of mgsgraph that brings it.
    wanted_for : str
        What needs it, for the error.
    called : str, optional
        How people call it; by the name of its module when absent.

    Raises
    ------
    InputError
        If it is not installed, or can't be imported.
    """
    try:
        return import_module(name)
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == name
        why = "is not installed" if missing else f"can't be imported ({' '.join(str(error).split())})"
        found = f"{called or name} {why}"
        raise InputError(wanted_for, found, remedy=f'pip install "mgsgraph[{extra}]"') from None
