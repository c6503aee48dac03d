"""How the pages are built: `sphinx-build -W --keep-going -b html docs site` (pip install ".[docs]").

Nothing is fetched, then or later: no CDN, no fonts, no inventories of other projects. Formulas become MathML.
"""

import os
import sys
from importlib.metadata import version as version_of
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "mgsgraph"
author = "the mgsgraph authors"
copyright = "the mgsgraph authors; Apache-2.0"
release = version = version_of("mgsgraph")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "annotations",
    "mathml",
    "sources",
]
root_doc = "index"
exclude_patterns = ["extensions"]
nitpicky = True
nitpick_ignore_regex = [(r"py:.*", r".*")]  # types in signatures; everything else that is named must be there
suppress_warnings = ["ref.python"]
"""Words of types that several records have."""

myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 4
html_math_renderer = "mathml"
default_role = "code"
smartquotes = False  # they would make dashes of --options

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True, "exclude-members": "__init__"}
autodoc_class_signature = "separated"  # fields of records say it once
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"mgsgraph {release}"
html_static_path = ["_static"]
html_css_files = ["mgsgraph.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
