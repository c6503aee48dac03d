"""Work over several processes or machines by dask.distributed: workers of one's own, or a scheduler that runs already.

The only room that knows dask, and knows it only when it is asked for: the package works without it.
"""

from mgsgraph.adjustment.cluster.connection import Connection as Connection
from mgsgraph.adjustment.cluster.connection import Lost as Lost
from mgsgraph.adjustment.cluster.connection import open_cluster as open_cluster
from mgsgraph.adjustment.cluster.workers import ClusterAddress as ClusterAddress
from mgsgraph.adjustment.cluster.workers import parse_cluster as parse_cluster
