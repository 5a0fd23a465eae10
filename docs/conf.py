"""The documentation site: `make docs`, with warnings as errors, writes build/site."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_site"))

import pa10cal

project = "pa10cal"
version = release = pa10cal.__version__
html_title = f"pa10cal {version}"
html_theme = "furo"
html_copy_source = False
html_show_search_summary = False  # it would be fetched, which a page from disk may not do
html_show_copyright = False
extensions = ["myst_parser", "page_links", "generated_parts", "equations"]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
highlight_language = "none"
smartquotes_action = "q"  # options begin with two hyphens
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["site.css"]
exclude_patterns = ["STATUS.md", "_site"]
