"""The whole road's script: a small part of it, `fetch` and `init` from the served archive, and its judgement."""

import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import whole_road  # noqa: E402
from flaky_archive import serving, write_archive  # noqa: E402
from sites import plain_site  # noqa: E402


@pytest.mark.slow
def test_fetch_and_init_from_a_served_archive(tmp_path: Path) -> None:
    site = plain_site()
    archive = write_archive(site, tmp_path / "archive", (4,))
    fetch, init = whole_road.commands(site)[:2]
    assert fetch == "mgsgraph fetch E02/00665 E02/01453 --out DATA"
    with serving(archive) as address:
        done = whole_road.step(fetch, ["--mirror", address, "--terrain", "4"], tmp_path)
    assert "The case is DATA/case.toml" in done.said
    assert done.megabytes > 10.0
    assert "Its images wait for tie points" in whole_road.step(init, [], tmp_path).said
    with pytest.raises(SystemExit, match="exit status 2"):
        whole_road.step("mgsgraph solve PROJECT", [], tmp_path)


def test_a_model_that_lies_off_is_found_where_it_is() -> None:
    def truth(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 40.0 * np.sin(x / 300.0) + 25.0 * np.cos(y / 200.0)

    rng = np.random.default_rng(0)
    x, y = rng.uniform(-2e3, 2e3, (2, 5000))
    heights = truth(x - 20.0, y + 30.0) + 7.0 + 3.0 * y / 2e3 + 0.5 * rng.standard_normal(x.size)
    moved, left = whole_road.laid_on(truth, x, y, heights)
    np.testing.assert_allclose(moved, [20.0, -30.0, 7.0], atol=0.5)
    assert left == pytest.approx(0.5, rel=0.05)


def test_the_page_is_the_script_s() -> None:
    page = whole_road.PAGE.read_text(encoding="utf-8")
    site = plain_site()
    assert "\n".join(["```sh", *whole_road.commands(site), "```"]) in page
