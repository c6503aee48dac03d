"""What is known of a pass's nodes beforehand, processes and polynomials: against dense covariances, quadrature and
closed forms.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from networks import network, pair
from outside import refuses
from scipy.special import gamma, kv

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationImages, evenly_spaced
from mgsgraph.network import NodePrior, Pass, PassPrior, PolynomialPrior, Process, ProcessPrior
from mgsgraph.network.conditioning import DIVERGENCE, ProcessKind, dense_covariance
from mgsgraph.network.passes import normalised

EVEN = evenly_spaced("lagrange", 3e8, (10.0, 70.0), 2.5)
UNEVEN = OrientationImages("lagrange", 3e8, np.array([0.0, 1.0, 1.5, 1.75, 2.5, 5.0, 8.0, 9.0, 9.5, 12.0, 15.0, 20.0]))
SIZE = np.array([20.0, 30.0, 50.0])
NONE = np.zeros(6)
SIGMAS = np.array([1.0, 2.0, 3.0, 1e-5, 2e-5, 3e-5])
TREND = np.array([200.0] * 3 + [4e-4] * 3)


def process(kind: ProcessKind, scale: float = 1.0) -> Process:
    timed = kind in ("gauss-markov", "matern-3/2", "matern-5/2")
    return Process(kind, SIZE * scale, 7.0 if timed else 0.0)


def information(prior: PassPrior, nodes: OrientationImages) -> np.ndarray:
    """(c, c) of the nodes and the trend."""
    edges = np.concatenate([6 * np.arange(len(nodes) + 1), [6 * len(nodes) + prior.trend_sigmas.size]])
    rows = []
    for unknowns, blocks, _ in prior.factors(nodes):
        row = np.zeros((blocks[0].shape[0], edges[-1]))
        for unknown, block in zip(unknowns, blocks, strict=True):
            row[:, edges[unknown] : edges[unknown + 1]] = block
        rows.append(row)
    whole = np.concatenate(rows)
    return whole.T @ whole


def covariance(prior: PassPrior, nodes: OrientationImages) -> np.ndarray:
    """(6 k, 6 k) of the nodes, whatever the trend."""
    whole = information(prior, nodes)
    scale = 1.0 / np.sqrt(np.diagonal(whole))
    inverse = np.linalg.inv(whole * scale[:, None] * scale) * scale[:, None] * scale
    return np.asarray(inverse[: 6 * len(nodes), : 6 * len(nodes)])


@pytest.mark.parametrize("nodes", [EVEN, UNEVEN], ids=str)
def test_a_gauss_markov_process_has_todays_rows(nodes: OrientationImages) -> None:
    bias = np.array([200.0, 0.0, 100.0, 4e-4, 3e-4, 0.0])
    attitude = Process("gauss-markov", SIZE * 1e-6, 7.0)
    old = NodePrior(np.concatenate([SIZE, SIZE * 1e-6]), bias, 0.5 * TREND, 7.0)
    new = ProcessPrior((process("gauss-markov"),), (attitude,), bias, 0.5 * TREND)
    for one, other in zip(old.factors(nodes), new.factors(nodes), strict=True):
        assert one.unknowns == other.unknowns
        np.testing.assert_array_equal(one.about, other.about)
        for block, same in zip(one.blocks, other.blocks, strict=True):
            np.testing.assert_allclose(same, block, rtol=1e-12, atol=0.0)
    np.testing.assert_allclose(new.own_sigmas(nodes), old.own_sigmas(nodes), rtol=1e-12)
    assert new.divergence(nodes) == 0.0


@pytest.mark.parametrize("nodes", [EVEN, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("kind", ["white", "gauss-markov", "matern-3/2", "matern-5/2", "integrated-wiener"])
def test_rows_between_neighbours_are_the_whole_process(kind: ProcessKind, nodes: OrientationImages) -> None:
    """The Kullback-Leibler divergence of the rows' density from the dense process, all of it, is the stated one."""
    prior = ProcessPrior((process(kind),), (process(kind, 1e-6),), TREND, TREND)
    s, count = normalised(nodes), len(nodes)
    found = information(prior, nodes)
    for c in range(6):
        # the trend given: the last columns are left out
        mine = found[c : 6 * count : 6, c : 6 * count : 6]
        dense = dense_covariance((process(kind, 1.0 if c < 3 else 1e-6),), c % 3, nodes)
        size = np.sqrt(np.diagonal(dense))
        product = (mine * size[:, None] * size) @ (dense / size[:, None] / size)
        divergence = 0.5 * (np.trace(product) - count - np.linalg.slogdet(product)[1])
        assert divergence / count < DIVERGENCE
        assert divergence / count < prior.divergence(nodes) + 2e-3
    want = prior.own_sigmas(nodes)
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance(prior, nodes))).reshape(-1, 6), want, rtol=0.02)
    assert np.all(want >= np.sqrt(TREND**2 + (s[:, None] * TREND) ** 2))


