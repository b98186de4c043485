"""``python -m installer.wine [STAGE]``: the installer, or the build up to one stage."""

from __future__ import annotations

import sys

from installer.layout import WORK
from installer.stages import Build
from installer.wine.recipe import STAGES


def main() -> None:
    """Bring the wanted stage up to date."""
    names = {stage.name: stage for stage in STAGES}
    wanted = sys.argv[1] if len(sys.argv) > 1 else STAGES[-1].name
    if wanted not in names:
        sys.exit(f"there is no stage {wanted!r}; there are {', '.join(names)}")
    Build(WORK).bring_up_to_date(names[wanted])


if __name__ == "__main__":
    main()
