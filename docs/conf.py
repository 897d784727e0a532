"""Sphinx settings: MyST Markdown, furo, docstrings by autodoc; build with ``make docs``, warnings are errors."""

import sys
from importlib.metadata import version as installed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # extensions of this folder

project = "certigym"
author = "certigym contributors"
copyright = "certigym contributors"
version = release = installed("certigym")  # what pip has put here: pages say what the wheel says

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
extensions += ["mathml", "redirects", "searched_words"]
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 4
exclude_patterns = ["_build", "_certificates"]
default_role = "code"

# copies commands without what they print
copybutton_prompt_text = "$ "
copybutton_line_continuation_character = "\\"

autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_param = False

# `-n` makes every broken link between pages an error; types in docstrings are words, not links
nitpick_ignore_regex = [("py:.*", ".*")]

html_theme = "furo"
html_title = f"certigym {version}"
html_static_path = ["_static"]
html_css_files = ["certigym.css"]
html_js_files = ["gallery.js", "leaderboard.js"]
html_copy_source = False
html_show_copyright = False
