"""Of pages, earlier ones of the same verb are replaced."""

from pathlib import Path

import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.writing import page_of, write_page
from mgsgraph.results.page import require_page as require_report
from mgsgraph.studio.match_review import require_page as require_review

REPORT, REVIEW = "results/templates/report.html", "studio/templates/review.html"


@pytest.mark.parametrize(("template", "other"), [(REPORT, REVIEW), (REVIEW, REPORT)])
def test_pages_are_known_by_the_head_of_the_template(tmp_path: Path, template: str, other: str) -> None:
    from importlib.resources import files

    head = (files("mgsgraph") / "files/output/templates/page.html").read_text(encoding="utf-8")
    page = tmp_path / "page.html"
    page.write_text(head.replace("{% block generator %}{% endblock %}", Path(template).stem), encoding="utf-8")
    assert page_of(template).known(page)
    assert not page_of(other).known(page)


def test_other_pages_are_left_alone(tmp_path: Path) -> None:
    page = tmp_path / "index.html"
    page.write_text("<!doctype html><title>Mine</title>", encoding="utf-8")
    for attempt in (
        lambda: require_report(page), lambda: require_review(page), lambda: write_page(REPORT, {}, page)
    ):
        with pytest.raises(InputError, match=r"index\.html: exists and is not a page of mgsgraph re.*; choose another"):
            attempt()
    assert "Mine" in page.read_text(encoding="utf-8")
