"""Makes the applications of the API, which refuse requests with a sentence."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse

from biosensor_common.errors import ConfigError, ConfigReason, GatewayError, TransportReason
from biosensor_gateway.page.advice import clicked
from biosensor_gateway.page.models import Choice, Problem
from biosensor_gateway.page.static_files import PREFIX

_CODES = {ConfigReason.NOT_FOUND: 404, ConfigReason.IN_USE: 409, TransportReason.BUSY: 409}


class QuestionError(ConfigError):
    """A person has to confirm the request first."""

    def __init__(self, title: str, sentence: str, choices: Sequence[Choice]) -> None:
        super().__init__(ConfigReason.IN_USE, sentence)
        self.problem = Problem(problem=sentence, title=title, choices=[*choices])


class OneAtATime:
    """Allows one run of a task at a time; further requests are refused with a sentence."""

    def __init__(self, refused: str) -> None:
        self._refused = refused
        self._goes_on = False

    @contextmanager
    def turn(self) -> Generator[None]:
        """Run the task in the block.

        Raises
        ------
        ConfigError
            ``IN_USE`` if it is running already.
        """
        if self._goes_on:
            raise ConfigError(ConfigReason.IN_USE, self._refused)
        self._goes_on = True
        try:
            yield
        finally:
            self._goes_on = False


def new_app() -> FastAPI:
    """Return an application without documentation pages.

    FastAPI's own ones would load scripts from other servers.
    """
    app = FastAPI(
        title="Biosensor Gateway",
        version="1",
        docs_url=None,
        redoc_url=None,
        openapi_url=f"{PREFIX}/openapi.json",
    )
    app.exception_handler(GatewayError)(_refused)
    app.exception_handler(RequestValidationError)(misformed)
    return app


async def misformed(_request: Request, error: Exception) -> JSONResponse:
    """Answer an invalid request with its first error."""
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"][1:])
    what = first["msg"].removeprefix("Value error, ")
    return JSONResponse(Problem(problem=f"{place or 'the request'}: {what}").model_dump(), 422)


async def _refused(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, GatewayError)
    reason = error.reason
    code = _CODES.get(reason, 400) if isinstance(reason, ConfigReason | TransportReason) else 400
    problem = (
        error.problem if isinstance(error, QuestionError) else Problem(problem=clicked(str(error)))
    )
    return JSONResponse(problem.model_dump(), code)
