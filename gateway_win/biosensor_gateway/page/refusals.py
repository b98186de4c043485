"""How a request is refused whose content is not what the interface takes."""

from __future__ import annotations

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse

from biosensor_gateway.page.models import Problem


async def misformed(_request: Request, error: Exception) -> JSONResponse:
    """Answer with the place and the first thing that is wrong there."""
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"][1:])
    return JSONResponse(
        Problem(problem=f"{place or 'the request'}: {first['msg']}").model_dump(), 422
    )
