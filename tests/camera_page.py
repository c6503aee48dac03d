"""The table of docs/cameras.md, made of the records: `python tests/camera_page.py` prints it."""

from itertools import groupby

from mgsgraph.files.cameras.camera import Camera, times_of_label
from mgsgraph.files.cameras.label import CAMERAS
from mgsgraph.files.labels.aberration import spacecraft_of

HEAD = ("camera", "NAIF id", "first line", "line period", "constants", "positions of cubes", "attitude")


def _labels(camera: Camera, says: str) -> str:
    keys = [one for one in (camera.isis, camera.pds3) if one is not None]
    return "<br>".join(dict.fromkeys(f"`{getattr(one, says)}`" for one in keys))


def _period(camera: Camera) -> str:
    if not camera.isis.period:
        return "formula" if camera.line_times is times_of_label else "each line's own"
    if camera.isis.line_summing:
        return "label, times summing"
    return "label" if camera.line_times is times_of_label else "label, corrected"


def _cells(camera: Camera) -> tuple[str, ...]:
    """All but the camera's name and number."""
    spacecraft = spacecraft_of(camera.spacecraft)
    assert spacecraft is not None
    return (
        _labels(camera, "start"),
        _period(camera),
        camera.addendum + ("" if camera.instrument_kernel is None else "; IK"),
        spacecraft.stated.correction,
        f"{camera.attitude_bias:g} s" if camera.attitude_bias else "",
    )


def table() -> str:
    """One row for cameras that differ in name and number only."""
    rows = [HEAD, tuple("---" for _ in HEAD)]
    for cells, group in groupby(CAMERAS, _cells):
        alike = list(group)
        names = alike[0].name if len(alike) == 1 else f"{alike[0].name} … {alike[-1].name.split()[-1]}"
        first, last = alike[0].instrument, alike[-1].instrument
        codes = f"{first}" if first == last else f"{first} … {last}"
        rows.append((names, codes, *cells))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


if __name__ == "__main__":
    print(table())
