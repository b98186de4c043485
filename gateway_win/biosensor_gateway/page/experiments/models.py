"""Messages of web experiments, and the answers to them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, TypeAdapter

from biosensor_gateway.agent.marking import MAX_TEXT, MAX_WEB_AGE_S
from biosensor_gateway.streaming.markers import TimedBy

_Text = Annotated[str, StringConstraints(max_length=MAX_TEXT)]
_Milliseconds = Annotated[float, Field(allow_inf_nan=False, strict=False)]
_LARGEST = 2**53
_Number = Annotated[int, Field(ge=0, le=_LARGEST)]
_STRICT = ConfigDict(extra="forbid", strict=True)


class NewMark(BaseModel):
    """A marker that is posted.

    Attributes
    ----------
    age_ms
        How long ago it happened, in milliseconds; None if it happens now.
    """

    model_config = _STRICT

    marker: _Text
    note: _Text = ""
    age_ms: Annotated[float, Field(ge=0, le=1000 * MAX_WEB_AGE_S, strict=False)] | None = None


class Hello(BaseModel):
    """The first message of a page.

    Attributes
    ----------
    client
        Which page this is, also after its connection was away.
    resolution_ms
        Steps in which the browser shows its time, in milliseconds.
    """

    model_config = _STRICT

    type: Literal["hello"]
    token: Annotated[str, StringConstraints(max_length=200)]
    client: Annotated[str, StringConstraints(max_length=64)] = ""
    resolution_ms: Annotated[float, Field(ge=0, le=1000, strict=False)] = 1.0


class Pong(BaseModel):
    """The answer to a ping: the browser's time in milliseconds."""

    model_config = _STRICT

    type: Literal["pong"]
    n: _Number
    at: _Milliseconds


class Mark(BaseModel):
    """A marker.

    Attributes
    ----------
    ref
        The page's own number of it; the same for one that is sent again.
    at
        The browser's time in milliseconds at which it happened; None for when it arrives.
    """

    model_config = _STRICT

    type: Literal["mark"]
    ref: _Number
    marker: _Text
    note: _Text = ""
    at: _Milliseconds | None = None


class Sent(BaseModel):
    """A marker that the agent has sent.

    Attributes
    ----------
    id
        Its number in the stream.
    lsl_time
        When it happened, in seconds.
    timed_by, uncertainty_s
        How that is known, and by how many seconds it may be wrong; None if nobody knows.
    """

    id: int
    lsl_time: float
    timed_by: TimedBy
    uncertainty_s: float | None = None


MESSAGE: TypeAdapter[Pong | Mark] = TypeAdapter(Annotated[Pong | Mark, Field(discriminator="type")])
