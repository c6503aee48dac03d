"""Numbers that a case file may hold."""

from typing import Annotated

import msgspec

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Sigma = Annotated[float, msgspec.Meta(ge=1e-6, le=1e9)]
"""Standard deviations that mean something: a micropixel or a micrometre to a million kilometres."""
Factor = Annotated[float, msgspec.Meta(ge=1e-3, le=1e3)]
"""Of sigmas that are stated elsewhere."""
