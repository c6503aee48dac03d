"""The demo of each study site against its truth, and its words, tables and figures against its records."""

import json
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.network import PointClass
from mgsgraph.simulation.demo import demonstration
from mgsgraph.simulation.demo.demonstration import (
    DEMONSTRATED,
    DRAWING,
    KERNELS,
    PAIR,
    RELIEF,
    STAGES,
    TIES,
    Demonstration,
    demonstrate,
    overall,
    simulation_options,
)
from mgsgraph.simulation.demo.summary import (
    closing_lines,
    demo_statements,
    summary_json,
)
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.text import root_mean_square

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=SITE_NAMES)
def demo(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Demonstration:
    folder = tmp_path_factory.mktemp(request.param)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demonstration, "has_opencv", lambda: False)
        return demonstrate(request.param, folder, 1, simulation_options(request.param, pictures=False))


def test_misregistration_is_seen_before_and_gone_after(demo: Demonstration) -> None:
    for before, after in zip(demo.registration.before, demo.registration.after, strict=True):
        for one, two in zip(before.discrepancies, after.discrepancies, strict=True):
            assert root_mean_square(np.linalg.norm(one.metres, axis=1)) > 5.0 * root_mean_square(
                np.linalg.norm(two.metres, axis=1)
            )
            assert root_mean_square(two.pixels[:, 0]) < 1.0
    for one in summary_json(demo)["orientation"]:
        assert max(*one["largest_sigmas_position"], *one["largest_sigmas_rotation"]) < 3.5


def test_summary_holds_the_figures(demo: Demonstration) -> None:
    record = summary_json(demo)
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert record["sigma0"] == demo.solution.sigma0
    assert set(record["seconds"]) == set(STAGES) - {RELIEF, DRAWING}
    shifts = {one["name"]: one["true_m"] for one in record["shifts"]}
    for image in demo.simulated.images:
        assert shifts[image.settings.profile] == (-image.profile.shift).tolist()
    assert [one["position_m"] for one in record["put_in"]] == [
        image.errors.position[0].tolist() for image in demo.simulated.images
    ]
    rows = record["disagreement"]
    assert {(one["state"], one["profile"], one["image"]) for one in rows} == {
        (state, image.settings.profile, other.true.name)
        for state in (KERNELS, TIES) for image in demo.simulated.images for other in demo.simulated.images
    }
    for row, one in zip(rows, demo.disagreements, strict=True):
        assert row["rms_m"] == pytest.approx(np.sqrt(np.mean(np.sum(one.found.metres**2, axis=1))))
    for one, image in zip(record["orientation"], demo.simulated.images, strict=True):
        assert one["image"] == image.true.name
        assert np.linalg.norm(one["error_after_mean_m"]) < np.linalg.norm(one["error_before_mean_m"])


def test_errors_before_are_those_put_in(demo: Demonstration) -> None:
    """The mean over an image of a + b u + c u^2 is a + c / 3, but for the ends' share in 31 places."""
    for one, image in zip(summary_json(demo)["orientation"], demo.simulated.images, strict=True):
        errors = image.errors.position
        size = np.linalg.norm(one["error_before_mean_m"])
        assert size == pytest.approx(np.linalg.norm(errors[0] + errors[2] / 3.0), abs=1.0)


def test_disagreements_are_within_what_is_predicted(demo: Demonstration) -> None:
    for one in demo.disagreements:
        assert one.state in {KERNELS, TIES}
        if one.state == TIES:
            assert np.all(np.abs(one.found.metres.mean(axis=0)) < 4.0 * one.sigmas)
            assert one.rms == pytest.approx(np.linalg.norm(one.found.metres.mean(axis=0)), rel=0.5)
    size, predicted = overall(demo.disagreements, TIES)
    assert 50.0 < predicted < 400.0
    assert size < 4.0 * predicted


def test_words_say_what_was_wrong_and_what_is_right(demo: Demonstration) -> None:
    text = demo_statements(demo)
    for state in (KERNELS, TIES):
        assert f"{overall(demo.disagreements, state)[0]:.0f} m" in text[0]
    assert "mgsgraph[match]" in str(demo.relief)
    assert str(demo.relief) in text[0]
    for point_class in (PointClass.TIE, PointClass.LASER):
        assert sum(one.startswith(f"Truth, {point_class.name.lower()} points") for one in text) == 1
    lines = closing_lines(demo)
    assert lines[0] == text[0]
    for image in demo.simulated.images:
        assert sum(image.true.name in line for line in lines) > 3
    assert max(len(line) for line in lines if not line.startswith(("- ", text[0]))) < 120


def test_sources_are_named_from_the_results(demo: Demonstration) -> None:
    """Results are written beside their final place, whose name they must not keep."""
    network, folder = demo.case.network, demo.case.path.parent
    assert network.surface is not None
    assert network.areoid is not None
    sources = [network.surface.grid.source, network.areoid.source, *(shots.source for shots in demo.case.profiles)]
    assert [one.lattice.source for one in demo.case.terrain] == sources[:1]  # by which both are known to be one model
    assert all(source.startswith(f"{folder.name}/") for source in sources)
    assert not any(str(folder) in source for source in sources)


def test_sites_and_options_are_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="eos, gusev, isidis or pair"):
        simulation_options("olympus", known=DEMONSTRATED)
    with pytest.raises(InputError, match="attitude time bias"):
        simulation_options(PAIR, 0.5)
    with pytest.raises(InputError, match="attitude_time_bias"):
        simulation_options("gusev", float("nan"))
    assert simulation_options("gusev", 0.95).attitude_time_bias == 0.95
