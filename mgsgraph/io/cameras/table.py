"""All line scanners that are known here."""

from mgsgraph.io.cameras.camera import Camera
from mgsgraph.io.cameras.ctx import CTX
from mgsgraph.io.cameras.hirise import HIRISE
from mgsgraph.io.cameras.hrsc import HRSC
from mgsgraph.io.cameras.kaguya import MI, TC1, TC2
from mgsgraph.io.cameras.lroc import NAC_LEFT, NAC_RIGHT
from mgsgraph.io.cameras.moc import MOC_BLUE, MOC_NARROW, MOC_RED
from mgsgraph.io.cameras.themis import THEMIS

CAMERAS: tuple[Camera, ...] = (
    MOC_NARROW, MOC_RED, MOC_BLUE, CTX, HIRISE, THEMIS, *HRSC, NAC_LEFT, NAC_RIGHT, TC1, TC2, *MI,
)  # fmt: skip
"""In the order in which they are looked for and listed."""
