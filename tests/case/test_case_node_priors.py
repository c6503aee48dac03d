"""[[passes]] with a `prior` in a case file: images of one camera."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mex import FOLDER, LINES, kernels, times_file
from strip_files import STRIPS, block, write_block

import mgsgraph
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.case.motion import NodePriorInput, NodesInput
from mgsgraph.case.reading import adjust
from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.network import NodePrior, Pass
from mgsgraph.network.joining import alike, mountings, seconds, straightest
from mgsgraph.project.project import open_project
from mgsgraph.units import MGON, MRAD


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("block")
    write_block(path)
    return path


def case_with(folder: Path, strips: str, name: str = "other.toml") -> Path:
    """The block's case with other strips."""
    text = (folder / "case.toml").read_text(encoding="utf-8")
    assert text.endswith(STRIPS)
    path = folder / name
    path.write_text(text.removesuffix(STRIPS) + strips, encoding="utf-8")
    return path


def pass_of(folder: Path, table: str) -> Pass:
    """The first strip alone, `table` being what follows its name."""
    images = 'images = ["HRSC/00/S1", "HRSC/00/P1", "HRSC/00/ND", "HRSC/00/P2", "HRSC/00/S2"]'
    table += "" if "prior" in table else "\nprior = {}"
    return mgsgraph.read_case(case_with(folder, f'[[passes]]\nname = "one"\n{images}\n{table}\n')).network.passes[0]


def prior_of(folder: Path, table: str) -> NodePrior:
    prior = pass_of(folder, f"prior = {{ {table} }}").prior
    assert isinstance(prior, NodePrior)
    return prior


def test_the_case_is_the_block(folder: Path) -> None:
    """Read from its files, with the defaults that the block was drawn with: the same strips, cost and places."""
    case, net = mgsgraph.read_case(folder / "case.toml"), block().network
    for read, made in zip(case.network.passes, net.passes, strict=True):
        assert (read.name, read.images.tolist()) == (made.name, made.images.tolist())
        assert isinstance(read.prior, NodePrior)
        assert isinstance(made.prior, NodePrior)
        for part in ("sigmas", "bias", "drift", "correlation_time"):
            np.testing.assert_allclose(getattr(read.prior, part), getattr(made.prior, part), rtol=1e-12)
        np.testing.assert_allclose(read.nodes.times + read.nodes.epoch, made.nodes.times + made.nodes.epoch, atol=1e-6)
    assert [image.timing.periods.size for image in case.network.images] == [3] * 10
    got, want = adjust(case), adjust_network(net, case.settings)
    assert got.cost_final == pytest.approx(want.cost_final, rel=1e-6)
    np.testing.assert_allclose(got.places, want.places, atol=0.01)
    assert not np.any(case.network.held)


# --- where the nodes stand


def test_spacing_in_seconds_and_lines(folder: Path) -> None:
    """Lines are those of the nadir image, by its own mean period; nodes reach from the first line to the last."""
    pictures = block().network.images[:5]
    edges = np.array([seconds(image) for image in pictures])
    assert straightest(pictures) == 2
    start, stop = seconds(pictures[2])
    for table, spacing in (
        ("spacing_s = 4.0", 4.0), ("spacing_lines = 1500", 1500 * (stop - start) / pictures[2].lines), ("", 10.0)
    ):
        nodes = pass_of(folder, f"nodes = {{ {table} }}").nodes
        times = nodes.times + nodes.epoch
        step = np.diff(times)
        np.testing.assert_allclose(times[[0, -1]], [edges[:, 0].min(), edges[:, 1].max()], atol=1e-6)
        np.testing.assert_allclose(step, step[0], rtol=1e-6)
        assert step[0] <= spacing * (1.0 + 1e-9)
        assert (times[-1] - times[0]) / (step.size - 1) > spacing or step.size == 3  # one fewer would be too few


# --- what is known beforehand


