"""Messages of docs/faq.md: those of a small case are provoked, the parts of the others stand in the sources."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from mgsgraph.cli import group
from mgsgraph.errors import MgsgraphError
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.pair import PairSettings, simulate_pair

ROOT = Path(__file__).resolve().parents[1]
MESSAGES = dict(
    re.findall(r"^### (.+)\n```output\n(.+)\n```$", (ROOT / "docs/faq.md").read_text(encoding="utf-8"), re.MULTILINE)
)
CHANGED = {
    "A key is unknown": ("sigma_px", "sigm_px"),
    "A value is of the wrong kind": ("sigma_px = 1.0", 'sigma_px = "one"'),
    "The TOML cannot be read": ("[ties]", "[ties"),
    "No format": ("format = 1\n", ""),
    "No image has the network's name": ('name = "SIM/A"', 'name = "SIM/X"'),
    "No measures at all": ('[ties]\nnetwork = "network.pvl"\nsigma_px = 1.0\n', ""),
    "The network is too weak": ("m = 30.0\nangle_sigma_mrad = 0.1", "m = inf\nangle_sigma_mrad = inf"),
}  # fmt: skip
"""What is changed in the case before it is adjusted."""
ASKED = {
    "A file is missing": "adjust nothing.toml --out NEW",
    "No pixels": "match data/case.toml --out NEW",
    "A column is unknown": "convert points.csv x.net",
    "Verdicts of another network": "review data/case.toml --verdicts verdicts.csv --out kept.pvl",
    "Nothing to register": "coregister data/case.toml --out NEW",
    "The folder is taken": "adjust data/case.toml --out other",
    "Not a result": "analyze other",
    "No such point, no such image": "analyze RESULT --pose SIMA 10",
    "Rays that miss each other": "analyze RESULT --pixel SIM/A 100 100 --pixel SIM/B 900 900",
    "No project there": "solve nowhere",
}
"""What is asked for, beside the case and its result."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("faq")
    for name in ("data", "other"):
        (here / name).mkdir()
    case = write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), here / "data")
    (here / "other" / "mine.txt").touch()
    (here / "points.csv").write_text("id,image,line,sampel\nA,SIM/A,1,1\n", encoding="utf-8")
    head = "# network 0000000000000000\nid,verdict,note\n"
    (here / "verdicts.csv").write_text(f"{head}TIE00001,reject,\n", encoding="utf-8")
    done = group.main(["adjust", str(case), "--no-figures", "--out", str(here / "RESULT")], standalone_mode=False)
    assert done == 0
    return here


def as_said(message: str) -> str:
    """The pattern of a message; folders are not said alike, nor is what follows from the simulation."""
    parts = re.split(r"…|\b\d+\b(?= sigmas| undetermined)|\b[0-9a-f]{16}\b", message)
    return ".*".join(re.escape(part) for part in parts)


def error_of(words: str) -> str:
    with pytest.raises(MgsgraphError) as caught:
        group.main(words.split(), standalone_mode=False)
    return str(caught.value)


@pytest.mark.parametrize("heading", CHANGED)
def test_a_case_that_is_not_right(heading: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    good = Path("data/case.toml").read_text(encoding="utf-8")
    assert CHANGED[heading][0] in good
    case = Path("data/changed.toml")
    case.write_text(good.replace(*CHANGED[heading]), encoding="utf-8")
    said = error_of(f"adjust {case} --no-laser --no-figures --out NEW").replace("changed.toml", "case.toml")
    assert re.fullmatch(f".*{as_said(MESSAGES[heading])}", said)


@pytest.mark.parametrize("heading", ASKED)
def test_what_cannot_be_done(heading: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    said = error_of(ASKED[heading]).replace("data/", "")
    assert re.fullmatch(as_said(MESSAGES[heading].replace("data/", "")), said)


@pytest.fixture(scope="module")
def sources() -> str:
    """All texts of the program, … for what is put in."""
    return "\n".join(text for path in (ROOT / "mgsgraph").rglob("*.py") for text in texts_of(path))


def texts_of(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(one.value) if isinstance(one, ast.Constant) else "…" for one in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.mark.parametrize("heading", sorted({*MESSAGES} - {*CHANGED} - {*ASKED}))
def test_every_part_of_a_message_stands_in_the_sources(heading: str, sources: str) -> None:
    where, _, rest = MESSAGES[heading].partition(": ")
    parts = [one.removeprefix("expected ") for one in re.split(r"; |: |, as do |\. |…", rest or where)]
    missing = [one for one in parts if one.strip(" .,()") not in sources]
    assert not missing


def test_enough_messages_are_told() -> None:
    assert len(MESSAGES) >= 25
    assert set(CHANGED) | set(ASKED) <= set(MESSAGES)
