"""How the documentation is built: `sphinx-build docs build/docs` after `pip install '.[docs]'`."""

import json
import tomllib
import zlib
from importlib.metadata import version as installed
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

project = "lfrender"
version = release = installed("lfrender")
copyright = "the lfrender authors"
extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["gallery/*", "drawings/*", "sg_execution_times.rst"]
html_theme = "furo"
html_title = "lfrender"
html_theme_options = {"source_directory": "docs/"}
html_static_path = ["style"]
html_css_files = ["pages.css"]
html_js_files = ["search_rows.js"]
templates_path = ["templates"]
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
copybutton_prompt_text = "$ "
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
    "thumbnail_size": (640, 448),
}

# Types in docstrings link to the documentation of other projects. A build must not need a network,
# so the few names are listed here instead of being fetched.
numpydoc_xref_param_type = True
numpydoc_xref_aliases = {
    "Path": "pathlib.Path",
    "path-like": "os.PathLike",
    "array": "numpy.ndarray",
    "array_like": ":term:`numpy:array_like`",
    "Axes": "matplotlib.axes.Axes",
    "Calibration": "lfcal.Calibration",
    "Lattice": "lfcal.Lattice",
    "Optics": "lfcal.Optics",
    "Board": "lfcal.Board",
    "DepthMap": "lfrender.DepthMap",
    "Rendering": "lfrender.Rendering",
}
_OTHER_PROJECTS = {
    "python": (
        "https://docs.python.org/3/",
        {
            "bltin-boolean-values std:label": "library/stdtypes.html#boolean-type-bool",
            "bool py:class": "library/functions.html#bool",
            "None py:data": "library/constants.html#None",
            "dict py:class": "library/stdtypes.html#dict",
            "float py:class": "library/functions.html#float",
            "iterable std:term": "glossary.html#term-iterable",
            "sequence std:term": "glossary.html#term-sequence",
            "int py:class": "library/functions.html#int",
            "list py:class": "library/stdtypes.html#list",
            "os.PathLike py:class": "library/os.html#os.PathLike",
            "OSError py:exception": "library/exceptions.html#OSError",
            "pathlib.Path py:class": "library/pathlib.html#pathlib.Path",
            "str py:class": "library/stdtypes.html#str",
            "tuple py:class": "library/stdtypes.html#tuple",
            "ValueError py:exception": "library/exceptions.html#ValueError",
        },
    ),
    "numpy": (
        "https://numpy.org/doc/stable/",
        {
            "array_like std:term": "glossary.html#term-array_like",
            "numpy.ndarray py:class": "reference/generated/numpy.ndarray.html#numpy.ndarray",
        },
    ),
    "matplotlib": (
        "https://matplotlib.org/stable/",
        {
            "matplotlib.axes.Axes py:class": (
                "api/_as_gen/matplotlib.axes.Axes.html#matplotlib.axes.Axes"
            ),
        },
    ),
}


def _inventory(project: str, names: dict[str, str]) -> str:
    """A file that lists names of another project, in the form that Sphinx reads."""
    head = (
        f"# Sphinx inventory version 2\n# Project: {project}\n# Version: \n"
        "# The remainder of this file is compressed using zlib.\n"
    )
    lines = "".join(f"{name} 1 {place} -\n" for name, place in names.items())
    file = Path(mkdtemp()) / "objects.inv"
    file.write_bytes(head.encode() + zlib.compress(lines.encode()))
    return str(file)


def _show_examples(_app: object, ctx: Any, lines: list[str]) -> None:
    """The examples at the end of a command's help as a block of code."""
    calls = [line for line in (ctx.command.epilog or "").splitlines() if line.startswith("  ")]
    if calls:
        lines[:] = [
            "**Examples**",
            "",
            ".. code-block:: sh",
            "",
            *(f"   {line.strip()}" for line in calls),
            "",
        ]


