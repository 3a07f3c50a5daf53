"""How the documentation is built: `make docs`, without network."""

import ast
import inspect
import os
import re
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
HERE = ROOT / "docs"
sys.path.insert(0, str(HERE))

from pages import api_page, architecture_page, packages, papers_page  # noqa: E402

project = "Face Energy Workbench"
copyright = "the authors of the Face Energy Workbench"
version = release = next(
    ast.literal_eval(line.partition("=")[2].strip())
    for line in (ROOT / "workbench" / "__init__.py").read_text(encoding="utf-8").splitlines()
    if line.startswith("__version__")
)

# What is written elsewhere and shown here: the notebooks, the layers of the package, the papers' lines, the changes.
MADE = HERE / "_made"
shutil.rmtree(MADE, ignore_errors=True)
shutil.copytree(ROOT / "notebooks", MADE / "notebooks", ignore=shutil.ignore_patterns(".ipynb_checkpoints"))
(MADE / "architecture.md").write_text(architecture_page(ROOT), encoding="utf-8")
(MADE / "papers.md").write_text(papers_page(ROOT), encoding="utf-8")
shutil.copy(ROOT / "CHANGELOG.md", MADE / "changelog.md")
(MADE / "api").mkdir()
for package in packages(ROOT):
    (MADE / "api" / f"{package}.md").write_text(api_page(ROOT, package), encoding="utf-8")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.viewcode", "sphinx_copybutton", "mathml"]
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb"}
exclude_patterns = ["_build"]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3

# Notebooks are stored without outputs; they run here unless WORKBENCH_DOCS_NOTEBOOKS=off, and again when they change.
nb_execution_mode = "off" if os.environ.get("WORKBENCH_DOCS_NOTEBOOKS") == "off" else "cache"
nb_execution_cache_path = str(ROOT / ".cache" / "notebooks")
nb_execution_timeout = 900
nb_execution_raise_on_error = True
# Panels and views need a kernel; the pages show what they are called, and no script from another host.
nb_ipywidgets_js = {}
nb_mime_priority_overrides = [
    ("*", "application/vnd.jupyter.widget-view+json", None),
    ("*", "application/vnd.jupyter.widget-state+json", None),
]

html_math_renderer = "mathml"

default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_use_type_comments = False
python_use_unqualified_type_names = True
maximum_signature_line_length = 100

html_theme = "furo"
html_title = project
html_copy_source = False
pygments_style, pygments_dark_style = "friendly", "monokai"
copybutton_prompt_text = "$ "


ESCAPED = re.compile(r"(`[^`]*`)|([|*]|(?<=\w)_(?!\w))")


def as_prose(_app, _what, _name, thing, _options, lines):
    """Docstrings are prose with `code`: whatever else has a meaning in reStructuredText stands for itself."""
    if (
        isinstance(thing, dict | list | tuple | str | int | float)
        and lines[:1] == inspect.getdoc(type(thing)).splitlines()[:1]
    ):
        lines.clear()  # what Python says of every dictionary
    kept = [line for line in lines if not line.startswith("Alias for field number")]
    lines[:] = [ESCAPED.sub(lambda found: found[1] or "\\" + found[2], line) for line in kept]


def setup(app):
    """Connect what changes docstrings on their way to a page."""
    app.connect("autodoc-process-docstring", as_prose)
