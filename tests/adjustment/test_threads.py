"""The same input gives the same bytes, whatever number of threads shares the work."""

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.kernel import sweep


@pytest.mark.parametrize("how", [{}, {"loss": "huber"}], ids=["least squares", "robust"])
def test_any_number_of_threads_gives_the_same_bytes(how: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    net, found = with_shift_and_surface(network(pair(9000, 30))), []
    for count in (1, 2, 4):
        monkeypatch.setattr(sweep, "threads", lambda count=count: count)
        solution = adjust_network(net, SolverSettings(starts=0, **how))
        arrays = *solution.coefficients, solution.shifts, solution.places, solution.covariances, solution.residuals
        found.append((solution.cost_final, *(np.asarray(array).tobytes() for array in arrays)))
    assert found[0] == found[1] == found[2]