def test_units_of_the_prior(folder: Path) -> None:
    prior = prior_of(
        folder,
        "position_sigma_m = [2.0, 3.0, 4.0], angle_sigma_mrad = 0.01, angle_bias_sigma_mrad = [0.5, 0.0, 0.25], "
        "position_drift_sigma_m = 0.0, angle_drift_sigma_mrad = 0.1, correlation_time_s = 0",
    )
    np.testing.assert_allclose(prior.sigmas, [2.0, 3.0, 4.0, *[0.01 * MRAD] * 3])
    np.testing.assert_allclose(prior.bias, [50.0, 50.0, 50.0, 0.5 * MRAD, 0.0, 0.25 * MRAD])
    np.testing.assert_allclose(prior.drift, [0.0, 0.0, 0.0, *[0.1 * MRAD] * 3])
    assert prior.correlation_time == 0.0


def test_defaults_give_way_where_nodes_know_nothing() -> None:
    prior = NodePriorInput(position_sigma_m=float("inf")).prior("here")
    assert np.all(np.isinf(prior.sigmas[:3]))
    assert prior.bias[:3].tolist() == prior.drift[:3].tolist() == [0.0] * 3
    assert np.all(prior.bias[3:] == pytest.approx(28.0 * MGON))
    with pytest.raises(InputError, match=r"here: node prior, bias: sigma 5.0 of component 0 whose nodes have none"):
        NodePriorInput(position_sigma_m=float("inf"), position_bias_sigma_m=5.0).prior("here")


# --- what is wrong, in one line

ONE = '[[passes]]\nname = "one"\nimages = ["HRSC/00/S1", "HRSC/00/ND"]\n'
TWO = '[[passes]]\nname = "two"\n'
WRONG = {
    "unknown image": (ONE.replace("00/S1", "00/S9"), r"passes\[0\], images: the image 'HRSC/00/S9'; expected some of"),
    "in two strips": (ONE + TWO + 'images = ["HRSC/00/ND"]', r"passes\[1\], images: 'HRSC/00/ND', which pass 'one'"),
    "two passes": (TWO, r"passes\[0\]: images HRSC/00/.. and HRSC/01/.., 39\d minutes apart; expected images of one"),
    "an unknown unit": (ONE + "nodes = { spacing_km = 3 }", r"passes\[0\]\.nodes.*'spacing_km'.*'spacing_s'"),
    "a basis": (ONE + 'nodes = { basis = "lagrange" }', "basis: a word of earlier versions"),
    "long spacing": (ONE + "nodes = { spacing_s = 3000 }", r"nodes, spacing_s: 3000 s; expected less than"),
    "a slip in the unit": (ONE + "nodes = { spacing_s = 1e-4 }", "at most 10000 nodes"),
    "times": (ONE + "nodes = { times_et_s = [1, 2, 3, 4] }", "times_et_s: a word of earlier .* spacing_s, or"),
}  # fmt: skip


@pytest.mark.parametrize("fault", WRONG)
def test_one_clear_line(folder: Path, fault: str) -> None:
    strips, message = WRONG[fault]
    strips += "" if "prior" in strips else "\nprior = {}"
    path = case_with(folder, strips)
    with pytest.raises(InputError, match=message) as caught:
        mgsgraph.read_case(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "HRSC/00/ND"', 'name = "HRSC/00/ND"\nheld = true', "image HRSC/00/ND, which is held"),
        ('name = "HRSC/00/ND"', 'name = "HRSC/00/ND"\norientation = { degree = 1 }', "an orientation table of its own"),
        ("[ties]", '[orientation]\nnominal = "polynomial"\n[ties]', "nominal = 'polynomial'; expected the trajectory"),
    ],
)
def test_what_contradicts_a_strip(folder: Path, old: str, new: str, message: str) -> None:
    path = case_with(folder, f"{ONE}prior = {{}}")
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        mgsgraph.read_case(path)
    assert str(caught.value).startswith(f"{path}, passes[0] (one)")


