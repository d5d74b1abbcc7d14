"""Configuration of the site, which `make docs` builds from these pages, the docstrings and the commands' help.

The source folder of Sphinx is the top of the checkout, so that relative links between files work in the checkout, in
the site and in a repository's web view.
"""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import generate
from numpydoc.xref import DEFAULT_LINKS

import sigmaswarm

project = "sigmaswarm"
author = "The sigmaswarm developers"
copyright = author
version = release = sigmaswarm.__version__

root_doc = "docs/index"
include_patterns = ["docs/**", "examples/*.ipynb", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md"]
exclude_patterns = ["docs/_build", "docs/_templates", ".*", "src", "tests", "benchmarks", "dist", "demo"]
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc"]

# Pages. The anchors of headings are those of a repository's web view.
myst_heading_anchors = 4
myst_links_external_new_tab = False
nb_execution_mode = "off"  # `make notebook` executes the notebooks and saves their outputs
suppress_warnings = ["myst.xref_ambiguous"]

# The reference. The docstrings contain the types, so signatures omit them.
autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
templates_path = [
    str(Path(__file__).parent / "_templates")
]  # absolute, since autosummary and Sphinx resolve relative paths differently
numpydoc_show_class_members = False
numpydoc_xref_param_type = True  # link the types of this library in docstrings to their pages
numpydoc_xref_aliases = {name: f"sigmaswarm.{name}" for name in sigmaswarm.__all__}
numpydoc_xref_ignore = "all"
DEFAULT_LINKS.clear()  # links to Python's own documentation, which is not part of the site
add_module_names = False
default_role = "py:obj"

# Appearance. The site loads nothing from the network.
html_theme = "pydata_sphinx_theme"
html_title = "sigmaswarm"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_use_opensearch = ""
html_theme_options: dict[str, Any] = {
    "show_prev_next": True,
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "secondary_sidebar_items": ["page-toc"],
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": [],
}


def setup(app: Any) -> None:
    """Write the generated pages before Sphinx collects the pages, and index.html at the top of the site afterwards."""
    app.connect("builder-inited", lambda _: generate.write_commands(), priority=1)
    app.connect("autodoc-process-docstring", _example)
    app.connect("build-finished", _redirect)


def _example(_: Any, what: str, name: str, __: Any, ___: Any, lines: list[str]) -> None:
    """Link the page of a public name to the reference page that contains an example."""
    short = name.rpartition(".")[2]
    page = generate.homes().get(short)
    if page and what in ("class", "function") and len(name.split(".")) == 2:
        lines += ["", f"An example that runs: :doc:`/docs/reference/{page}`."]


def _redirect(app: Any, error: Exception | None) -> None:
    if error is None and app.builder.name == "html":
        to = "docs/index.html"
        (Path(app.outdir) / "index.html").write_text(
            f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>sigmaswarm</title>'
            f'<meta http-equiv="refresh" content="0; url={to}"></head>'
            f'<body><a href="{to}">sigmaswarm</a></body></html>\n'
        )
