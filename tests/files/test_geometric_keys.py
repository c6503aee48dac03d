"""The tables of geometric keys: what writers write is in them, what real files say is known, and the rest is named."""

import json
import re
from importlib.resources import files
from pathlib import Path

import pytest
from outside import refuses

from mgsgraph.files.geometric_keys import FORMATS, GRID_LABEL, IMAGE_LABEL, SUPPORT_DATA, Use, require_usual, unread
from mgsgraph.files.pvl import read_label
from mgsgraph.simulation.case_files import support_data
from mgsgraph.simulation.pair import PairSettings, simulate_pair


def keys_of(text: str) -> list[str]:
    return re.findall(r"^\s*([A-Z][\w:]*)\s*=", text, re.MULTILINE)


def named(content: dict[str, object]) -> list[str]:
    """Names of JSON, members of tables after a point."""
    inner = [f"{key}.{name}" for key, one in content.items() if isinstance(one, dict) for name in one]
    return [one for one in inner if not one.startswith("naif")] + [
        key for key, one in content.items() if not isinstance(one, dict)
    ]


def test_what_is_written_is_in_the_tables() -> None:
    data = files("mgsgraph.simulation") / "data"
    for name, table in (("moc.lbl", IMAGE_LABEL), ("megdr.lbl", GRID_LABEL)):
        assert unread(keys_of((data / name).read_text()), table) == []
    written = support_data(simulate_pair(PairSettings(ties=2, shots=2)).images[0])
    assert unread(named(written), SUPPORT_DATA) == []


def test_real_files_have_no_unknown_keys(shared_data: Path) -> None:
    for path in shared_data.rglob("*_pds3.lbl"):
        root = read_label(path)
        names = [key for block in (root, *root.blocks) for key in block.entries]
        assert unread(names, IMAGE_LABEL) == [], path
    for path in [*shared_data.rglob("*.crop.json"), *(shared_data / "lro_nac_lola").glob("*.isd")]:
        assert unread(named(json.loads(path.read_text())), SUPPORT_DATA) == [], path


def test_what_looks_geometric_and_is_unknown_is_named() -> None:
    assert unread(["detector_rotation", "colour"], SUPPORT_DATA) == ["detector_rotation"]
    assert unread(["LATITUDE_TYPE", "NOTE"], IMAGE_LABEL) == ["LATITUDE_TYPE"]


@pytest.mark.parametrize("name", FORMATS)
def test_names_are_expressions_and_refused_ones_say_what_is_meant(name: str) -> None:
    for key in FORMATS[name]:
        re.compile(key.name)
        assert key.meaning
        assert key.same_as or key.use == Use.READ
        if key.use == Use.REFUSED:
            assert re.fullmatch(f"(?:{key.usual})", "SOMETHING ELSE") is None


def test_usual_values_pass_and_others_are_refused() -> None:
    require_usual({"unit": "METER", "MAP_PROJECTION_ROTATION": "0.0", "TARGET_NAME": '"MARS"'}, GRID_LABEL, "a")
    for key, value in (("unit", "FEET"), ("MAP_PROJECTION_ROTATION", "90.0"), ("TARGET_NAME", "MOON")):
        refuses(key, require_usual, {key: value}, GRID_LABEL, "a")
