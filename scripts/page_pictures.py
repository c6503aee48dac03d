"""Pictures for the pages, and of them; playwright and Chromium take them.

python scripts/page_pictures.py site SITE OUT     # every page of the built site at 1280 and 380 px: contact sheets to
    # look at, and what is wider than its screen; SITE: what sphinx-build has written, OUT: a folder for the sheets
python scripts/page_pictures.py graph             # docs/pictures/factor_graph.png
python scripts/page_pictures.py studio NAME PATH  # all views of the studio of a project, results or case
    # at 1280 x 800 and 1920 x 1080: docs/pictures/studio_NAME_1280.jpg and _1920.jpg
python scripts/page_pictures.py demo FOLDER       # docs/pictures, of results of the demo, made in FOLDER by

mgsgraph demo --out mgsgraph-demo
mgsgraph match mgsgraph-demo/inputs/case.toml --out MATCHES
mgsgraph adjust mgsgraph-demo/inputs/case.toml --ties MATCHES/network.pvl --out RESULT
mgsgraph dem RESULT --case mgsgraph-demo/inputs/case.toml --out DEM
mgsgraph analyze mgsgraph-demo --out analysis
mgsgraph analyze mgsgraph-demo --curve E02-00665 --raster --out sigmas
mgsgraph report mgsgraph-demo --out report.html
"""

import sys
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, Request, sync_playwright

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "pictures"
WIDTH = 1040
"""px; pages show them 690 to 740 wide, and finer on fine screens."""
FIGURES = {
    "profiles.png": "mgsgraph-demo/profiles_1.png",
    "discrepancy.png": "mgsgraph-demo/discrepancy.png",
    "overlay.jpg": "mgsgraph-demo/overlay_1.png",
    "map.png": "mgsgraph-demo/map.png",
    "residuals.png": "mgsgraph-demo/residuals.png",
    "orientation.png": "mgsgraph-demo/orientation.png",
    "matches.png": "MATCHES/matches.png",
    "dem.jpg": "DEM/dem.png",
    "quantiles.png": "analysis/quantiles.png",
    "sigma_map.jpg": "sigmas/sigma_map.png",
}
PAGES = {"report.jpg": ("report.html", 760, 0)}
"""Files, how much of them is shown, and from where on, px."""
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
"""Elements beyond the right edge that do not scroll."""
SCREENS = {(1280, 800): 0.7, (1920, 1080): 0.5}
"""px; sizes of a screen, and scale of its views on a sheet."""
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]


def main() -> None:
    what, *folders = sys.argv[1:]
    if what == "graph":
        factor_graph()
        return
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        {"demo": demo, "site": site, "studio": views}[what](browser, *(Path(folder).resolve() for folder in folders))
        browser.close()


# --- pictures of the demo


def demo(browser: Browser, work: Path) -> None:
    PICTURES.mkdir(exist_ok=True)
    for name, file in FIGURES.items():
        save(Image.open(work / file), name)
    for name, (file, height, top) in PAGES.items():
        page = browser.new_page(viewport={"width": WIDTH, "height": height})
        page.goto((work / file).as_uri())
        page.evaluate(f"scrollTo(0, {top})")
        page.wait_for_timeout(2000)
        save(Image.open(BytesIO(page.screenshot())), name)


def save(picture: Image.Image, name: str) -> None:
    """Save a picture for a page, in its width: photographs as JPEG, drawings in 128 colors."""
    picture = picture.convert("RGB")
    if picture.width > WIDTH:
        picture = picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)), Image.Resampling.LANCZOS)
    if name.endswith(".jpg"):
        picture.save(PICTURES / name, quality=64, optimize=True, progressive=True)
    else:
        picture.quantize(128, kmeans=2, dither=Image.Dither.NONE).save(PICTURES / name, optimize=True)


VARIABLES = {
    "image A": (0.0, 0.0), "image B": (2.6, 0.0), "tie point": (1.3, -1.5), "laser point": (3.9, -1.5),
    "profile shift": (5.4, 0.0),
}  # fmt: skip
"""Where they are drawn."""
FACTORS = [
    (("image A",), (-0.9, 0.0), "orientation_prior", (0.0, 0.3)),
    (("image B",), (2.6, 0.85), "orientation_prior", (0.0, 0.3)),
    (("image A", "tie point"), (0.65, -0.75), "pushbroom_projection", (-1.15, -0.12)),
    (("image B", "tie point"), (1.95, -0.75), "", (0.0, 0.0)),
    (("image B", "laser point"), (2.95, -0.95), "", (0.0, 0.0)),
    (("image B", "laser point"), (3.5, -0.5), "laser_range", (0.0, 0.3)),
    (("laser point", "profile shift"), (4.65, -0.75), "ground_prior", (0.85, -0.1)),
    (("profile shift",), (6.3, 0.0), "orientation_prior", (0.0, 0.3)),
]
"""Variables, where it is drawn, its name and where that stands beside it."""


