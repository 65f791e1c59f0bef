"""Sphinx configuration of the documentation; build.py runs it on a copy of this folder with the generated pages.

Sphinx with MyST (Markdown) and sphinx-gallery: all three are maintained, run tutorials while they build, search
without a server, and treat warnings as errors. The theme Furo has a light and a dark face and loads nothing from
elsewhere.
"""

from typing import Any

from cosim.version import VERSION
from docs.gallery import name_pages, tidy

project = "motion-cosim"
author = copyright = "the motion-cosim authors, MIT licence"
version = release = VERSION

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "docs.access",
    "docs.docstrings",
    "docs.equations",
    "docs.keys",
    "docs.latex",
    "docs.shell",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["components/systems", "examples", "schemas", "tutorials"]
suppress_warnings = [
    "config.cache",  # functions in the configuration below
    "sphinx_gallery.space_in_filename",  # a checkout may lie in any folder; the names of the pages have no blanks
]

myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist"]
myst_heading_anchors = 4

autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
autodoc_type_aliases = {"Array": "Array", "NDArray": "NDArray"}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 60
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_math_renderer = "mathml"
html_title = "motion-cosim"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
pygments_style = "default"
pygments_dark_style = "monokai"

smartquotes = False  # texts stand on the site as they stand in the code
copybutton_prompt_text = "$ "
copybutton_exclude = ".linenos, .gp, .go"

sphinx_gallery_conf = {
    "examples_dirs": ["tutorials"],
    "gallery_dirs": ["tutorial"],
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("matplotlib", "docs.gallery.scrape"),
    "capture_repr": ("_repr_html_",),
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,  # no times on the pages: the same sources give the same bytes
    "write_computation_times": False,
    "reset_modules": (),
    "remove_config_comments": True,
    "abort_on_example_error": True,
}


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("doctree-read", tidy)
    app.connect("env-updated", name_pages)
