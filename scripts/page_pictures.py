"""Pictures of the pages that show results of the demo: docs/pictures, made with the program itself. In an empty folder:

mgsgraph demo --out mgsgraph-demo
mgsgraph match mgsgraph-demo/inputs/case.toml --out MATCHES
mgsgraph adjust mgsgraph-demo/inputs/case.toml --ties MATCHES/network.pvl --out RESULT
mgsgraph review mgsgraph-demo/inputs/case.toml --ties MATCHES/network.pvl --solution RESULT --out review.html
mgsgraph dem RESULT --case mgsgraph-demo/inputs/case.toml --out DEM
mgsgraph analyze mgsgraph-demo --out analysis
mgsgraph analyze mgsgraph-demo --curve E02-00665 --raster --out sigmas
mgsgraph report mgsgraph-demo --out report.html
python scripts/page_pictures.py FOLDER      # that folder; playwright and Chromium take the pages' pictures
"""

import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

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
PAGES = {"review.jpg": ("review.html", 820, 150), "report.jpg": ("report.html", 760, 0)}
"""Files, how much of them is shown, and from where on, px."""
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]


def main() -> None:
    work = Path(sys.argv[1]).resolve()
    PICTURES.mkdir(exist_ok=True)
    for name, file in FIGURES.items():
        save(Image.open(work / file), name)
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        for name, (file, height, top) in PAGES.items():
            page = browser.new_page(viewport={"width": WIDTH, "height": height})
            page.goto((work / file).as_uri())
            page.evaluate(f"scrollTo(0, {top})")
            page.wait_for_timeout(2000)
            page.screenshot(path=work / "screen.png")
            save(Image.open(work / "screen.png"), name)
        browser.close()


def save(picture: Image.Image, name: str) -> None:
    """What pages need of it, as wide as they need it: pictures in JPEG, drawings in 128 colours."""
    picture = picture.convert("RGB")
    if picture.width > WIDTH:
        picture = picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)), Image.Resampling.LANCZOS)
    if name.endswith(".jpg"):
        picture.save(PICTURES / name, quality=64, optimize=True, progressive=True)
    else:
        picture.quantize(128, kmeans=2, dither=Image.Dither.NONE).save(PICTURES / name, optimize=True)


if __name__ == "__main__":
    main()
