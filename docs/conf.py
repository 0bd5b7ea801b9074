"""How the documentation is built: `sphinx-build docs build/docs` after `pip install '.[docs]'`."""

from importlib.metadata import version as installed

project = "lfrender"
version = release = installed("lfrender")
copyright = "the lfrender authors"
extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["gallery/*", "sg_execution_times.rst"]
html_theme = "furo"
html_title = "lfrender"
html_theme_options = {"source_directory": "docs/"}
myst_heading_anchors = 3
autosummary_generate = True
autodoc_typehints = "none"
numpydoc_show_class_members = False
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "built_gallery",
    "filename_pattern": r"plot_",
    "download_all_examples": False,
    "show_memory": False,
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("matplotlib",),
    "abort_on_example_error": True,
}
