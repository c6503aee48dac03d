"""`mgsgraph review` as a person uses it: a page, its verdicts, a network without the rejected points; and bad input."""

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from commands import refused, run

from mgsgraph.files.networks.binary import read_control_network, read_network
from mgsgraph.files.networks.table import table_text


@pytest.fixture
def case(case_file: Path) -> Path:
    """The small simulated pair with pixels: noise, for a review takes what there is."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    grey = np.random.default_rng(0).integers(0, 256, (5000, 1024), dtype=np.uint8)
    text = case_file.read_text(encoding="utf-8")
    for letter in "AB":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(case_file.with_name(f"{letter}.tif"), "w", driver="GTiff", height=5000, width=1024,
                               count=1, dtype="uint8") as file:  # fmt: skip
                file.write(grey, 1)
        text = text.replace(f'isd = "image_{letter}.isd"', f'isd = "image_{letter}.isd"\npixels = "{letter}.tif"')
    case_file.write_text(text, encoding="utf-8")
    return case_file


def test_from_a_page_to_a_network(case: Path, tmp_path: Path) -> None:
    page, kept = tmp_path / "review.html", tmp_path / "kept.net"
    done = run("review", case, "--out", page, "--worst", 5)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    assert "- 5 of 20 tie points: in turn the next by lowest correlation, " in done.stdout
    text = page.read_text(encoding="utf-8")
    ids = re.findall(r'article tabindex="-1" data-id="(\w+)"', text)
    (digest,) = re.findall(r'data-network="(\w+)"', text)
    assert len(ids) == 5
    verdicts = tmp_path / "verdicts.csv"
    verdicts.write_text(f"# network {digest}\nid,verdict,note\n{ids[0]},reject,blurred\n{ids[1]},accept,\n")
    done = run("review", case, "--verdicts", verdicts, "--out", kept)
    assert done.returncode == 0, done.stderr
    assert "- 1 of 20 points of" in done.stdout
    before = read_control_network(case.with_name("network.pvl"))
    assert read_control_network(kept).ids == tuple(name for name in before.ids if name != ids[0])

    done = run("review", case, "--out", page, "--verdicts", verdicts, "--points", f"{ids[0]}, {ids[1]}")
    assert done.returncode == 0, done.stderr
    text = page.read_text(encoding="utf-8")
    assert "2 of 20 tie points, as asked for" in text
    assert re.search(rf'data-id="{ids[0]}" data-verdict="reject"', text)
    assert 'value="blurred"' in text

    names = sorted(path.name for path in tmp_path.iterdir())  # and the new network is another one
    refused(run("review", case, "--ties", kept, "--verdicts", verdicts, "--out", tmp_path / "k.pvl"),
            "expected points of", tmp_path, names)  # fmt: skip
    verdicts.write_text(f"# network {digest}\nid,verdict\n{ids[1]},reject\n")
    refused(run("review", case, "--ties", kept, "--verdicts", verdicts, "--out", tmp_path / "k.pvl"),
            f"about network {digest}", tmp_path, sorted(path.name for path in tmp_path.iterdir()))  # fmt: skip


def test_a_table_that_a_case_has_becomes_a_network(case: Path, tmp_path: Path) -> None:
    """With the name of the case's body, which ISIS demands."""
    table = case.with_name("points.csv")
    table.write_text(table_text(read_network(case.with_name("network.pvl"))), encoding="utf-8")
    case.write_text(case.read_text(encoding="utf-8").replace("network.pvl", "points.csv"), encoding="utf-8")
    verdicts = tmp_path / "v.csv"
    verdicts.write_text("id,verdict\n")
    done = run("review", case, "--verdicts", verdicts, "--out", tmp_path / "kept.net")
    assert done.returncode == 0, done.stderr
    assert read_network(tmp_path / "kept.net").target_name == "MARS"


def test_bad_input_writes_nothing(case: Path, tmp_path: Path) -> None:
    page, network = tmp_path / "review.html", tmp_path / "kept.pvl"
    verdicts = tmp_path / "v.csv"
    verdicts.write_text("id,verdict\nTIE00001,reject\n")
    names = ["case", "v.csv"]
    refused(run("review", tmp_path / "none.toml", "--out", page), "no such file", tmp_path, names)
    refused(run("review", case, "--out", tmp_path / "page.txt"), "'.txt'; expected a page (.html) or a network",
            tmp_path, names)  # fmt: skip
    refused(run("review", case, "--out", network), "it is written by --verdicts", tmp_path, names)
    refused(run("review", case, "--out", network, "--verdicts", verdicts, "--worst", 3), "--worst is for a page",
            tmp_path, names)  # fmt: skip
    refused(run("review", case, "--out", page, "--worst", 3, "--points", "TIE00001"), "can't both be given",
            tmp_path, names)  # fmt: skip
    refused(run("review", case, "--out", page, "--points", "NONE"), "no point NONE", tmp_path, names)
    refused(run("review", case, "--out", page, "--verdicts", tmp_path / "none.csv"), "no such file", tmp_path, names)
    refused(run("review", case, "--out", page, "--solution", tmp_path), "solution.npz", tmp_path, names)
    own = case.with_name("network.pvl")
    refused(run("review", case, "--out", own, "--verdicts", verdicts), "that was reviewed", tmp_path, names)
    verdicts.write_text("id,verdict\nTIE00001,perhaps\n")
    refused(run("review", case, "--out", network, "--verdicts", verdicts), "v.csv, line 2: the verdict",
            tmp_path, names)  # fmt: skip
    case.write_text(case.read_text(encoding="utf-8").replace('pixels = "B.tif"\n', ""), encoding="utf-8")
    refused(run("review", case, "--out", page), "image SIM/B: no file of its pixels", tmp_path, names)
    text = case.read_text(encoding="utf-8")
    head, _, rest = text.partition("[ties]")
    case.write_text(head + rest[rest.index("\n[") :], encoding="utf-8")
    refused(run("review", case, "--out", page), "no network of tie points; expected one", tmp_path, names)
