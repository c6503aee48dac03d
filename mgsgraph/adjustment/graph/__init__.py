"""From a network to a GTSAM factor graph, in either form; the only room that builds factors."""

from mgsgraph.adjustment.graph.bundle import BundleGraph as BundleGraph
from mgsgraph.adjustment.graph.explicit import explicit_graph as explicit_graph
from mgsgraph.adjustment.graph.layout import Layout as Layout
from mgsgraph.adjustment.graph.layout import lay_out as lay_out