def test_cameras_of_one_pass_are_mounted_as_their_attitudes_say() -> None:
    """Alike; turned by 0.02 rad at the same time; 5 km away; turning against each other."""
    one, other = block().network.images[:2]
    assert mountings([one, other], "here") is None
    assert isinstance(other.trajectory, Trajectory)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(0.02), np.sin(0.02)], [0.0, -np.sin(0.02), np.cos(0.02)]])

    def with_table(**tables: object) -> PushbroomImage:
        return replace(other, trajectory=replace(other.trajectory, **tables))  # type: ignore[type-var]

    camera = other.trajectory.camera
    turned = with_table(camera=replace(camera, constant=turn @ camera.constant))
    axes = mountings([one, turned], "here")
    assert axes is not None
    np.testing.assert_allclose(axes, [np.eye(3), turn], atol=1e-5)
    table = other.trajectory.position
    moved = with_table(position=replace(table, positions=table.positions + np.array([5e3, 0.0, 0.0])))
    with pytest.raises(InputError, match=r"5000 m apart"):
        mountings([moved, one], "here")
    still = replace(camera, quaternions=np.broadcast_to(camera.quaternions[:1], camera.quaternions.shape))
    with pytest.raises(InputError, match=r"turn against each other"):
        mountings([one, with_table(camera=replace(still, constant=turn @ turn))], "here")


# --- HRSC by labels


def test_labels_of_one_pass_make_a_pass(shared_data: Path, tmp_path: Path) -> None:
    """Of the real kernels; each label has a trajectory of its own, which is the others' as far as both reach."""
    label = (shared_data / FOLDER / "h5270_0000_ir2_pds3.lbl").read_text()
    times_file(tmp_path)
    names = ("IR", "NADIR")
    text = ["format = 1", 'name = "h5270"', "[ground_control]", 'file = "points.gcp"', "[spice]", "sampling_s = 0.5"]
    text.append(f"kernels = {[str(path) for path in kernels(shared_data)]}")
    for name in names:
        (tmp_path / f"{name}.lbl").write_text(label.replace("MEX_HRSC_IR", f"MEX_HRSC_{name}"))
        text += ["[[images]]", f'name = "{name}"', f'label = "{name}.lbl"', 'line_times = "line_times.csv"']
    text.append("focal_length_m = 0.17")  # of the nadir line alone
    (tmp_path / "points.gcp").write_text("G1 20.0 77.6 0.0 1 1 1 IR 100 200 1 1 NADIR 300 400 1 1\n")
    path = tmp_path / "case.toml"
    path.write_text("\n".join(text))
    apart = mgsgraph.read_case(path).network.images
    text += ["[[passes]]", "prior = {}", 'name = "h5270"', "nodes = { spacing_lines = 1000 }"]
    path.write_text("\n".join(text))
    net = mgsgraph.read_case(path).network

    assert [image.name for image in net.images] == list(names)
    assert net.images[0].interior.focal_length == pytest.approx(0.17482)
    assert net.images[1].interior.focal_length == 0.17
    places = np.array([0.0, 7000.3, LINES]), np.array([3.0, 600.0, 1288.0])
    for one, alone in zip(net.images, apart, strict=True):
        np.testing.assert_allclose(one.image_to_ground(*places)[0], alone.image_to_ground(*places)[0], atol=1e-4)
    assert len(net.passes[0].nodes) == 17  # 15,088 lines in 16 intervals


# --- in projects


def test_projects_keep_them(folder: Path, tmp_path: Path) -> None:
    """The project's network is the case's, pass by pass."""
    group(["init", str(tmp_path / "project"), "--case", str(folder / "case.toml")], standalone_mode=False)
    with open_project(tmp_path / "project") as project:
        kept = project.store.network()
    wanted = mgsgraph.read_case(folder / "case.toml").network
    assert len(kept.points) == len(wanted.points)
    for one, other in zip(kept.passes, wanted.passes, strict=True):
        assert [kept.images[j].name for j in one.images] == [wanted.images[j].name for j in other.images]
        np.testing.assert_array_equal(one.nodes.times, other.nodes.times)
        assert alike(one.prior, other.prior)


def test_the_spacing_is_said_once() -> None:
    with pytest.raises(InputError, match="here: spacing_s and spacing_lines; expected one of them"):
        NodesInput(spacing_lines=10.0, spacing_s=1.0).images((), "here")
