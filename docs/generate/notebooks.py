"""Notebooks as pages of the site, with the outputs that were committed.

A hook of MkDocs: named in ``mkdocs.yml`` under ``hooks``. Notebooks stand outside the folder of the
pages, where readers look for them. They go through Markdown, so that formulas, search and colours
are those of every other page.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Add ``notebooks/NAME.md`` and the pictures in it for every notebook of the repository."""
    for path in sorted((Path(config.docs_dir).parent / "notebooks").glob("*.ipynb")):
        resources: dict[str, Any] = {"output_files_dir": path.stem}
        text, resources = MarkdownExporter().from_filename(str(path), resources)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        for name, picture in resources["outputs"].items():
            files.append(File.generated(config, f"notebooks/{name}", content=picture))
    return files
