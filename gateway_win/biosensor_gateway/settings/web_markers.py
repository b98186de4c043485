"""The settings of markers that web experiments send: who may, and where."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

USUAL_PORT = 17871
OF_NO_SITE = "null"
"""What a browser names as origin of a page that was opened from a file."""

_MAX_ORIGINS = 20
_MAX_ORIGIN_LENGTH = 200
_NAME = r"(?:[a-z0-9_-]+\.)*[a-z0-9_-]+|\[[0-9a-f:.]+\]"
_ORIGIN = re.compile(rf"(?P<scheme>https?)://(?:{_NAME})(?P<port>:[1-9][0-9]{{0,4}})?")
_IMPLIED = {"http": ":80", "https": ":443"}


def _origin(value: str) -> str:
    """Refuse what no browser says of itself, for it would silently let nobody in."""
    if value == OF_NO_SITE:
        return value
    parts = _ORIGIN.fullmatch(value)
    if parts is None or len(value) > _MAX_ORIGIN_LENGTH:
        raise ValueError(
            "should be where the experiment's page comes from, in small letters and without a "
            "path, such as https://study.example.org or http://localhost:8080; or null for a "
            "page that is opened from a file"
        )
    if parts["port"] == _IMPLIED[parts["scheme"]]:
        raise ValueError(f"should not have {parts['port']}, which browsers leave out")
    return value


class WebMarkerSettings(BaseModel):
    """Which web pages may send markers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    origins: tuple[Annotated[str, AfterValidator(_origin)], ...] = Field(
        default=(),
        max_length=_MAX_ORIGINS,
        strict=False,
        examples=[["http://localhost:8080"]],
        description="Where web experiments come from that may send markers, such as "
        "https://study.example.org; null is a page that was opened from a file, and also one that "
        "any site hides its name of. Without any, nothing listens. They also need the token that "
        "this command shows: biosensor-gateway mark --web",
    )
    port: int = Field(
        default=USUAL_PORT,
        ge=1024,
        le=65535,
        description="Port on this computer at which the program of the page listens for them.",
    )
