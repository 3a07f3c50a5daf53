"""Formulas as MathML, which browsers draw themselves: no script, and nothing from another host."""

from docutils import nodes
from latex2mathml.converter import convert


def inline(translator, node):
    """A formula in a line of text."""
    translator.body.append(convert(node.astext(), display="inline"))
    raise nodes.SkipNode


def display(translator, node):
    """A formula in a line of its own."""
    translator.body.append(convert(node.astext(), display="block"))
    raise nodes.SkipNode


def setup(app):
    """Make it a choice for `html_math_renderer`."""
    app.add_html_math_renderer("mathml", (inline, None), (display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
