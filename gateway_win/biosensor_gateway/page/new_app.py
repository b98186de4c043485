"""The application that the interfaces of both pages are made of."""

from __future__ import annotations

from fastapi import FastAPI

from biosensor_gateway.page.static_files import PREFIX


def new_app() -> FastAPI:
    """Return an application without pages that load scripts of other servers."""
    return FastAPI(
        title="Biosensor Gateway",
        version="1",
        docs_url=None,
        redoc_url=None,
        openapi_url=f"{PREFIX}/openapi.json",
    )