@pytest.mark.parametrize(("kind", "order"), [("gauss-markov", 0.5), ("matern-3/2", 1.5), ("matern-5/2", 2.5)])
def test_covariances_are_those_of_matern(kind: ProcessKind, order: float) -> None:
    """Against the general formula with Bessel's functions (Rasmussen & Williams 2006, 4.14)."""
    apart = np.linspace(0.01, 30.0, 200)
    scaled = np.sqrt(2.0 * order) * apart / process(kind).correlation_time
    want = 2.0 ** (1.0 - order) / gamma(order) * scaled**order * kv(order, scaled)
    np.testing.assert_allclose(process(kind).covariance(apart, 0.0 * apart, 0.0), want, rtol=1e-12)


@pytest.mark.parametrize("kind", ["gauss-markov", "matern-3/2", "matern-5/2"])
def test_spectra_hold_the_variance(kind: ProcessKind) -> None:
    """Every covariance is one: its cosine transform is nowhere negative."""
    one, step = process(kind), 0.05
    apart = step * np.arange(40000)
    density = np.fft.rfft(np.concatenate([(rho := one.covariance(apart, 0.0 * apart, 0.0)), rho[:0:-1]])).real
    assert rho[0] == 1.0
    assert density.min() > -1e-9 * density.max()


def test_an_integrated_wiener_process_is_an_acceleration_of_white_noise() -> None:
    """Against the double integral of the covariance of white noise, by quadrature on a fine grid."""
    one, step = Process("integrated-wiener", np.ones(3)), 1e-3
    grid = step * (np.arange(5000) + 0.5)
    for t, other in ((1.0, 1.0), (2.0, 4.5), (4.0, 0.7)):
        want = step * np.sum(np.maximum(t - grid, 0.0) * np.maximum(other - grid, 0.0))
        assert one.covariance(np.array(t + 3.0), np.array(other + 3.0), 3.0) == pytest.approx(want, rel=1e-5)
        assert one.covariance(np.array(3.0 - t), np.array(3.0 - other), 3.0) == pytest.approx(want, rel=1e-5)
        assert one.covariance(np.array(3.0 - t), np.array(3.0 + other), 3.0) == 0.0


def wiener() -> ProcessPrior:
    return ProcessPrior((process("integrated-wiener"),), (process("integrated-wiener", 1e-6),), TREND, TREND)


@pytest.mark.parametrize("beyond", [(-30.0, 60.0), (0.0, 200.0)])
def test_an_integrated_wiener_process_is_continued(beyond: tuple[float, float]) -> None:
    """What is known of old nodes stays as it is when later images continue the pass on either side."""
    nodes = evenly_spaced("lagrange", 0.0, (0.0, 60.0), 5.0)
    longer = nodes.over(*beyond)
    old = np.isin(longer.times, nodes.times)
    assert old.sum() == len(nodes) < len(longer)
    np.testing.assert_allclose(wiener().own_sigmas(longer)[old], wiener().own_sigmas(nodes), rtol=1e-12)
    columns = np.repeat(old, 6)
    want, found = covariance(wiener(), nodes), covariance(wiener(), longer)[columns][:, columns]
    size = np.sqrt(np.diagonal(want))
    np.testing.assert_allclose(found / size / size[:, None], want / size / size[:, None], atol=0.05)


@pytest.mark.parametrize("kind", ["gauss-markov", "matern-3/2", "matern-5/2"])
def test_nodes_much_closer_than_the_process_moves(kind: ProcessKind) -> None:
    """A thousandth of the correlation time (a hundredth for Matern 5/2) and 150 nodes: rows stay regular."""
    spacing = 0.07 if kind == "matern-5/2" else 0.007
    nodes = evenly_spaced("lagrange", 0.0, (0.0, 150.0 * spacing), spacing)
    prior = ProcessPrior((process(kind),), (process(kind, 1e-6),), NONE, NONE)
    assert prior.divergence(nodes) < DIVERGENCE
    found = information(prior, nodes)[::6, ::6][: len(nodes), : len(nodes)]
    sigmas = np.sqrt(np.diagonal(np.linalg.inv(found * SIZE[0] ** 2)))
    np.testing.assert_allclose(sigmas, 1.0, rtol=0.02)


