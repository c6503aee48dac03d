"""How many frames a second a panel draws while it is panned and zoomed."""

from collections.abc import Callable
from typing import Any

_RATE = """async () => {
  const view = VIEW;
  const rate = async act => {
    const begin = performance.now(), before = view.statistics.COUNTED;
    let k = 0;
    await new Promise(done => { const step = () => {
      act(k++);
      performance.now() - begin < 1500 ? requestAnimationFrame(step) : done();
    }; requestAnimationFrame(step); });
    return 1000 * (view.statistics.COUNTED - before) / (performance.now() - begin);
  };
  return [await rate(k => PAN), await rate(k => ZOOM)];
}"""
_TRIES = 8
_ENOUGH = 30.0


def rates(run: Callable[[str], Any], view: str, counted: str, pan: str, zoom: str) -> list[float]:
    """Frames a second of panning and of zooming, each act moving a frame and asking for the next: the best of some
    tries of 1.5 s each, for what else runs on the machine only takes away from them.
    """
    script = _RATE.replace("VIEW", view).replace("COUNTED", counted).replace("PAN", pan).replace("ZOOM", zoom)
    best = [0.0, 0.0]
    for _ in range(_TRIES):
        best = [max(both) for both in zip(best, run(script), strict=True)]
        if min(best) >= _ENOUGH:
            break
    print(f"frames per second: pan {best[0]:.0f}, zoom {best[1]:.0f}")
    return best
