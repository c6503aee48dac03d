"""Rows in a mapped file: the same results as in memory, to the last bit; rays renewed in place as laid out anew."""

import mmap
from dataclasses import replace

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.graph import lay_out, rows
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError

LITTLE = 1e-9
"""GB: everything goes to files."""


def in_a_file(values):
    """Whether an array lies in a mapped file."""
    while isinstance(values, np.ndarray):
        values = values.base
    return isinstance(values.obj if isinstance(values, memoryview) else values, mmap.mmap)


@pytest.mark.parametrize("settings", [SolverSettings(), SolverSettings(reject=4.0), SolverSettings(line="measured")])
def test_in_a_file_as_in_memory(settings):
    net = with_shift_and_surface(network(pair()))
    inside = adjust_network(net, settings)
    outside = adjust_network(net, replace(settings, memory_gb=LITTLE))
    for name in ("places", "covariances", "residuals", "range_residuals"):
        np.testing.assert_array_equal(getattr(outside, name), getattr(inside, name))
    for one, other in zip(outside.coefficients, inside.coefficients, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("line", ["predicted", "measured"])
def test_constants_lie_in_a_file_where_memory_is_short(line):
    for memory, outside in ((LITTLE, True), (1.0, False), (None, False)):
        made = lay_out(network(pair()), SolverSettings(line=line, memory_gb=memory))
        for layout in (made, made.about(made.lines + 0.5)):
            assert in_a_file(layout.rows.data) == outside


def test_a_container_has_less_memory_than_its_machine(tmp_path, monkeypatch):
    whole = rows.memory()
    monkeypatch.setattr(rows, "_LIMITS", (tmp_path / "max", tmp_path / "none", tmp_path / "limit"))
    assert rows.memory() >= whole
    (tmp_path / "max").write_text("max\n")
    (tmp_path / "limit").write_text("1000000\n")
    assert rows.memory() == 1e6
    assert rows.Storage.within(None).most < 1e6
    assert rows.Storage.within(2.0).most == 2e9 * rows._SHARE


def test_no_room_is_said(monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(rows.os, "posix_fallocate", full)
    with pytest.raises(InputError, match="No space left"):
        rows.Storage(0.0).room(10)


@pytest.mark.parametrize("net", [pair, lambda: with_shift_and_surface(network(pair()))])
def test_renewed_as_laid_out_anew(net):
    net = net() if net is not pair else network(pair())
    made = lay_out(net, SolverSettings())
    lines = made.lines + np.random.default_rng(1).normal(0.0, 20.0, made.lines.size)
    anew = made._sorted_anew(lines, made.bent)
    before = made.rows.data.copy()
    apart = made.about(lines)
    np.testing.assert_array_equal(made.rows.data, before)
    np.testing.assert_array_equal(apart.rows.data, anew.rows.data)
    own = made.about(lines, own=True)
    assert own.rows.data is made.rows.data
    np.testing.assert_array_equal(own.rows.data, anew.rows.data)
