"""What the journal of a project says of single points that a person has changed: their states, measures set aside."""

import msgspec

from mgsgraph.errors import InputError
from mgsgraph.project.connection import ELSEWHERE, FILE
from mgsgraph.project.project import Project


class Measure(msgspec.Struct, frozen=True):
    """A point's place in an image, as it was measured."""

    image: str
    line: float
    """px, the first pixel's centre at 0.5."""
    sample: float
    """px."""
    sigma_line: float
    """px."""
    sigma_sample: float
    """px."""
    back_projected: bool = False
    """Whether it repeats the nominal orientation as if measured."""
    rejected: bool = False
    """Whether the last batch adjustment holds it for a blunder."""


class PointState(msgspec.Struct, frozen=True):
    """What is known of a point beforehand."""

    class_: int
    """PointClass."""
    kind: int
    """PointKind."""
    place: tuple[float, float, float] | None
    """m, body-fixed, a-priori; None where unknown."""
    covariance: tuple[float, ...]
    """(9) m^2 of it, row by row."""
    measures: tuple[Measure, ...]
    """In images, those that take part."""
    set_aside: tuple[Measure, ...] = ()
    """Those that a person has rejected."""
    surface_sigma: float | None = None
    """m, of its height above the terrain model; None for a point that does not lie on one."""

    def of(self, image: str) -> Measure | None:
        """The measure in an image; None where there is none that takes part."""
        return next((one for one in self.measures if one.image == image), None)


def state_of(project: Project, text: str) -> PointState:
    """A state as the journal has it; InputError where it is damaged."""
    try:
        return msgspec.json.decode(text, type=PointState)
    except msgspec.MsgspecError as error:
        raise InputError(str(project.folder), f"{FILE} is damaged ({error})", remedy=ELSEWHERE) from None


def last_state(project: Project, point: str) -> PointState | None:
    """A point as its last change left it, with those measures set aside whose images are there; None where nobody has
    changed it, or it was taken out.
    """
    last = project.last_edit_of(point)
    if last is None or last[1] is None:
        return None
    state, there = state_of(project, last[1]), set(project.store.image_names())
    kept = tuple(one for one in state.set_aside if one.image in there)
    return msgspec.structs.replace(state, set_aside=kept)


def all_set_aside(project: Project) -> dict[str, tuple[Measure, ...]]:
    """Measures that a person has rejected, by point."""
    found = {point: last_state(project, point) for point in project.edited_points()}
    return {point: state.set_aside for point, state in found.items() if state is not None and state.set_aside}
