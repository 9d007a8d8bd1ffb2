"""Sphinx: `python -m sphinx -W --keep-going -b html docs build/docs`, with what `pip install -e '.[docs]'` brings.

The tutorials are run while the docs are built, and a failed one fails the build; `-D plot_gallery=0` builds without.
Tutorial 4 needs gcc.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import matplotlib as mpl
from sphinx.addnodes import toctree

mpl.use("Agg")

project = "casadical"
author = "The casadical developers"
copyright = author
html_title = "casadical"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["README.md", "tutorials/*", "gallery/front.md"]
default_role = "code"
templates_path: list[str] = []

html_theme = "furo"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_show_copyright = False
pygments_dark_style = "github-dark"

myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath", "attrs_inline"]
suppress_warnings = ["config.cache"]

autosummary_generate = True
autodoc_typehints = "signature"
napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
python_use_unqualified_type_names = True
maximum_signature_line_length = 100

# A notebook has no file name, by which a tutorial finds problems and data.
_NOTEBOOK = """# To be run in the folder of the repository or below it, with `pip install '.[docs]'`.
import sys
from pathlib import Path

root = next(p for p in (Path.cwd(), *Path.cwd().parents) if (p / "problems/ur10").is_dir())
sys.argv = [str(root / "docs/tutorials/notebook.py")]"""

sphinx_gallery_conf = {
    "examples_dirs": ["tutorials"],
    "gallery_dirs": ["gallery"],
    # The fourth compiles C.
    "filename_pattern": r"/tutorial_" if shutil.which("gcc") else r"/tutorial_[^4]",
    "within_subsection_order": "FileNameSortKey",
    "default_thumb_file": str(Path(__file__).parent / "images" / "held_out.png"),
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "first_notebook_cell": _NOTEBOOK,
    "write_computation_times": False,
    "remove_config_comments": True,
    "copyfile_regex": r".*\.rst",
    "junit": "gallery-junit.xml",
    "only_warn_on_example_error": False,
}

# `name : what it is`, our way of describing arguments and fields, becomes a list; sections are napoleon's.
_ITEM = re.compile(r"^(\*{0,2}\w[\w]*(?:, \*{0,2}\w+)*) : (.*)$")


def _as_lists(*arguments: Any) -> None:
    lines: list[str] = arguments[-1]
    out: list[str] = []
    inside, begin = False, next((k - 1 for k, line in enumerate(lines) if re.fullmatch("-{4,}", line)), len(lines))
    for line in lines[:begin]:
        item = _ITEM.match(line)
        if item:
            if not inside:
                out.append("")
            out.append(f"- **{_plain(item[1])}** : {_plain(item[2])}")
            inside = True
        elif inside and line.startswith(" "):
            out.append(f"  {_plain(line.strip())}")
        elif line.startswith("    ") and out and out[-1]:  # a sentence that goes on
            out.append(_plain(line.strip()))
        else:
            out += [""] if inside else []
            inside = False
            out.append(_plain(line))
    lines[:begin] = out


def _plain(text: str) -> str:
    """Stars and bars of formulas are no markup; what stands in backticks is left alone."""
    parts = re.split(r"(`+[^`]*`+)", text)
    return "".join(
        p if k % 2 else re.sub(r"(?<!\\)([*|])|(?<=\w)_(?=\W|$)", r"\\\g<0>", p) for k, p in enumerate(parts)
    )


def _to_gallery(*arguments: Any) -> None:
    """Links to a tutorial's file, which is what there is on a code host, lead to its page; pictures lead there, too."""
    source: list[str] = arguments[-1]
    source[0] = re.sub(r"\(tutorials/(tutorial_\w+)\.py\)", r"(gallery/\1.rst)", source[0])
    names = sorted(path.stem for path in Path(__file__).parent.glob("tutorials/tutorial_*.py"))
    thumb = '[![{0}](gallery/images/thumb/sphx_glr_{0}_thumb.png){{width="30%"}}](gallery/{0}.rst)'
    shown = [thumb.format(name) for name in names]
    source[0] = source[0].replace("<!-- thumbnails -->", "\n".join(shown))


def _front(app: Any) -> None:
    """README.md as the front page takes it, for what an include reads is seen by no other event."""
    text = [(Path(app.srcdir) / "README.md").read_text(encoding="utf-8")]
    _to_gallery(text)
    path = Path(app.srcdir) / "gallery" / "front.md"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text[0], encoding="utf-8")


def _all_pages(_app: Any, name: str, source: list[str]) -> None:
    """Pages that the index does not name come last, so that none is lost."""
    if name == "index":
        named = re.findall(r"^   (?:.*<)?([\w-]+)>?$", source[0], re.MULTILINE)
        more = sorted({page.stem for page in Path(__file__).parent.glob("*.md")} - {*named, "README"})
        lines = ["", ".. toctree::", "   :hidden:", "   :caption: More", "", *(f"   {page}" for page in more)]
        source[0] += "\n".join(lines) if more else ""


def _short_sidebar(_app: Any, env: Any) -> None:
    """The sidebar of every page names the pages; the names of the reference stand on its page alone."""
    for names in list(env.tocs["reference"].findall(toctree)):
        names.parent.remove(names)


def _narrow(_app: Any, _name: str, _template: str, context: dict[str, Any], _tree: Any) -> None:
    """On a phone the index has one column, and long names break."""
    context["metatags"] = context.get("metatags", "") + (
        "<style>@media (max-width: 46em) {.indextable td {display: block; width: auto; overflow-wrap: anywhere}"
        " .domainindex-table {display: block; overflow-x: auto}}</style>"
    )


def setup(app: Any) -> None:
    """Sphinx calls it."""
    app.connect("html-page-context", _narrow)
    app.connect("env-updated", _short_sidebar)
    app.connect("source-read", _to_gallery)
    app.connect("source-read", _all_pages)
    app.connect("builder-inited", _front)
    app.connect("autodoc-process-docstring", _as_lists, priority=100)
