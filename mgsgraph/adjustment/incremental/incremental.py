"""Incremental adjustment: images are added and removed, iSAM2 holds the shared unknowns, points stay in bundles."""

import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.incremental.engine import Engine
from mgsgraph.adjustment.incremental.impact import BatchCheck, Impact, differences_from_batch, impact
from mgsgraph.adjustment.incremental.state import (
    ImagesByName,
    InMemory,
    Settled,
    Shared,
    StateStore,
    image_motion,
    require_one_body,
    shared_by_images,
    shared_image,
    shared_of,
    shared_pass,
    shared_shift,
    with_addition,
    with_points,
    without,
)
from mgsgraph.adjustment.incremental.sweep import Sweep
from mgsgraph.adjustment.incremental.trajectories import extended, shortened, turned_bundles, unknowns_of
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.names import number_of, numbered
from mgsgraph.network import Network
from mgsgraph.network.corrections import whole_correction
from mgsgraph.network.joining import Definitions, definitions, with_definitions
from mgsgraph.network.observations import build_network
from mgsgraph.network.parts import (
    ByUnknown,
    KnownImage,
    Members,
    Unknown,
    alone,
    known_images,
    require_separable,
    unknowns,
    with_images,
)
from mgsgraph.record import Record, card
from mgsgraph.units import ARCSEC
from mgsgraph.workers import no_progress

if TYPE_CHECKING:
    from mgsgraph.adjustment.settings import Progress
    from mgsgraph.adjustment.solution import Solution

Observations = TiePoints | LaserProfile | Sequence[TiePoints | LaserProfile]


