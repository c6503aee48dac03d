"""Every page of the built site at 1280 and 380 px: contact sheets to look at, and what is wider than its screen.

python scripts/site_screens.py SITE OUT      # SITE: what sphinx-build has written; OUT: a folder for the sheets
"""

import sys
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, Request, sync_playwright

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
WIDTHS = {1280: (4, 0.5), 380: (7, 0.75)}
"""px; pages in a row of a sheet, and their scale there."""
_TALLEST = 2400
"""px of a page that are shown."""
_SHEET = 2600
"""px, height of a sheet."""
_WIDER = """() => {
    const out = [];
    const whole = document.documentElement.scrollWidth;
    if (whole > innerWidth + 1) out.push(`page ${whole} px`);
    for (const one of document.querySelectorAll('article *')) {
        const box = one.getBoundingClientRect();
        if (box.right <= innerWidth + 1 || !box.width) continue;
        let up = one.parentElement;
        while (up && !/(auto|scroll)/.test(getComputedStyle(up).overflowX)) up = up.parentElement;
        if (!up) out.push(`${one.tagName.toLowerCase()} ${one.className}: ${one.textContent.trim().slice(0, 40)}`);
    }
    return out.slice(0, 3);
}"""
"""What lies beyond the right edge and in nothing that scrolls."""


def main() -> None:
    site, out = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    out.mkdir(exist_ok=True)
    pages = [path for path in sorted(site.rglob("*.html")) if "source" not in path.relative_to(site).parts[:-1]]
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        for width, (columns, scale) in WIDTHS.items():
            page = browser.new_page(viewport={"width": width, "height": 800})
            page.on("request", tell_outside)
            pictures = [picture_of(page, path, width, scale) for path in pages]
            contact_sheets(pictures, columns, out / f"{width}")
        browser.close()


def tell_outside(request: Request) -> None:
    if not request.url.startswith(("file:", "data:")):
        print(f"asked of the network: {request.url}")


def picture_of(page: Page, path: Path, width: int, scale: float) -> Image.Image:
    page.goto(path.as_uri())
    for found in page.evaluate(_WIDER):
        print(f"{width} px, {path.name}: {found}")
    picture = Image.open(BytesIO(page.screenshot(full_page=True)))
    picture = picture.crop((0, 0, width, min(picture.height, _TALLEST)))
    return picture.convert("RGB").resize((round(width * scale), round(picture.height * scale)))


def contact_sheets(pictures: list[Image.Image], columns: int, begin: Path) -> None:
    width, count = pictures[0].width + 8, 0
    while pictures:
        sheet, heights = Image.new("RGB", (columns * width, _SHEET), "grey"), [0] * columns
        while pictures and min(heights) + pictures[0].height <= _SHEET:
            column = heights.index(min(heights))
            sheet.paste(one := pictures.pop(0), (column * width, heights[column]))
            heights[column] += one.height + 8
        sheet.crop((0, 0, sheet.width, max(heights))).save(f"{begin}_{count}.png")
        count += 1


if __name__ == "__main__":
    main()
