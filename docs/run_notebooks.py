"""Run the notebooks of docs/notebooks/ and store what they print: `python docs/run_notebooks.py [FILE ...]`.

The cells of a notebook run in order in one process, in an empty folder.
"""

from __future__ import annotations

import json
import sys
import tempfile
from contextlib import chdir, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

NOTEBOOKS = Path(__file__).parent / "notebooks"


def executed(notebook: dict[str, Any]) -> dict[str, Any]:
    """Return a notebook with what its cells print; raises what a cell raises."""
    names: dict[str, Any] = {"__name__": "__main__"}
    cells, count = [], 0
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for cell in notebook["cells"]:
            if cell["cell_type"] != "code":
                cells.append(cell)
                continue
            printed, count = StringIO(), count + 1
            with redirect_stdout(printed):
                exec(compile("".join(cell["source"]), f"cell {count}", "exec"), names)
            text = printed.getvalue().splitlines(keepends=True)
            outputs = [{"output_type": "stream", "name": "stdout", "text": text}] if text else []
            cells.append({**cell, "execution_count": count, "outputs": outputs})
    return {**notebook, "cells": cells}


def main() -> int:
    """Run the notebooks on the command line, or all."""
    for file in [Path(name) for name in sys.argv[1:]] or sorted(NOTEBOOKS.glob("*.ipynb")):
        notebook = executed(json.loads(file.read_text(encoding="utf-8")))
        file.write_text(json.dumps(notebook, indent=1) + "\n", encoding="utf-8")
        print(f"{file}: run")
    return 0


if __name__ == "__main__":
    sys.exit(main())
