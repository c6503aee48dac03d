"""All line scanners that are known here."""

from mgsgraph.files.cameras.camera import Camera
from mgsgraph.files.cameras.ctx import CTX
from mgsgraph.files.cameras.hirise import HIRISE
from mgsgraph.files.cameras.hrsc import HRSC
from mgsgraph.files.cameras.kaguya import MI, TC1, TC2
from mgsgraph.files.cameras.lroc import NAC_LEFT, NAC_RIGHT
from mgsgraph.files.cameras.moc import MOC_BLUE, MOC_NARROW, MOC_RED
from mgsgraph.files.cameras.themis import THEMIS

CAMERAS: tuple[Camera, ...] = (
    MOC_NARROW, MOC_RED, MOC_BLUE, CTX, HIRISE, THEMIS, *HRSC, NAC_LEFT, NAC_RIGHT, TC1, TC2, *MI,
)  # fmt: skip
"""In the order in which they are looked for and listed."""
