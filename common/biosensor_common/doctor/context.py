"""Tells checks which program asks, and how it takes part in LSL."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from biosensor_common.doctor.guide import Guide
from biosensor_common.errors import ConfigError
from biosensor_common.lsl_config import LslOverrides, effective_config, user_config_file


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """The program on whose behalf this computer is examined.

    Attributes
    ----------
    guide
        Its words and its remedies.
    overrides
        What its settings put over the user's own LSL configuration.
    """

    guide: Guide
    overrides: LslOverrides = field(default_factory=LslOverrides)

    @property
    def lsl_file(self) -> Path | None:
        """The user's own LSL configuration that LSL programs started here would read."""
        return user_config_file(os.environ, Path.home(), Path.cwd())

    @property
    def config(self) -> str:
        """The LSL configuration of the program, without the user's file if that is damaged."""
        try:
            return effective_config(self.lsl_file, self.overrides)
        except ConfigError:
            return effective_config(None, self.overrides)

    @property
    def streams_to_open(self) -> int:
        """How many streams the program is going to open here."""
        return 0

    @property
    def offered(self) -> frozenset[str]:
        """The source_ids of the streams that the program says it has open here."""
        return frozenset()
