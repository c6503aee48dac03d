"""From a network to the bundle form: points are eliminated in the kernel, and what they share is one normal matrix of
blocks of variable pairs. The same network as GTSAM factors, the reference: `adjustment.factor_graph`.

A `Layout` sorts the points. Four words say which points are meant:

    pattern   points with the same list of observations; patterns are sorted by the kernel's loops, then by group
    group     points that depend on the same shared unknowns: one block of the normal matrix; of one or several patterns
    piece     neighboring points of one pattern, 2048 at most, whose numbers lie side by side: the kernel's unit of work
    share     neighboring pieces that one thread takes, about 65,000 observations

    points    0 ........................................................................................ n - 1
    pattern   | rays A, B         | rays A, C  | rays A, B, C              | rays A, B, range A | ...         |
    group     | {A, B}            | {A, C}     | {A, B, C}                 | {A, B}             | ...         |
    piece     | 2048 | 2048 | 311 | 907        | 2048 | 2048 | 2048 | 64   | 120                | ...         |
    share     |  first thread                  |  second thread                                 | ...         |

The observations of one point are numbered by their *slot* in the list of its pattern.
"""

from mgsgraph.adjustment.graph.forms import BundleGraph as BundleGraph
from mgsgraph.adjustment.graph.layout import Layout as Layout
from mgsgraph.adjustment.graph.layout import lay_out as lay_out
