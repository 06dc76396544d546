"""The documentation's site: `make docs`. The pages are the repository's own."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "client/src"))

project = "hullcast"
author = "the hullcast developers"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
root_doc = "README"
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
include_patterns = ["*.md", "docs/**", "examples/scenes/README.md", "tests/golden/README.md"]
exclude_patterns = ["docs/site/_*"]
myst_heading_anchors = 4
html_theme = "furo"
html_title = "hullcast"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
# Blocks of JSON with comments, and of commands with their output, have no valid language.
highlight_language = "none"
suppress_warnings = ["misc.highlighting_failure"]

#: The table of contents of the sidebar: titles and their pages.
CONTENTS = {
    "Python": [
        *(f"docs/python/{page}" for page in ("first-contacts", "robots", "finding", "margins", "loops")),
        "docs/simulators",
        *(f"docs/python/{page}" for page in ("workers", "batch-jobs", "accuracy", "derivatives", "fitting")),
        "docs/site/python",
    ],
    "Other languages": [
        *(f"docs/{page}" for page in ("protocol", "languages", "grpcurl", "errors", "identity")),
        "docs/rust",
        "docs/site/rust",
    ],
    "Computation": [
        *(f"docs/{page}" for page in ("algorithm", "playground", "hulls", "find", "sessions")),
        "examples/scenes/README",
    ],
    "Speed and accuracy": [
        *(f"docs/{page}" for page in ("performance", "tradeoff", "simulation")),
        *(f"docs/{page}" for page in ("stability", "fuzzing", "workload")),
        "tests/golden/README",
    ],
    "Operations": [f"docs/{page}" for page in ("operations", "budget", "durability", "reliability")]
    + ["docs/cluster", "docs/capacity"],
    "Development": ["ARCHITECTURE", "CONTRIBUTING", "CHANGELOG", "docs/licences"],
}


def list_the_pages(_app, page, source):
    """Adds the tables of contents to the first page, so that its file has no markup of the site."""
    if page == root_doc:
        for caption, pages in CONTENTS.items():
            listed = "\n".join(pages)
            source[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{listed}\n```\n"


def setup(app):
    app.connect("source-read", list_the_pages)
