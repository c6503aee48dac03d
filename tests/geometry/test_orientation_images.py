"""Orientation images: what Lagrange's polynomials between them can follow, and how they are laid out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import along

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationImages, evenly_spaced

EPOCH = 1.3e8
NODES = np.array([0.0, 3.0, 5.0, 9.0, 10.0, 14.0, 20.0])


def images() -> OrientationImages:
    return OrientationImages("lagrange", EPOCH, NODES)


@given(st.floats(-2.0, 22.0))
def test_the_basis_sums_to_one_and_to_the_time(time: float) -> None:
    """So that a constant and a linear drift of the nodes are those of the orientation."""
    nodes = images()
    values, rates = nodes.dense(np.array([time]), EPOCH)
    assert values.sum() == pytest.approx(1.0, abs=1e-12)
    assert rates.sum() == pytest.approx(0.0, abs=1e-12)
    assert values[0] @ nodes.times == pytest.approx(time, abs=1e-10)
    assert rates[0] @ nodes.times == pytest.approx(1.0, abs=1e-12)


@given(st.floats(-2.0, 22.0), st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=4))
def test_lagrange_goes_through_any_cubic(time: float, coefficients: list[float]) -> None:
    nodes, cubic = images(), np.polynomial.Polynomial(coefficients, domain=(0.0, 20.0), window=(-1.0, 1.0))
    values, rates = nodes.dense(np.array([time]), EPOCH)
    assert values[0] @ cubic(nodes.times) == pytest.approx(cubic(time), abs=1e-10)
    assert rates[0] @ cubic(nodes.times) == pytest.approx(cubic.deriv()(time), abs=1e-10)


def test_a_node_depends_on_its_own_neighbourhood_alone() -> None:
    nodes = images()
    times = np.linspace(*nodes.coverage, 301)
    first, values, _ = nodes.at(times, EPOCH)
    inner = (times > nodes.times[1]) & (times < nodes.times[-2])
    left, right = nodes.times[first + 1], nodes.times[first + 2]
    assert np.all((left <= times + 1e-9)[inner])
    assert np.all((times <= right + 1e-9)[inner])
    assert values.shape == (301, 4)


def test_lagrange_is_the_node_itself_at_a_node() -> None:
    nodes = images()
    np.testing.assert_allclose(nodes.dense(nodes.times, EPOCH)[0], np.eye(len(nodes)), atol=1e-14)


@pytest.mark.parametrize("time", [1.3, 6.0, 12.7, 19.1])
def test_rates_against_differences(time: float) -> None:
    nodes = images()
    want = along(lambda step: nodes.dense(np.array([time + step]), EPOCH)[0][0], 1e-2)
    np.testing.assert_allclose(nodes.dense(np.array([time]), EPOCH)[1][0], want, atol=1e-9)


def test_another_epoch_is_the_same_time() -> None:
    nodes, times = images(), np.array([1.0, 7.5, 19.0])
    for one, other in zip(nodes.at(times, EPOCH), nodes.at(times - 40.0, EPOCH + 40.0), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


@given(length=st.floats(0.5, 2000.0), spacing=st.floats(0.3, 500.0))
def test_even_spacing_covers_the_strip_with_no_larger_steps(length: float, spacing: float) -> None:
    nodes = evenly_spaced("lagrange", EPOCH, (5.0, 5.0 + length), spacing)
    np.testing.assert_allclose(nodes.coverage, (5.0, 5.0 + length), rtol=1e-9)
    steps = np.diff(nodes.times)
    assert steps.max() <= spacing * (1.0 + 1e-6)
    assert len(nodes) == 4 or steps.max() > 0.4 * min(spacing, length / 3.0)


def test_bad_nodes() -> None:
    with pytest.raises(InputError, match="3 nodes; expected at least 4"):
        OrientationImages("lagrange", EPOCH, np.arange(3.0))
    with pytest.raises(InputError, match="increasing"):
        OrientationImages("lagrange", EPOCH, np.array([0.0, 2.0, 2.0, 3.0]))
    with pytest.raises(InputError, match="one of lagrange"):
        OrientationImages("cubic", EPOCH, NODES)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"-1\.0 s; expected a positive number"):
        evenly_spaced("lagrange", EPOCH, (0.0, 10.0), -1.0)