def factor_graph() -> None:
    """Two images, a tie point, a laser point and the shift of its profile, drawn as a graph of factors."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.8, 3.2))
    for members, at, name, beside in FACTORS:
        for member in members:
            axes.plot(*zip(VARIABLES[member], at, strict=True), color="0.55", linewidth=1.2, zorder=1)
        axes.plot(*at, "s", color="#b3430e", markersize=9, zorder=3)
        axes.text(at[0] + beside[0], at[1] + beside[1], name, ha="center", va="center", fontsize=8.5, color="#b3430e")
    for name, at in VARIABLES.items():
        axes.plot(*at, "o", color="#dbe9f6", markeredgecolor="#1f4e79", markersize=46, zorder=2)
        axes.text(*at, name.replace(" ", "\n"), ha="center", va="center", fontsize=9, zorder=4)
    axes.set(xlim=(-1.7, 7.1), ylim=(-2.1, 1.4), aspect="equal")
    axes.set_axis_off()
    figure.tight_layout(pad=0.1)
    figure.savefig(PICTURES / "factor_graph.png", dpi=140)


# --- views of the studio


def views(browser: Browser, name: Path, opened: Path) -> None:
    sys.path.insert(0, str(PICTURES.parents[1] / "tests"))
    from studio_server import PANELS, studio

    with studio(opened) as running:
        for (width, height), scale in SCREENS.items():
            page, pictures = browser.new_page(viewport={"width": width, "height": height}), list[Image.Image]()
            page.goto(running.root + running.entrance())
            page.wait_for_timeout(8000)  # the verdict of a large block
            page.evaluate("studio.request('/api/worst').then(one => studio.select(one.measurements[0]?.point ?? ''))")
            for key in range(len(PANELS)):
                page.evaluate("document.activeElement.blur()")
                page.keyboard.press(str(key + 1))
                page.wait_for_timeout(4000)
                pictures.append(Image.open(BytesIO(page.screenshot())).convert("RGB"))
            size = round(width * scale), round(height * scale)
            sheet = Image.new("RGB", (2 * size[0] + 8, 3 * size[1] + 16), "grey")
            for k, picture in enumerate(pictures):
                at = (size[0] + 8) * (k % 2), (size[1] + 8) * (k // 2)
                sheet.paste(picture.resize(size, Image.Resampling.LANCZOS), at)
            sheet.save(PICTURES / f"studio_{name.name}_{width}.jpg", quality=64, optimize=True, progressive=True)


# --- pages of the site


def site(browser: Browser, built: Path, out: Path) -> None:
    out.mkdir(exist_ok=True)
    pages = [path for path in sorted(built.rglob("*.html")) if "source" not in path.relative_to(built).parts[:-1]]
    for width, (columns, scale) in WIDTHS.items():
        page = browser.new_page(viewport={"width": width, "height": 800})
        page.on("request", tell_outside)
        contact_sheets([picture_of(page, path, width, scale) for path in pages], columns, out / f"{width}")


def tell_outside(request: Request) -> None:
    if not request.url.startswith(("file:", "data:")):
        print(f"asked of the network: {request.url}")


def picture_of(page: Page, path: Path, width: int, scale: float) -> Image.Image:
    page.goto(path.as_uri())
    for element in page.evaluate(_WIDER):
        print(f"{width} px, {path.name}: {element}")
    picture = Image.open(BytesIO(page.screenshot(full_page=True)))
    picture = picture.crop((0, 0, width, min(picture.height, _TALLEST)))
    return picture.convert("RGB").resize((round(width * scale), round(picture.height * scale)))


def contact_sheets(pictures: list[Image.Image], columns: int, begin: Path) -> None:
    width, count = pictures[0].width + 8, 0
    while pictures:
        sheet, heights = Image.new("RGB", (columns * width, _SHEET), "grey"), [0] * columns
        while pictures and min(heights) + pictures[0].height <= _SHEET:
            column = heights.index(min(heights))
            sheet.paste(picture := pictures.pop(0), (column * width, heights[column]))
            heights[column] += picture.height + 8
        sheet.crop((0, 0, sheet.width, max(heights))).save(f"{begin}_{count}.png")
        count += 1


if __name__ == "__main__":
    main()
