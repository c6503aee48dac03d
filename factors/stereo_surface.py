"""A point on the surface that two images show, linear about a state (`mgsgraph.geometry.stereo_surface`).

    r = h0 + n'(P - P0) + g                    m, height of the point above the stereo surface along its normal

h0 is the height at P0 with the orientation about which it is linear, n the unit normal, and g what the orientation
corrections of the two images have moved the surface since: minus h0's own share, so that r depends on the present
corrections alone. The derivative by P is n, by g one.
"""



from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import dot, subtract


@equation
def stereo_height(height, normal, point, reference, moved):
    """Residual r in m."""
    return height + dot(normal, subtract(point, reference)) + moved