def test_polynomials_of_each_its_degree() -> None:
    position, attitude = np.array([[50.0, 60.0, 70.0], [10.0, 0.0, 12.0]]), np.array([[3e-4] * 3] * 4)
    prior = PolynomialPrior(position, attitude)
    nodes = evenly_spaced("lagrange", 0.0, (5.0, 11.0), 2.0)
    s = normalised(nodes)
    found = covariance(prior, nodes)
    terms = s[:, None] ** np.arange(4)
    for c in range(3):
        want = terms[:, :2] @ np.diag(position[:, c] ** 2) @ terms[:, :2].T
        np.testing.assert_allclose(found[c::6, c::6], want, atol=1e-7 * want.max())
        want = terms @ np.diag(attitude[:, c] ** 2) @ terms.T
        np.testing.assert_allclose(found[c + 3 :: 6, c + 3 :: 6], want, atol=1e-7 * want.max())
    np.testing.assert_allclose(np.sqrt(np.diagonal(found)).reshape(-1, 6), prior.own_sigmas(nodes), rtol=1e-7)
    free = PolynomialPrior(np.full((2, 3), np.inf), attitude)
    assert np.all(np.isinf(free.own_sigmas(nodes)[:, :3]))
    assert free.scaled(np.full(6, 2.0), np.zeros(0)).attitude_sigmas[2, 1] == 6e-4


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Process("brown", SIZE), "one of white"),  # type: ignore[arg-type]
        (lambda: Process("white", [1.0, 0.0, 1.0]), "three positive"),  # type: ignore[arg-type]
        (lambda: Process("matern-3/2", SIZE), "correlation time"),
        (lambda: ProcessPrior((process("integrated-wiener"),), (process("white"),), NONE, TREND), "without bias"),
        (lambda: NodePrior(-SIGMAS, NONE, NONE), "six positive sigmas"),
        (lambda: NodePrior(SIGMAS, np.full(6, -1.0), NONE), "bias: -1"),
        (lambda: NodePrior(np.full(6, np.inf), np.ones(6), NONE), "nodes have none"),
        (lambda: NodePrior(SIGMAS, NONE, NONE, -1.0), "correlation time"),
        (lambda: list(PolynomialPrior(np.ones((1, 3)), np.ones((1, 3))).factors(EVEN)), "25 nodes; expected 4"),
    ],
)
def test_what_is_refused(make, said: str) -> None:  # type: ignore[no-untyped-def]
    refuses(said, make)


# --- bias, drift and a Gauss-Markov process as rows of their own; passes of a network


@given(st.sampled_from([0.0, 1.5, 20.0, 1e4]), st.sampled_from([0.0, 4.0]), st.sampled_from([0.0, 3.0]))
def test_rows_are_bias_drift_and_a_gauss_markov_process(time: float, bias: float, drift: float) -> None:
    """Their covariance: bias^2 + s s' drift^2 + sigma^2 exp(-|dt| / time)."""
    prior = NodePrior(SIGMAS, bias * SIGMAS, drift * SIGMAS, time)
    s = normalised(UNEVEN)
    apart = np.abs(np.subtract.outer(UNEVEN.times, UNEVEN.times))
    memory = np.exp(-apart / time) if time else np.eye(len(UNEVEN))
    want = np.kron(bias**2 + drift**2 * np.outer(s, s) + memory, np.diag(SIGMAS**2))

    scale = np.sqrt(np.diagonal(want))
    unit = np.outer(scale, scale)
    np.testing.assert_allclose(covariance(prior, UNEVEN) / unit, want / unit, atol=1e-8)
    np.testing.assert_allclose(prior.node_sigmas(s).ravel(), scale, rtol=1e-12)


def test_unknown_components_have_no_rows() -> None:
    prior = NodePrior(np.where(np.arange(6) < 3, np.inf, 1e-4), NONE, NONE, 5.0)
    normal = information(prior, UNEVEN)
    assert np.linalg.matrix_rank(normal) == 3 * len(UNEVEN)
    assert np.all(np.isinf(prior.node_sigmas(normalised(UNEVEN))[:, :3]))


def test_strips_of_a_network() -> None:
    net = network(pair())
    image = net.images[0]
    start, stop = image.timing.at(np.array([0.0, float(image.lines)]))[0].tolist()
    nodes = evenly_spaced("lagrange", image.trajectory.epoch, (start, stop), 1.0)
    prior = NodePrior(SIGMAS, NONE, NONE)
    with_strip = replace(net, passes=(Pass("A", np.array([0]), nodes, prior),))

    assert with_strip.pass_of.tolist() == [0, -1]
    assert with_strip.with_polynomial.tolist() == [False, True]
    assert not np.any(with_strip.held)
    assert np.all(replace(with_strip, passes=()).with_polynomial)
    refuses("it is held", replace, with_strip, held=np.array([True, False]))
    assert with_strip.first_of_passes.tolist() == [2, 2 + len(nodes)]
    with pytest.raises(InputError, match=r"pass 'A', images: image 0; expected .* one pass alone"):
        replace(net, passes=(Pass("A", np.array([0]), nodes, prior), Pass("B", np.array([0]), nodes, prior)))
    short = evenly_spaced("lagrange", image.trajectory.epoch, (start, 0.5 * stop), 1.0)
    with pytest.raises(InputError, match=r"pass 'A', image .*: lines from .* within its nodes'"):
        replace(net, passes=(Pass("A", np.array([0]), short, prior),))
    refuses("passes", replace, net, passes=(Pass("A", np.array([0]), nodes, prior),) * 2)
    refuses("at least one, each once", Pass, "A", np.array([0, 0]), nodes, prior)


@given(st.floats(1e5, 1e9))
def test_departures_that_hardly_forget_themselves(time: float) -> None:
    for unknowns, blocks, _ in NodePrior(SIGMAS, NONE, NONE, time).factors(UNEVEN):
        assert all(np.all(np.isfinite(block)) for block in blocks), unknowns