class IncrementalAdjustment(Record):
    """Images and their observations, adjusted as they come.

    Parameters
    ----------
    settings : SolverSettings, optional
        Measurement model and loss; the defaults when absent. Blunders are sought by batch alone (`close`).
    store : StateStore, optional
        Where the state lies; in memory when absent.

    Examples
    --------
    >>> adjustment = mgsgraph.IncrementalAdjustment.of(solution)
    >>> impact = adjustment.remove("SIM/B")
    >>> adjustment.images, adjustment.covariance("SIM/A").shape
    (['SIM/A'], (18, 18))
    """

    def __init__(self, settings: SolverSettings | None = None, store: StateStore | None = None) -> None:
        self.settings = settings or SolverSettings()
        self.store: StateStore = InMemory() if store is None else store
        self._engine = Engine(self.settings, self.store)

    @classmethod
    def of(cls, solution: "Solution", store: StateStore | None = None) -> "IncrementalAdjustment":
        """An incremental adjustment that begins with a batch solution."""
        incremental = cls(solution.settings, store)
        incremental.adopt(solution)
        return incremental

    def __repr__(self) -> str:
        return f"IncrementalAdjustment({len(self.images)} images, {len(self.store.members())} bundles of points)"

    def _repr_html_(self) -> str:
        """For notebooks: each image with the sigmas of its constant term."""
        rows = [("image", "position", "pointing"), ("", "m", "arcsec")]
        for name in self.images:
            if (state := self._engine.shared.get(Unknown("image", name))) is None:
                rows.append((name, "held", "held"))
                continue
            position, pointing = (float(np.linalg.norm(part)) for part in np.split(state.sigmas[:6], 2))
            rows.append((name, f"{position:.3g}", f"{pointing / ARCSEC:.3g}"))
        return card(repr(self), ["Sigmas of the images' position and pointing, as they were last looked at."], rows, 2)

    # --- what may be asked

    @property
    def images(self) -> list[str]:
        """Names of all images, in the order in which they came."""
        return self.store.image_names()

    @property
    def values(self) -> ByUnknown:
        """Present values (d,) of all shared unknowns, m and rad."""
        return dict(self._engine.value)

    def correction(self, image: str | int) -> OrientationCorrection:
        """Present orientation correction of an image, with what shared unknowns do to it; zero for a held one."""
        known_image = self._known(image)
        network = with_definitions(alone(known_image), self._engine.known)
        orientation, value = Unknown("image", known_image.image.name), self._engine.value
        zero = np.zeros(network.priors[0].sigmas.size)
        held = network.held[0]
        values = [zero if held and name == orientation else value.get(name, zero) for name in unknowns(network)]
        return whole_correction(network, 0, values, self.settings.angles)

    def covariance(self, *images: str | int) -> Array:
        """Joint covariance (d, d) of the coefficients of some images, m and rad, straight from iSAM2."""
        names = [self._known(image).image.name for image in images]
        for image in names:
            require(not self._known(image).held, f"image {image}", "held: it has no unknowns", "an adjusted image")
            if (pass_ := self._engine.known.of_image(image)) is not None:
                problem, remedy = f"of pass {pass_.name!r}: it has no coefficients of its own", "ask for `joint`"
                raise InputError(f"image {image}", problem, "an image with an orientation of its own", remedy)
        return self._engine.joint([Unknown("image", image) for image in names])

    def joint(self, wanted: Sequence[Unknown]) -> Array:
        """Joint covariance (d, d) of some adjusted unknowns, m and rad, straight from iSAM2."""
        return self._engine.joint(wanted)

    def points(self, ids: Sequence[str] | None = None) -> tuple[tuple[str, ...], Array, Array]:
        """Names, places (n, 3) in m and covariances (n, 3, 3) in m^2 of points, refreshed; all of them when absent.

        Undetermined points have NaN. Raises InputError for an unknown name.
        """
        wanted = set(self.store.members()) if ids is None else set(self.store.bundles_of(ids).values())
        fresh = list(self._engine.refreshed(sorted(wanted)).values())
        names = tuple(name for bundle in fresh for name in bundle.network.points.ids)
        places = np.concatenate([np.zeros((0, 3)), *(bundle.places for bundle in fresh)])
        covariances = np.concatenate([np.zeros((0, 3, 3)), *(bundle.covariances for bundle in fresh)])
        if ids is None:
            return names, places, covariances
        where = numbered(names)
        for name in ids:
            require(name in where, f"point {name}", "no such point", "one of the adjustment's")
        chosen = [where[name] for name in ids]
        return tuple(ids), places[chosen], covariances[chosen]

    @property
    def network(self) -> Network:
        """Everything as one network, images in the order in which they came."""
        return self._as_network()[0]

    def as_network(self) -> tuple[Network, Array]:
        """Everything as one network, and the places (n, 3) in m of its points, refreshed; NaN where undetermined."""
        network, stored = self._as_network()
        return network, Sweep(network, self.settings, stored).places(self._engine.value)

    def _as_network(self) -> tuple[Network, Array]:
        """All of it as one network, and the places (n, 3) in m of its points as they are in store."""
        require(self.store.members(), "incremental adjustment", "no points", "observations in at least one image")
        return self.store.as_network()

    # --- what may be done

    def add(
        self,
        images: Network | PushbroomImage | KnownImage | Sequence[KnownImage],
        observations: Observations = (),
        prior: OrientationPrior | None = None,
        tie_sigma: float = 1.0,
        shot_sigma: float = 30.0,
        brought: Definitions | None = None,
    ) -> Impact:
        """Add images with their observations (and observations of known points in other images).

        Parameters
        ----------
        images : Network, PushbroomImage, KnownImage, or several of the latter
            A network brings its observations with it; those of its images that are known already are not new.
        observations : TiePoints, LaserProfile, or several
            Known points are named by their ids, with their new measures.
        prior : OrientationPrior, optional
            Of a PushbroomImage; that of the image added last when absent.
        tie_sigma, shot_sigma : float
            px, of the image coordinates of tie points for which their file says nothing, and of laser footprints.
        brought : Definitions, optional
            Passes and shared unknowns that new images join or begin; those of the network when absent. The trajectory
            of a pass that is there is continued over the lines of its new images, on its own grid.

        Raises
        ------
        InputError
            When an image is there already, a measure names an unknown image or is there already, or parts contradict.
        PointBehindCamera
            With the nominal orientation of a new image. In all cases nothing has changed then.
        """
        if isinstance(images, Network):
            require_separable(images)
            present = set(self.images)
            named = ((known_image.image.name, known_image) for known_image in known_images(images))
            all_images = [self.store.image(name) if name in present else known_image for name, known_image in named]
            more = [known_image for known_image in all_images if known_image.image.name not in present]
            # a network does not change priors of images that are in the adjustment
            brought = definitions(images) if brought is None else brought
            return self._added(more, with_images(with_definitions(images, Definitions()), all_images), brought)
        new = self._new_images(images, prior)
        batches = [observations] if isinstance(observations, TiePoints | LaserProfile) else list(observations)
        return self._added(new, build_network(ImagesByName(self.store, new), batches, tie_sigma, shot_sigma), brought)

    def remove(self, *images: str | int) -> Impact:
        """Remove images with their measures, and points that no other image sees.

        Raises InputError for an unknown image.
        """
        names = tuple(dict.fromkeys(self._known(image).image.name for image in images))
        before = self.store.definitions()
        after = shortened(self.store, before, names)
        changed = without(self.store, names, after, turned_bundles(self.store, before, after))
        return self._change("remove", names, (), *changed, after, names)

    def resume(self, store: StateStore) -> None:
        """Continue with a store that holds the same state, opened again."""
        self.store = store
        self._engine.resume(store)

    def replace_points(
        self,
        ids: Sequence[str],
        network: Network | None,
        verb: str = "edit",
        new: Sequence[KnownImage] = (),
        removed: Sequence[str] = (),
        definitions: Definitions | None = None,
    ) -> Impact:
        """Replace points, with all of their rows, by those of a network; bring and remove images with them.

        Parameters
        ----------
        ids : sequence of str
            Names of these points.
        network : Network or None
            With images of the adjustment and new ones; None removes the points.
        verb : str
            The name of the change in its report.
        new : sequence of KnownImage
            Images that come with the points.
        removed : sequence of str
            Names of images that no other point depends on, to be removed.
        definitions : Definitions, optional
            Passes and shared unknowns from now on; as they are when absent.

        Raises
        ------
        InputError
            When parts contradict each other; nothing has changed then.
        """
        before = self.store.definitions()
        after = before if definitions is None else definitions
        changed = with_points(self.store, ids, network, after, turned_bundles(self.store, before, after))
        return self._change(verb, [image.image.name for image in new], new, *changed, after, removed)

    def verify(self, name: str = "adjustment", progress: "Progress" = no_progress) -> tuple[BatchCheck, "Solution"]:
        """The check against batch: a batch adjustment of everything, from the nominal orientation, and its differences.

        Where one is larger than `EXACT` sigmas, the batch result replaces the incremental one.
        """
        from mgsgraph.adjustment.adjust import adjust_network  # a whole batch solver, which changes do without

        network, places = self.as_network()
        solution = adjust_network(network, replace(self.settings, starts=0), name, progress)
        check = differences_from_batch(solution, self._engine.value, places)
        if check.adopted:
            self.adopt(solution)
        return check, solution

    def adopt(self, solution: "Solution") -> None:
        """Replace the state by a batch solution: its images, points and unknowns."""
        engine = self._engine
        rejected = solution.rays_rejected, solution.ranges_rejected, solution.stereo_rejected
        network = solution.network.with_rejected(*rejected)
        present = set(self.images)
        with engine.all_or_nothing():
            for image, adjusted in zip(known_images(network), network.with_polynomial.tolist(), strict=True):
                if adjusted:
                    _require_finite_prior(image)
            bundles = engine.adopted(shared_of(solution), solution, network)
            for image in known_images(network):
                if image.image.name not in present or not _same_image(image, self.store.image(image.image.name)):
                    self.store.add_image(image)
            self.store.replace(self.store.members(), bundles)
            for name in present - set(network.image_names):
                self.store.drop_image(name)
            self.store.set_definitions(engine.known)
            self.store.drop_shared(set(self.store.shared()) - set(engine.shared))
            self.store.set_shared(engine.shared)

    # --- how

    def _added(
        self, new: Sequence[KnownImage], addition: Network | None, brought: Definitions | None = None
    ) -> Impact:
        before = self.store.definitions()
        after = extended(self.store, before, brought or Definitions(), new)
        changed = with_addition(self.store, addition, after, turned_bundles(self.store, before, after))
        return self._change("add", [image.image.name for image in new], new, *changed, after)

    def _known(self, image: str | int) -> KnownImage:
        names = self.images
        return self.store.image(names[number_of(image, numbered(names), "image")])

    def _new_images(
        self, images: PushbroomImage | KnownImage | Sequence[KnownImage], prior: OrientationPrior | None
    ) -> list[KnownImage]:
        if isinstance(images, PushbroomImage):
            if prior is None and not self.images:
                raise InputError(f"image {images.name}", "no a-priori sigmas", "a prior for the first image")
            images = KnownImage(images, prior or self.store.image(self.images[-1]).prior)
        new, present = [images] if isinstance(images, KnownImage) else list(images), set(self.images)
        for name, count in Counter(image.image.name for image in new).items():
            if name in present or count > 1:
                problem = "in the adjustment already" if name in present else "named twice"
                raise InputError(f"image {name}", problem, "an image that is new", "remove it first to replace it")
        return new

    def _new_unknowns(
        self, new: Sequence[KnownImage], networks: Mapping[Members, Network], definitions: Definitions
    ) -> dict[Unknown, Shared]:
        """Orientation of new images, shifts of an addition, orientation images of passes that are new or continued, and
        new unknowns that images share; at zero.
        """
        added, angles = dict[Unknown, Shared](), self.settings.angles
        images = ImagesByName(self.store, new)
        for pass_ in definitions.passes.values():
            if pass_ is not self._engine.known.passes.get(pass_.name):
                added |= shared_pass(pass_, images, angles)
        for name, by_images in definitions.shared.items():
            added[Unknown("shared", name)] = shared_by_images(by_images, images, angles)
        added = {unknown: start for unknown, start in added.items() if unknown not in self._engine.shared}
        for image in new:
            if definitions.of_image(image.image.name) is not None:
                continue
            _require_finite_prior(image)
            if not image.held:
                unknown = Unknown("image", image.image.name)
                added[unknown] = shared_image(image, self.settings.angles)
        for members, network in networks.items():
            for unknown in members:
                if unknown.kind == "shift" and unknown not in self._engine.shared:
                    motion = max(image_motion(image)[0] for image in known_images(network))
                    added[unknown] = shared_shift(network, unknown.name, motion)
        return added

    def _change(
        self,
        verb: str,
        subjects: Sequence[str],
        new: Sequence[KnownImage],
        replaced: Sequence[Members],
        networks: Mapping[Members, Network],
        definitions: Definitions,
        removed: Sequence[str] = (),
    ) -> Impact:
        """Replace bundles, store the new state, and report the change; `definitions` are the passes and shared unknowns
        from now on.
        """
        began, engine = time.perf_counter(), self._engine
        require_one_body(self.store, new)
        before = dict(engine.shared)
        old = {members: self.store.bundle(members) for members in replaced}
        with engine.all_or_nothing():
            dropped = [unknown for name in removed if (unknown := Unknown("image", name)) in before]
            remaining = set(unknowns_of(definitions))
            dropped += [unknown for unknown in unknowns_of(engine.known) if unknown not in remaining]
            unknowns_new = self._new_unknowns(new, networks, definitions)
            settled = engine.replaced(replaced, networks, unknowns_new, dropped, definitions)
            old |= {members: self.store.bundle(members) for members in settled.bundles if members not in networks}
            report = impact(verb, subjects, settled, old, before, engine.shared)
            self.store.set_definitions(definitions)
            self._keep(settled, replaced, networks, new, before)
            for name in removed:
                self.store.drop_image(name)
        return report.after(time.perf_counter() - began)

    def _keep(
        self,
        settled: Settled,
        replaced: Sequence[Members],
        networks: Iterable[Members],
        new: Sequence[KnownImage],
        before: Mapping[Unknown, Shared],
    ) -> None:
        """Write the new state to the store."""
        shared = self._engine.shared
        for image in new:
            self.store.add_image(image)
        moved = {members: bundle for members, bundle in settled.bundles.items() if members not in networks}
        self.store.replace(replaced, {members: settled.bundles[members] for members in networks})
        self.store.renew(moved)
        self.store.set_shared({unknown: state for unknown, state in shared.items() if state is not before.get(unknown)})
        self.store.drop_shared([unknown for unknown in before if unknown not in shared])


def _same_image(first: KnownImage, second: KnownImage) -> bool:
    return first.image is second.image and first.prior is second.prior and first.held == second.held


def _require_finite_prior(image: KnownImage) -> None:
    """Raise InputError unless every coefficient has an a-priori sigma."""
    if not np.all(np.isfinite(image.prior.sigmas)):
        problem, expected = "a coefficient without an a-priori sigma", "finite sigmas, which iSAM2 needs to begin with"
        raise InputError(f"image {image.image.name}", problem, expected)
