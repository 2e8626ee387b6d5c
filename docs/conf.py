"""Configuration of the documentation: sphinx-build -W -b html docs docs/_build/html.

Nothing is fetched, neither while building nor by a reader: equations become MathML.
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

sys.path.insert(0, str(Path(__file__).parent / "scripts"))  # references, saved_pictures
from references import linked

project = "meshtrace"
author = "The meshtrace developers"
copyright = author
release = installed("meshtrace")
version = ".".join(release.split(".")[:2])

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "_generated", "gallery", "examples/*.ipynb", "joss"]
templates_path = ["_templates"]
default_role = "code"
nitpicky = False
smartquotes_action = "D"  # dashes alone: words of link files are quoted as they are typed

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3

copybutton_prompt_text = r">>> |\.\.\. |\$ "  # not copied, nor is what a command prints
copybutton_prompt_is_regexp = True
copybutton_selector = "div.highlight:not(.highlight-text *):not(.output *) pre"

nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True
nb_output_stderr = "remove"
nb_render_image_options = {"alt": "Drawn by the code above; the text below reads it"}

SLOW = ("light_pattern", "movie", "plunging_crest")  # drawn by the tests, shown as kept
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples",
    "filename_pattern": rf"gallery/(?!{'|'.join(SLOW)})\w+\.py$",
    "within_subsection_order": "ExampleTitleSortKey",
    "image_scrapers": ("saved_pictures.scraper",),
    "capture_repr": (),
    "abort_on_example_error": True,
    "remove_config_comments": True,
    "show_signature": False,
    "write_computation_times": False,
}

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True, "show-inheritance": False}
autodoc_preserve_defaults = True
napoleon_numpy_docstring = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_param = False  # types are words, such as "ndarray, shape (n,)", and no references
napoleon_custom_sections = [("Attributes", "params_style")]

html_theme = "furo"
html_title = f"meshtrace {release}"
html_math_renderer = "mathml"
html_copy_source = False
html_static_path = ["_static"]
html_extra_path = [
    "extra",  # figures/, a page of its own
    "gallery/pictures/light_pattern.mp4",
    "gallery/pictures/movie.mp4",
]
html_css_files = ["meshtrace.css"]
html_js_files = ["pages.js"]
html_search_scorer = str(Path(__file__).with_name("scorer.js"))

QUOTED = re.compile(r"(``[^`]*``|`[^`]*`)")
MARKUP = re.compile(r"(\||(?<=\S)\*|(?<=\S )\*|(?<=\w)_(?!\w))")


def plain_text(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Escape what reStructuredText would take for markup: |x|, a * b and f_ in formulas."""
    block: int | None = None  # indentation of the directive or example that a line is in
    for i, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if block is not None and line.strip() and indent <= block:
            block = None
        if line.lstrip().startswith(">>>"):
            block = indent - 1  # up to the next line that is less deep
        elif line.lstrip().startswith(".. ") or line.rstrip().endswith("::"):
            block = indent
        elif block is None:
            parts = QUOTED.split(line)
            parts[::2] = [MARKUP.sub(r"\\\1", part) for part in parts[::2]]
            lines[i] = "".join(parts)


def without_machinery(
    app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object
) -> bool | None:
    """Leave out what pydantic adds to models, and fields of tuples, which their class explains."""
    pydantic = name.startswith("model_") and name != "model_copy"
    return True if pydantic or type(obj).__name__ == "_tuplegetter" else None


COLUMNS = (90, 100, 120, 144)
"""Widths of blocks that fit a page by smaller letters (meshtrace.css); wider ones scroll."""


def fitted(app: Sphinx, doctree: nodes.document) -> None:
    """Mark blocks by their width; of texts that of their tables, since other lines may wrap."""
    for block in doctree.findall(nodes.literal_block):
        lines = block.astext().splitlines()
        if block.get("language") in ("none", "sh", "text"):
            lines = [line for line in lines if re.search(r"\S {2,}\S", line)]
        longest = max(map(len, lines), default=0)
        size = next((columns for columns in COLUMNS if columns >= longest), "more")
        block["classes"].append(f"columns-{size}")


NAVIGATION: dict[str, str] = {}


def two_levels(
    app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object
) -> None:
    """Limit the navigation to two levels, one tree for all objects of a group.

    A tree for each of some 400 objects would take half of the time of a build.
    """
    if "toctree" not in context:
        return
    full, key = context["toctree"], page
    if page.startswith("api/generated/"):
        groups = app.env.toctree_includes.items()  # no group has the page of a name that is gone
        key = next((group for group, pages in groups if page in pages), page)

    def tree(**options: Any) -> str:
        name = f"{key} from {page.rpartition('/')[0]}"  # links are relative to the folder
        if name not in NAVIGATION:
            NAVIGATION[name] = full(**{**options, "maxdepth": 2})
        return NAVIGATION[name]

    context["toctree"] = tree


def _inline_math(self: HTML5Translator, node: nodes.math) -> None:
    self.body.append(latex2mathml.tex2mathml(node.astext()))
    raise nodes.SkipNode


def _block_math(self: HTML5Translator, node: nodes.math_block) -> None:
    self.body.append('<div class="math-block">')
    self.body.append(latex2mathml.tex2mathml(node.astext(), as_block=True))
    self.body.append("</div>")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer of equations and the reading of docstrings."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_block_math, None))
    app.connect("autodoc-process-docstring", plain_text, priority=400)
    app.connect("autodoc-process-docstring", linked, priority=600)  # napoleon has 500
    app.connect("autodoc-skip-member", without_machinery)
    app.connect("doctree-read", fitted)
    app.connect("html-page-context", two_levels, priority=400)  # before the theme reads it
    return {"parallel_read_safe": True, "parallel_write_safe": True}
