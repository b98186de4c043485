"""``python -m installer.wine [STAGE]``: installer and archive, or the build up to one stage."""

from __future__ import annotations

import os
import sys

from installer.layout import WORK, setup_file
from installer.stages import Build
from installer.wine.recipe import PACKAGE, STAGES


def main() -> None:
    """Bring the wanted stage up to date, or all of them."""
    names = {stage.name: stage for stage in STAGES}
    wanted = sys.argv[1:2] or list(names)
    if not names.keys() >= {*wanted}:
        sys.exit(f"there is no stage {wanted[0]!r}; there are {', '.join(names)}")
    build = Build(WORK)
    for name in wanted:
        build.bring_up_to_date(names[name])
    if PACKAGE.name in wanted:
        file = setup_file()
        sys.stdout.write(f"wrote {os.path.relpath(file)}, {file.stat().st_size / 1e6:.1f} MB\n")


if __name__ == "__main__":
    main()
