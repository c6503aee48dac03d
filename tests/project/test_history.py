"""Any sequence of changes of a project: its content and its decisions are what a plain model says, undo and redo
included, and what it holds adjusts as a batch of the same content does.
"""

import os
import shutil
import tempfile
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from increments import NOISE, fan, network_of
from outside import refuses
from pass_files import write_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.errors import InputError, MgsgraphError
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.network import Network, PointClass
from mgsgraph.network.parts import select_points
from mgsgraph.project import edits, history
from mgsgraph.project.addition import ImageArgument, read_addition
from mgsgraph.project.changes import add, create_project, remove_images, solve_project
from mgsgraph.project.decisions import Measure
from mgsgraph.project.project import Project, open_project
from mgsgraph.simulation.strip import SimulatedStrip
from mgsgraph.units import MRAD

Ray = tuple[str, str]
Value = tuple[float, float, float]
"""Line, sample and sigma, px."""
IMAGES = tuple(f"FAN/{k}" for k in range(3))
SETTINGS = f"""
[orientation]
position_sigma_m = {NOISE.position}
angle_sigma_mrad = {NOISE.angle / MRAD}
trend = {list(NOISE.trend)}
"""


@cache
def files() -> Path:
    """A case of the first two images, support data of the third, and a control network of all three."""
    folder = Path(tempfile.mkdtemp(prefix="mgsgraph-history-"))
    made = fan(3, ties=10)
    (folder / "all").mkdir()
    (folder / "two").mkdir()
    write_network(folder / "all", ties_of(made, 3), SETTINGS)
    case = write_network(folder / "two", ties_of(made, 2), SETTINGS)
    for name in ("unsolved", "solved"):
        create_project(folder / name, case=case)
    with open_project(folder / "solved", write=True) as project:
        solve_project(project, figures=False)
    return folder


def ties_of(made: SimulatedStrip, count: int) -> Network:
    """Tie points of the first images."""
    network = network_of(made, range(count))
    return select_points(network, np.flatnonzero(network.points.classes == PointClass.TIE))


@cache
def base() -> dict[Ray, Value]:
    """Measurements of the control network."""
    ties = read_tie_points(files() / "all" / "network.pvl")
    rows = zip(ties.measure_point.tolist(), ties.measure_image, ties.measures.tolist(), strict=True)
    sigmas = ties.measure_sigmas[:, 0].tolist()
    return {(ties.ids[i], image): (*place, sigma) for (i, image, place), sigma in zip(rows, sigmas, strict=True)}


@dataclass
class Model:
    """What a project should hold."""

    images: list[str] = field(default_factory=lambda: list(IMAGES[:2]))
    rays: dict[Ray, Value] = field(default_factory=dict)
    removed: set[str] = field(default_factory=set)
    measured: dict[Ray, Value] = field(default_factory=dict)
    rejected: dict[Ray, Value] = field(default_factory=dict)

    def give(self, new: list[str], with_network: bool) -> None:
        """Images come, and the control network may be given (again)."""
        points = {point for point, _ in self.rays}
        self.images += new
        for point in sorted({point for point, _ in base()}) if with_network else ():
            rays = {ray: value for ray, value in base().items() if ray[0] == point}
            shown = {ray: value for ray, value in rays.items() if ray[1] in self.images}
            if point in self.removed or (len(shown) < len(rays) and len(shown) < (1 if point in points else 2)):
                continue
            for ray, value in shown.items():
                if ray not in self.rejected:
                    self.rays[ray] = self.measured.get(ray, value)
        for ray, value in self.measured.items():
            if ray[1] in new and ray not in self.rejected:
                self.rays.setdefault(ray, value)

    def forget(self, point: str) -> None:
        """A point is removed."""
        for rays in (self.rays, self.measured, self.rejected):
            for ray in [ray for ray in rays if ray[0] == point]:
                del rays[ray]
        self.removed.add(point)


def held(project: Project) -> dict[Ray, Value]:
    """Measurements that a project holds."""
    if not project.store.members():
        return {}
    network = project.store.network()
    names = network.image_names
    rows = zip(network.rays.point.tolist(), network.rays.image.tolist(), strict=True)
    values = np.column_stack([network.rays.places, network.rays.sigmas[:, 0]]).tolist()
    return {(network.points.ids[i], names[j]): tuple(value) for (i, j), value in zip(rows, values, strict=True)}


