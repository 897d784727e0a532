"""Sphinx settings: MyST Markdown, furo, docstrings by autodoc; build with ``make docs``, warnings are errors."""

import certigym

project = "certigym"
author = "certigym contributors"
copyright = "certigym contributors"
version = release = certigym.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
exclude_patterns = ["_build", "_certificates"]
default_role = "code"

autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_param = False

# `-n` makes every broken link between pages an error; types in docstrings are words, not links
nitpick_ignore_regex = [("py:.*", ".*")]

html_theme = "furo"
html_title = f"certigym {version}"
html_copy_source = False
html_show_copyright = False