def _describe_object(name: str, result: Any) -> str:
    """The keys of what a command prints with --json, as a section of its page."""
    rows = [f"   * - ``{key}``\n     - {told}" for key, told in result.meanings.items()]
    link = f":download:`JSON Schema <schemas/{name}.json>`"
    head = [
        "",
        "Keys of --json",
        "--------------",
        "",
        f"{link}; keys without a value are null.",
        "",
    ]
    table = [".. list-table::", "   :widths: 1 3", "", *rows, ""]
    return "\n".join([*head, *table])


def _write_commands(_app: object) -> None:
    """`built_commands`: a page for each command, and `overview.md` with all of them by workflow, as
    in `--help`.
    """
    import click

    import data_synth.cli
    import lfcal.cli.main
    import lfrender.cli.main
    from lfcal.runtime.command_line import json_schema

    folder = Path(__file__).with_name("built_commands")
    folder.mkdir(exist_ok=True)
    pages = [("lfsynth", data_synth.cli.main, "data_synth.cli:main")]
    rows = ["| to | command | |", "|---|---|---|"]
    for program, group in (("lfcal", lfcal.cli.main.main), ("lfrender", lfrender.cli.main.main)):
        for section in group.list_sections(click.Context(group)):
            for number, (name, command) in enumerate(section.list_commands()):
                title = "" if number else f"**{section.title}**"
                page = f"[`{program} {name}`]({program}-{name}.rst)"
                rows.append(f"| {title} | {page} | {command.get_short_help_str(100)} |")
                pages.append(
                    (f"{program} {name}", command, f"{command.callback.__module__}:{name}")
                )
    folder_of_schemas = folder / "schemas"
    folder_of_schemas.mkdir(exist_ok=True)
    summary = data_synth.cli.main.get_short_help_str(100)
    rows.append(f"| **Simulate** | [`lfsynth`](lfsynth.rst) | {summary} |")
    for program, command, place in pages:
        name = program.replace(" ", "-")
        text = f".. click:: {place}\n   :prog: {program}\n"
        if (result := getattr(command.callback, "result", None)) is not None:
            text += _describe_object(name, result)
            schema = json.dumps(json_schema(result), indent=1)
            (folder_of_schemas / f"{name}.json").write_text(schema, encoding="utf-8")
        (folder / f"{name}.rst").write_text(text, encoding="utf-8")
    contents = [
        "```{toctree}",
        ":hidden:",
        ":maxdepth: 1",
        "",
        *sorted(p.replace(" ", "-") for p, *_ in pages),
        "```",
    ]
    (folder / "overview.md").write_text(
        "\n".join(["# All commands", "", *rows, "", *contents, ""]), encoding="utf-8"
    )


def _write_messages(_app: object) -> None:
    """`built_messages/index.md`: the messages of `messages.toml` in tables, one for each group."""
    here = Path(__file__).parent
    groups = tomllib.loads((here / "messages.toml").read_text(encoding="utf-8"))
    lines = [
        "# Messages",
        "",
        "The warnings and errors of all commands, and what to do. `…` stands for names and numbers.",
        "[Troubleshooting](/troubleshooting.md) explains what is common to them.",
    ]
    for title, messages in groups.items():
        lines += ["", f"## {title}", "", "| message | what to do |", "|---|---|"]
        for message, advice in messages.items():
            cells = (f" `{message}` ", f" {advice} ")
            row = "|".join(cell.replace("|", "\\|") for cell in cells)
            lines.append(f"|{row}|")
    folder = here / "built_messages"
    folder.mkdir(exist_ok=True)
    (folder / "index.md").write_text("\n".join([*lines, ""]), encoding="utf-8")


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("builder-inited", _write_commands)
    app.connect("builder-inited", _write_messages)
    app.connect("sphinx-click-process-epilog", _show_examples)


intersphinx_mapping = {
    name: (url, _inventory(name, names)) for name, (url, names) in _OTHER_PROJECTS.items()
}
