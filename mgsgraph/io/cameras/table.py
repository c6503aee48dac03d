"""All line scanners that are known here."""

from mgsgraph.io.cameras.camera import Camera
from mgsgraph.io.cameras.ctx import CTX
from mgsgraph.io.cameras.lroc import NAC_LEFT, NAC_RIGHT
from mgsgraph.io.cameras.moc import MOC_BLUE, MOC_NARROW, MOC_RED

CAMERAS: tuple[Camera, ...] = (MOC_NARROW, MOC_RED, MOC_BLUE, CTX, NAC_LEFT, NAC_RIGHT)
"""In the order in which they are looked for and listed."""
