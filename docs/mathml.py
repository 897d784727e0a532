"""Sphinx extension: formulas as MathML, made when the pages are built. Pages need neither a network nor a script."""

from __future__ import annotations

import re
from html import escape
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx


def markup(formula: str, display: str) -> str:
    """Return a formula as a MathML element; its source is kept for whoever copies it."""
    # Letters of other alphabets become characters of their own if they stand in braces, one by one; words are upright.
    spelled = re.sub(r"\\(mathbb|mathbf|mathcal) ?([A-Za-z])", r"\\\1{\2}", formula.replace("\\mathsf", "\\mathrm"))
    drawn = convert(spelled, display=display)
    note = f'<annotation encoding="application/x-tex">{escape(formula)}</annotation>'
    head, _, rest = drawn.partition(">")
    body = rest.removesuffix("</math>")
    return f"{head}><semantics>{body}{note}</semantics></math>"


def _inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(markup(node.astext(), "inline"))
    raise nodes.SkipNode


def _block(writer: Any, node: nodes.math_block) -> None:
    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    writer.body.append(f'<div class="math">{number}{markup(node.astext(), "block")}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
