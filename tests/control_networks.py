"""Control networks by chance, as other programs' formats may hold them."""

from hypothesis import strategies as st

from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType

IMAGES = ("M0100115", "E02-01461", "R0301000", "S1900001")
PLACES = st.floats(0.5, 12_000.0)
SINGLE = st.floats(0.0, 12_000.0, width=32)
SIGMAS = st.floats(0.015625, 10.0, width=32)


@st.composite
def free_networks(draw: st.DrawFn, isis_places: st.SearchStrategy[float], least: int = 2) -> ControlNetwork:
    """Free points in two or more of four images, no two at one place of an image, one sigma for line and sample."""
    count = draw(st.integers(1, 6))
    taken: set[tuple[str, float, float]] = set()
    points = []
    for k in range(1, count + 1):
        measures = []
        for image in sorted(draw(st.sets(st.sampled_from(IMAGES), min_size=least)), key=IMAGES.index):
            line, sample, sigma = draw(isis_places), draw(isis_places), draw(SIGMAS)
            while (image, line, sample) in taken:
                line += 1.0
            taken.add((image, line, sample))
            measures.append(
                ControlMeasure(image, MeasureType.CANDIDATE, sample, line, sample_sigma=sigma, line_sigma=sigma)
            )
        points.append(ControlPoint(f"match{k}", PointType.FREE, tuple(measures)))
    return ControlNetwork("", "", tuple(points))


def as_set(network: ControlNetwork) -> set[frozenset[tuple[str, float | None, float | None, float | None]]]:
    """Points without their names and order: what is measured, and how well."""
    return {
        frozenset((one.serial_number, one.line, one.sample, one.line_sigma) for one in point.measures)
        for point in network.points
    }
