"""The project for QGIS: what they say of the layers, and in QGIS's own hands where it is installed."""

import json
import os
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from gis_files import LAYERS, layer, odd_solution

from mgsgraph.export.gis import style, write_gis, write_project
from mgsgraph.export.gis_layers import Layer, ellipse_layers, point_layers
from mgsgraph.geometry.body import Ellipsoid

pytest.importorskip("pyogrio", reason="the extra [gis] is not installed")
SYSTEM_PYTHON = "/usr/bin/python3"
"""Which has QGIS's module where Debian's python3-qgis is installed."""
SHAPES = LAYERS[:-1]
ASK = """
import json, sys
from qgis.core import QgsApplication, QgsProject, QgsMapSettings, QgsMapRendererSequentialJob, QgsVectorLayer
from qgis.PyQt.QtCore import QSize
application = QgsApplication([], False)
application.initQgis()
folder, project = sys.argv[1], QgsProject.instance()
found = {"read": project.read(folder + "/solution.qgs"), "crs": project.crs().description(),
         "ellipsoid": project.ellipsoid(), "layers": {}}
shown = []
for node in project.layerTreeRoot().findLayers():
    one = node.layer()
    if one is None:
        continue
    rules = one.renderer().rootRule().children()
    found["layers"][one.dataProvider().dataSourceUri().split("layername=")[1]] = {
        "valid": one.isValid(), "rows": one.featureCount(), "crs": one.crs().description(), "shown": node.isVisible(),
        "drawn": [sum(1 for row in one.getFeatures(rule.filterExpression() or "TRUE")) for rule in rules],
    }
    shown += [one] if node.isVisible() else []
settings = QgsMapSettings()
settings.setLayers(shown)
settings.setDestinationCrs(project.crs())
settings.setExtent(project.viewSettings().defaultViewExtent())
settings.setOutputSize(QSize(300, 300))
job = QgsMapRendererSequentialJob(settings)
job.start()
job.waitForFinished()
picture = job.renderedImage()
found["colours"] = len({picture.pixel(i, j) for i in range(0, 300, 2) for j in range(0, 300, 2)})
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("qgis")
    write_gis(odd_solution(), out)
    return out


def test_the_project_has_all_layers_and_the_body(folder: Path) -> None:
    project = ElementTree.parse(folder / "solution.qgs").getroot()
    sources = [one.text for one in project.iterfind("projectlayers/maplayer/datasource")]
    assert sorted(str(one) for one in sources) == sorted(f"./solution.gpkg|layername={name}" for name in SHAPES)
    for one in project.iter("spatialrefsys"):
        assert str(one.findtext("wkt")).startswith('GEOGCRS["Mars (2015) - Sphere / Ocentric"')
        assert one.findtext("ellipsoidacronym") == "PARAMETER:3396190:3396190"
    ids = [one.text for one in project.iterfind("projectlayers/maplayer/id")]
    assert ids == [one.get("id") for one in project.iterfind("layer-tree-group/layer-tree-layer")]
    assert min(len(str(one)) for one in ids) > 10  # shorter ones QGIS takes for old ones, and gives others
    view = project.find("ProjectViewSettings/DefaultViewExtent")
    assert view is not None
    west, south, east, north = (float(view.get(key, "nan")) for key in ("xmin", "ymin", "xmax", "ymax"))
    longitudes = layer(folder / "solution.gpkg", "tie_points").fields["lon_deg"]
    assert west < np.nanmin(longitudes) < np.nanmax(longitudes) < east
    assert south < north


def test_each_layer_has_its_rules(folder: Path) -> None:
    layers = list(ElementTree.parse(folder / "solution.qgs").getroot().iter("maplayer"))
    assert len(layers) == len(SHAPES)
    for one in layers:
        assert len(list(one.iter("rule"))) == len(one.findall("renderer-v2/symbols/symbol")) > 0
    assert {path.name for path in folder.iterdir()} == {"solution.gpkg", "solution.qgs"}


def test_exaggeration_is_stated_in_the_legend() -> None:
    true, larger = ellipse_layers(odd_solution())
    factor = larger.fields["exaggeration"][0]
    assert factor > 1.0
    assert style(true)[0].label == "95 % error ellipse"
    assert style(larger)[0].label.endswith(f"exaggerated {factor:g} times")


def test_classes_of_points_hold_as_many_each() -> None:
    ties = point_layers(odd_solution())[0]
    sigmas = np.asarray(ties.fields["sigma_up_m"])
    labels = [rule.label for rule in style(ties)]
    assert len(labels) == 6
    edges = [float(label.split(" m")[0].split()[-1]) for label in labels[:4]]
    assert edges == sorted(edges)
    counts = np.histogram(sigmas[np.isfinite(sigmas)], [-np.inf, *edges, np.inf])[0]
    assert counts.max() - counts.min() <= 4
    nothing = Layer("tie_points", "", "Point", ties.shapes[:0], {name: values[:0] for name, values in {
        "sigma_up_m": sigmas, "rejected": np.zeros(len(sigmas), dtype=bool)}.items()})  # fmt: skip
    assert [rule.label for rule in style(nothing)] == ["sigma up all", "rejected, or without a place"]


def test_a_project_of_nothing_shows_the_whole_body(tmp_path: Path) -> None:
    write_project([], "solution.gpkg", Ellipsoid(1737400.0, 1737400.0), "none <&>", tmp_path / "none.qgs")
    found = ElementTree.parse(tmp_path / "none.qgs").getroot()
    assert found.findtext("title") == "none <&>"
    assert found.findtext("projectCrs/spatialrefsys/description") == "Moon (2015) - Sphere / Ocentric"
    assert found.findtext("mapcanvas/extent/xmin") == "-180.0"


@pytest.mark.program(SYSTEM_PYTHON, "-c", "import qgis.core", by_ci=False)
def test_qgis_opens_the_project_and_draws_it(folder: Path) -> None:
    ours = ("PROJ_LIB", "PROJ_DATA", "GDAL_DATA", "PYTHONPATH")
    clean = {key: value for key, value in os.environ.items() if key not in ours} | {"QT_QPA_PLATFORM": "offscreen"}
    done = subprocess.run([SYSTEM_PYTHON, "-c", ASK, folder], capture_output=True, text=True, check=True, env=clean)
    said = json.loads(done.stdout.splitlines()[-1])
    assert said["read"]
    assert said["crs"] == "Mars (2015) - Sphere / Ocentric"
    assert said["ellipsoid"] == "PARAMETER:3396190:3396190"
    assert set(said["layers"]) == set(SHAPES)
    for name, one in said["layers"].items():
        assert one["valid"], name
        assert one["crs"] == "Mars (2015) - Sphere / Ocentric"
        assert one["rows"] == len(layer(folder / "solution.gpkg", name).shapes)
        assert sum(one["drawn"]) == one["rows"], f"{name}: each row is drawn once"
    assert said["layers"]["residuals_exaggerated"]["shown"]
    assert not said["layers"]["residuals"]["shown"]
    assert said["colours"] > 20
