"""The network of an adjustment, its parts, and how its images are connected."""

from mgsgraph.network.conditioning import Process as Process
from mgsgraph.network.network import Network as Network
from mgsgraph.network.passes import NodePrior as NodePrior
from mgsgraph.network.passes import Pass as Pass
from mgsgraph.network.passes import PassPrior as PassPrior
from mgsgraph.network.passes import PolynomialPrior as PolynomialPrior
from mgsgraph.network.passes import ProcessPrior as ProcessPrior
from mgsgraph.network.records import HELD as HELD
from mgsgraph.network.records import TERRAIN as TERRAIN
from mgsgraph.network.records import GroundPoints as GroundPoints
from mgsgraph.network.records import ImageRays as ImageRays
from mgsgraph.network.records import PointClass as PointClass
from mgsgraph.network.records import ProfileShifts as ProfileShifts
from mgsgraph.network.records import Ranges as Ranges
from mgsgraph.network.records import ShiftTerm as ShiftTerm
from mgsgraph.network.records import Surface as Surface
from mgsgraph.network.shared import SharedKind as SharedKind
from mgsgraph.network.shared import SharedUnknown as SharedUnknown
