"""Run the cells of code of a notebook, one after the other, in one namespace.

python notebook_runs.py NOTEBOOK
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

cells = json.loads(Path(sys.argv[1]).read_text("utf-8"))["cells"]
scope: dict[str, object] = {"__name__": "__main__"}
for number, cell in enumerate(cells, 1):
    if cell["cell_type"] == "code":
        exec(compile("".join(cell["source"]), f"cell {number}", "exec"), scope)
