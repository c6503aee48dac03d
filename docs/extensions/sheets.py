"""Pictures of the gallery: every sheet (`mgsgraph.results.figures.sheet`) that an example has drawn since the last."""

from contextlib import ExitStack
from typing import Any

from sphinx_gallery.scrapers import figure_rst

from mgsgraph.results.figures.sheet import Sheet, plain_style

_DPI = 110
_STYLE = ExitStack()


def draw_plainly(settings: dict[str, Any], example: str) -> None:
    """Before each example: figures look as those that the commands write."""
    _STYLE.close()
    _STYLE.enter_context(plain_style())


def _get_sg_image_scraper() -> Any:
    return scrape


def scrape(block: tuple[Any, ...], variables: dict[str, Any], settings: dict[str, Any]) -> str:
    """Draw new sheets among the example's names; the lines that show them."""
    drawn = variables.setdefault("drawn_sheets", set())
    written = []
    for value in list(variables["example_globals"].values()):
        for sheet in value if isinstance(value, list) else [value]:
            if isinstance(sheet, Sheet) and id(sheet) not in drawn:
                drawn.add(id(sheet))
                path = next(variables["image_path_iterator"])
                sheet.figure.savefig(path, dpi=_DPI)
                written.append(figure_rst([path], settings["src_dir"], fig_titles=sheet.title))
    return "".join(written)
