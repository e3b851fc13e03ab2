"""Write the generated pages: ``python -m docs.generate``; with ``--check`` say which differ.

The pages of results and mechanisms, the pictures of mechanisms, and the table of results in the
README are made from the committed JSON and from the code. They are committed too, so that they
can be read without a build.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from docs.generate import (
    batch_tables,
    budget_tables,
    calibration_tables,
    diagnosis_tables,
    discovery_tables,
    mechanisms,
    monitor_tables,
    planted_tables,
    readme,
    robot_tables,
    robustness_tables,
    tables,
)
from docs.generate.tables import ROOT

DOCS = ROOT / "docs"
TEMPLATES = Path(__file__).parent / "templates"
_BLOCK = re.compile(r"(<!-- generated: [^>]*-->\n).*?(<!-- end -->)", re.DOTALL)


def pages() -> dict[Path, str]:
    """Return the text of every generated file."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=True,
    )
    names = {
        "batch": batch_tables,
        "budgets": budget_tables,
        "calibration": calibration_tables,
        "diagnosis": diagnosis_tables,
        "discovery": discovery_tables,
        "mechanisms": mechanisms,
        "monitor": monitor_tables,
        "planted": planted_tables,
        "robots": robot_tables,
        "robustness": robustness_tables,
        "tables": tables,
    }
    out = {
        DOCS / name.removesuffix(".j2"): environment.get_template(name).render(names)
        for name in environment.list_templates()
    }
    for name, text in mechanisms.pictures().items():
        out[DOCS / "images" / "mechanisms" / name] = text
    for name, text in mechanisms.sections().items():
        out[DOCS / "mechanisms" / name] = text
    path = ROOT / "README.md"
    text = path.read_text(encoding="utf-8")
    out[path] = _BLOCK.sub(lambda m: f"{m[1]}\n{readme.results_table()}\n\n{m[2]}", text)
    return out


def differing(found: Mapping[Path, str]) -> list[str]:
    """Return the files whose committed text is another; of pictures only those that are missing."""
    return [
        str(path.relative_to(ROOT))
        for path, text in found.items()
        if not path.is_file() or (path.suffix == ".md" and path.read_text(encoding="utf-8") != text)
    ]


def main() -> int:
    """Write or check every generated file."""
    found = pages()
    if "--check" in sys.argv[1:]:
        late = differing(found)
        for name in late:
            print(f"{name} is not what python -m docs.generate writes")
        return 1 if late else 0
    for path, text in found.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
