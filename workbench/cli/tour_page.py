"""The guided tour as a page to read: a notebook's text and code, for the app, which shows no notebooks."""

import html
import re
from pathlib import Path

from workbench.files import atomic_path

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ max-width: 860px; margin: 32px auto; padding: 0 20px; font: 16px/1.55 system-ui, sans-serif; }}
table {{ border-collapse: collapse; margin: 12px 0; }}
td, th {{ padding: 4px 12px 4px 0; text-align: left; vertical-align: top; border-bottom: 1px solid #8884; }}
pre {{ padding: 10px 14px; overflow-x: auto; background: #8881; border-radius: 4px; font: 13px/1.45 monospace; }}
.note {{ padding: 8px 14px; border-left: 3px solid #2196f3; background: #2196f31a; }}
.anchor-link, .jp-InputPrompt, .jp-Collapser {{ display: none; }}
</style>
</head>
<body>
<p class="note">This is the tour to read. With its panels and pictures it is the notebook {name}: <code>workbench
lab</code> opens it.</p>
{body}
</body>
</html>
"""
LINK_TO_NOTEBOOK = re.compile(r'<a [^>]*href="[^"]*\.ipynb"[^>]*>(.*?)</a>', re.DOTALL)
GREEK_INDEX = re.compile(r"\$(\w)_\\(\w+)\$")
"""A letter with a Greek index, the only formulas of the tour: the page brings no MathJax."""


def write_tour_page(notebook: Path, page: Path) -> None:
    """Write a notebook's text and code as one HTML file that needs no other."""
    from nbconvert.exporters import HTMLExporter  # here: only the app needs it, and it takes a second
    from traitlets.config import Config

    without_ways = Config(TagRemovePreprocessor={"enabled": True, "remove_cell_tags": ["navigation"]})
    exporter = HTMLExporter(without_ways, template_name="basic", exclude_input_prompt=True)
    body = exporter.from_filename(str(notebook))[0]
    body = GREEK_INDEX.sub(r"<i>\1</i><sub>&\2;</sub>", LINK_TO_NOTEBOOK.sub(r"\1", body))
    heading = re.search("<h1[^>]*>([^<]+)", body)
    title = heading[1] if heading else html.escape(notebook.stem)
    with atomic_path(page) as path:
        path.write_text(PAGE.format(title=title, name=html.escape(notebook.name), body=body), encoding="utf-8")
