"""The table of docs/cameras.md, made of the records: `python tests/camera_page.py` prints it."""

from itertools import groupby

from mgsgraph.io.cameras.camera import Camera, LabelKeys
from mgsgraph.io.cameras.table import CAMERAS

HEAD = ("camera", "NAIF ids: constants; frames", "labels", "first line", "line period", "constants",
        "positions of cubes", "attitude")  # fmt: skip


def _labels(camera: Camera, says: str) -> str:
    keys = [one for one in (camera.isis, camera.pds3) if one is not None]
    return ", ".join(dict.fromkeys(f"`{getattr(one, says)}`" for one in keys))


def _period(camera: Camera) -> str:
    keys: LabelKeys = camera.isis
    if not keys.period:
        return "of each line" if camera.start_is_utc else "by the camera's own formula"
    return _labels(camera, "period")


def _cells(camera: Camera) -> tuple[str, ...]:
    """All but the camera's name and number."""
    return (
        "cube" if camera.pds3 is None else "cube, PDS3",
        _labels(camera, "start"),
        _period(camera),
        camera.addendum + ("" if camera.instrument_kernel is None else "; IK"),
        camera.aberration,
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
        frames = ", ".join(dict.fromkeys(str(one.frame or one.instrument) for one in alike))
        rows.append((names, f"{codes}; {frames}", *cells))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


if __name__ == "__main__":
    print(table())
