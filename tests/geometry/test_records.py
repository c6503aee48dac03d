"""What records accept, copy and refuse."""

import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import (
    chosen_rows,
    concatenated,
    frozen,
    frozen_index,
    repeated,
    require_covariances,
    require_names,
)


def test_frozen_copies_and_can_not_be_written() -> None:
    given = np.arange(6).reshape(2, 3)
    array = frozen(given, "field", (None, 3))
    given[0, 0] = 99

    assert array.dtype == np.float64
    assert array[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        array[0, 0] = 1.0


@pytest.mark.parametrize(
    ("value", "shape", "said"),
    [
        (np.zeros(3), (None, 3), r"field: an array of shape \(3,\); expected shape \(n, 3\)"),
        ([[1.0, np.nan]], (None, 2), r"field: nan at \[0, 1\]; expected finite numbers"),
        ([[1.0], [1.0, 2.0]], (None, 2), "field: no array of numbers"),
        (["x"], (1,), "field: no array of numbers"),
    ],
)
def test_frozen_refuses(value: object, shape: tuple[int | None, ...], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        frozen(value, "field", shape)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_no_indices_and_whole_floats_are_indices() -> None:
    assert frozen_index([], "index", 0, 0).size == 0
    np.testing.assert_array_equal(frozen_index([1.0, 0.0], "index", 2, 2), [1, 0])


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ([0, 1], "2 indices; expected 3"), ([0, 1, 3], r"index 0 \.\. 3; expected 0 \.\. 2"), ([-1, 0, 1], r"index -1"),
        ([0.5, 1.0, 2.0], "expected whole numbers"),

    ],
)  # fmt: skip
def test_what_is_no_index_is_refused(value: list[object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        frozen_index(value, "index", 3, 3)  # type: ignore[arg-type]


def test_ids_are_unique() -> None:
    require_names(("a", "b", ""), "file")
    with pytest.raises(InputError, match="file: the id 'b' twice"):
        require_names(("a", "b", "c", "b"), "file")


def test_covariances_where_they_are_needed() -> None:
    lopsided = np.eye(3)
    lopsided[0, 1] = 1e-3
    faults = {"zero": np.zeros((3, 3)), "flat": np.diag([1.0, 1.0, 0.0]), "negative": -np.eye(3), "lopsided": lopsided}
    for fault in faults.values():
        stack = np.array([np.diag([1e-4, 1.0, 1e6]), fault])
        require_covariances(stack, np.array([True, False]), ("good", "bad"), "file")
        with pytest.raises(InputError, match="file, point bad: an a-priori covariance that is not positive definite"):
            require_covariances(stack, np.array([True, True]), ("good", "bad"), "file")
    require_covariances(np.zeros((0, 3, 3)), np.zeros(0, dtype=bool), (), "file")


@pytest.mark.parametrize("name", ["a\x1b[2Jb", "a" * 501])
def test_names_that_no_terminal_should_be_given(name: str) -> None:
    require_names(("é", "image 2"), "images")
    with pytest.raises(InputError, match="images"):
        require_names(("é", name), "images")


@pytest.mark.parametrize("parts", [[2, 4], [0, 3, 0]])
def test_a_repeated_value_takes_the_memory_of_one(parts: list[int]) -> None:
    """Chosen, joined and kept by a record it is what the full array is."""
    blocks = [repeated(0.0, (n, 3, 3)) for n in parts]
    together, rows = concatenated(blocks), np.array([0, sum(parts) - 1, 0])
    mixed = concatenated([*blocks, np.ones((2, 3, 3))])
    assert together.shape == (sum(parts), 3, 3)
    assert frozen(together, "x", (None, 3, 3)) is together
    assert chosen_rows(together, rows).shape == (3, 3, 3)
    assert not any(chosen_rows(together, rows).strides)
    np.testing.assert_array_equal(mixed, np.concatenate([np.zeros((sum(parts), 3, 3)), np.ones((2, 3, 3))]))
    np.testing.assert_array_equal(chosen_rows(mixed, rows), mixed[rows])


def test_what_nobody_can_write_to_is_not_copied() -> None:
    given = np.arange(3.0)
    assert frozen(given, "x", (3,)) is not given
    given.flags.writeable = False
    assert frozen(given, "x", (3,)) is given
    assert frozen(given[1:], "x", (2,)).base is given
    owner = np.arange(3.0)
    view = owner.view()
    view.flags.writeable = False
    assert frozen(view, "x", (3,)).base is None  # the owner may still be written to
