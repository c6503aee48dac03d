"""Rows in a mapped file: the same results as in memory, to the last bit; rays renewed in place as laid out anew."""

import mmap

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.graph import lay_out, scratch
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError


@pytest.fixture
def out_of_core(monkeypatch):
    monkeypatch.setattr(scratch, "most_in_memory", lambda: 0.0)


@pytest.mark.parametrize("settings", [SolverSettings(), SolverSettings(reject=4.0), SolverSettings(line="measured")])
def test_in_a_file_as_in_memory(settings, monkeypatch):
    net = with_shift_and_surface(network(pair()))
    inside = adjust_network(net, settings)
    monkeypatch.setattr(scratch, "most_in_memory", lambda: 0.0)
    outside = adjust_network(net, settings)
    for name in ("places", "covariances", "residuals", "range_residuals"):
        np.testing.assert_array_equal(getattr(outside, name), getattr(inside, name))
    for one, other in zip(outside.coefficients, inside.coefficients, strict=True):
        np.testing.assert_array_equal(one, other)


def test_constants_lie_in_a_file(out_of_core):
    made = lay_out(network(pair()), SolverSettings())
    for layout in (made, made.about(made.lines + 0.5)):
        base = layout.rows.data
        while isinstance(base, np.ndarray):
            base = base.base
        assert isinstance(base.obj if isinstance(base, memoryview) else base, mmap.mmap)


def test_no_room_is_said(out_of_core, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(scratch.os, "posix_fallocate", full)
    with pytest.raises(InputError, match="No space left"):
        scratch.room(10)


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