class Changes(RuleBasedStateMachine):
    """Changes as users make them, each in a transaction of its own."""

    folder: Path
    model: Model

    @initialize(kind=st.sampled_from(["unsolved", "solved"]))
    def begin(self, kind: str) -> None:
        root = "/dev/shm" if Path("/dev/shm").is_dir() else None
        self.parent = Path(tempfile.mkdtemp(prefix="mgsgraph-history-", dir=root))
        self.folder = Path(shutil.copytree(files() / kind, self.parent / "project"))
        with open_project(self.folder) as project:
            self.model = Model(rays=held(project))
        self.before, self.undone, self.made = list[Model](), list[Model](), 0

    def change(self, act: Any, update: Any) -> None:
        """Carry out a change in the project and in the model; what is refused changes neither."""
        after = deepcopy(self.model)
        update(after)
        with open_project(self.folder, write=True) as project:
            act(project)
        self.before.append(self.model)
        self.model, self.undone = after, []

    def absent(self) -> list[str]:
        return [name for name in IMAGES if name not in self.model.images]

    @precondition(lambda self: self.absent())
    @rule(data=st.data(), with_network=st.booleans())
    def add(self, data: st.DataObject, with_network: bool) -> None:
        name = data.draw(st.sampled_from(self.absent()))
        image = ImageArgument(files() / "all" / f"{name.replace('/', '_')}.isd", name)
        ties = [files() / "all" / "network.pvl"] if with_network else []

        def act(project: Project) -> None:
            add(project, read_addition(project, [image], ties, []))

        after = deepcopy(self.model)
        after.give([name], with_network)
        enough = [point for point in {point for point, _ in base()} if sum(
            ray in base() for ray in ((point, image) for image in after.images)) > 1]  # fmt: skip
        if with_network and not enough and not self.model.rays:
            with pytest.raises(InputError), open_project(self.folder, write=True) as project:
                act(project)
            return
        self.change(act, lambda model: model.give([name], with_network))

    @precondition(lambda self: len(self.model.images) > 1)
    @rule()
    def give_network_again(self) -> None:
        def act(project: Project) -> None:
            add(project, read_addition(project, [], [files() / "all" / "network.pvl"], []))

        self.change(act, lambda model: model.give([], True))

    @precondition(lambda self: self.model.images)
    @rule(data=st.data())
    def remove_image(self, data: st.DataObject) -> None:
        name = data.draw(st.sampled_from(self.model.images))

        def update(model: Model) -> None:
            model.images.remove(name)
            model.rays = {ray: value for ray, value in model.rays.items() if ray[1] != name}

        self.change(lambda project: remove_images(project, [name]), update)

    @precondition(lambda self: self.model.rays)
    @rule(data=st.data(), kind=st.sampled_from(["reject", "move", "new", "remove"]))
    def edit(self, data: st.DataObject, kind: str) -> None:
        point, image = ray = data.draw(st.sampled_from(sorted(self.model.rays)))
        line, sample, sigma = self.model.rays[ray]
        sample = sample - 0.25 if sample > 1.0 else sample + 0.25
        if kind == "reject":

            def reject(model: Model) -> None:
                model.rejected[ray] = model.rays.pop(ray)

            self.change(lambda project: edits.reject(project, point, image), reject)
        elif kind == "move":

            def move(model: Model) -> None:
                model.rays[ray] = model.measured[ray] = line, sample, sigma

            self.change(lambda project: edits.move(project, point, image, line, sample), move)
        elif kind == "new":
            self.made += 1
            hand = f"HAND{self.made}"
            rays = {(hand, name): self.model.rays[point, name] for name in IMAGES if (point, name) in self.model.rays}

            def measure(model: Model) -> None:
                model.rays |= rays
                model.measured |= rays

            measures = [Measure(name, *value, value[2]) for (_, name), value in rays.items()]
            self.change(lambda project: edits.measure(project, hand, measures), measure)
        else:
            self.change(lambda project: edits.remove_point(project, point), lambda model: model.forget(point))

    def rejected_here(self) -> list[Ray]:
        return sorted(ray for ray in self.model.rejected if ray[1] in self.model.images)

    @precondition(lambda self: self.rejected_here())
    @rule(data=st.data())
    def accept(self, data: st.DataObject) -> None:
        ray = data.draw(st.sampled_from(self.rejected_here()))

        def update(model: Model) -> None:
            model.rays[ray] = model.rejected.pop(ray)

        self.change(lambda project: edits.accept(project, *ray), update)

    @rule()
    def undo(self) -> None:
        self.back(history.undo, self.before, self.undone)

    @rule()
    def redo(self) -> None:
        self.back(history.redo, self.undone, self.before)

    def back(self, act: Any, given: list[Model], taken: list[Model]) -> None:
        with open_project(self.folder, write=True) as project:
            if not given:
                refuses("no change to", act, project)
                return
            act(project)
        taken.append(self.model)
        self.model = given.pop()

    @rule()
    def solve(self) -> None:
        """Where the content determines an adjustment, its cost is that of a batch of the same content."""
        with open_project(self.folder) as project:
            network = project.store.network() if project.store.members() else None
            chosen = project.settings.solver.settings
        try:
            batch = None if network is None else adjust_network(network, chosen)
        except MgsgraphError:
            batch = None
        if batch is None:
            return
        with open_project(self.folder, write=True) as project:
            solution = solve_project(project, figures=False).solution
        assert solution.cost_final == pytest.approx(batch.cost_final, rel=1e-9, abs=1e-12)

    @invariant()
    def content_and_decisions_are_those_of_the_model(self) -> None:
        with open_project(self.folder) as project:
            assert sorted(project.store.image_names()) == sorted(self.model.images)
            assert held(project) == self.model.rays
            stands = project.standing_decisions()
        assert {point for point, of in stands.items() if of.removed} == self.model.removed
        for expected, name in ((self.model.measured, "measured"), (self.model.rejected, "rejected")):
            found = {(point, image): (one.line, one.sample, one.sigma_line) for point, of in stands.items()
                     for image, one in getattr(of, name).items()}  # fmt: skip
            assert found == expected

    def teardown(self) -> None:
        if hasattr(self, "parent"):
            shutil.rmtree(self.parent)


@pytest.mark.slow
def test_any_sequence_of_changes() -> None:
    """MGSGRAPH_SEQUENCES: how many, 2,000 for a release."""
    run_state_machine_as_test(
        Changes,
        settings=settings(
            max_examples=int(os.environ.get("MGSGRAPH_SEQUENCES", "40")), stateful_step_count=12, deadline=None,
            suppress_health_check=list(HealthCheck), print_blob=False,
        ),
    )  # fmt: skip
