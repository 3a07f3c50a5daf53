"""The page that shows what has been remade: the paper's own numbers, ours, the data, and what differs."""

import html
from pathlib import Path
from typing import Any

from workbench.files import atomic_path
from workbench.reproduction.items import Item
from workbench.reproduction.study import results

PAGE = "index.html"
STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --paper: #fff; --soft: #5b6570; --line: #d7dce1; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ec; --paper: #16191d; --soft: #9aa4ae; --line: #353b42; } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 2rem auto;
  max-width: 62rem; padding: 0 1rem; }
h2 { border-top: 1px solid var(--line); padding-top: 1.5rem; margin-top: 2.5rem; }
figure { margin: 1rem 0; } figcaption, .soft { color: var(--soft); }
img { max-width: 100%; height: auto; background: #fff; border-radius: 4px; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--soft); } th, td { padding: 0.25rem 0.8rem; text-align: right;
  border-bottom: 1px solid var(--line); } th:first-child, td:first-child { text-align: left; }
"""


def write_page(folder: str | Path) -> Path:
    """Write `index.html` over all results in the folder, and return its path. Pictures and tables stay next to it."""
    sections = [_section(item, content) for item, content in results(folder)]
    text = (
        '<!doctype html><html lang="en"><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>The papers, remade</title><style>{STYLE}</style><h1>The papers, remade</h1>{''.join(sections)}</html>"
    )
    path = Path(folder) / PAGE
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def _section(item: Item, content: dict[str, Any]) -> str:
    quick = " A quick run: it shows that the experiment works, not what it finds." if content["inputs"]["quick"] else ""
    parts = [
        f'<h2 id="{item.name}">{_text(item.title)} <span class="soft">· {_text(item.paper)} {_text(item.place)}</span>'
        f"</h2><p><b>The paper:</b> {_text(item.printed)}</p><p><b>Here:</b> {_text(content['data'] + quick)}</p>",
        *(_table(item, table) for table in content["tables"]),
        *(_figure(item, figure) for figure in content["figures"]),
        *(f"<p>{_text(note)}</p>" for note in content["notes"]),
    ]
    return "".join(parts)


def _table(item: Item, table: dict[str, Any]) -> str:
    head = "".join(f"<th>{_text(cell)}</th>" for cell in table["header"])
    rows = "".join("<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>" for row in table["rows"])
    address = f"{item.name}/{table['file']}"
    return (
        f'<div class="wide"><table><caption>{_text(table["title"])} (<a href="{address}">CSV</a>)</caption>'
        f"<tr>{head}</tr>{rows}</table></div>"
    )


def _figure(item: Item, figure: dict[str, Any]) -> str:
    caption = _text(figure["caption"])
    return (
        f'<figure><img src="{item.name}/{figure["file"]}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'
    )


def _text(text: object) -> str:
    return html.escape(str(text))
