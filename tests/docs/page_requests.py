"""The table of what the page's server can be asked for, from its own description in OpenAPI."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from biosensor_gateway.page.interface import Interface
from biosensor_gateway.page.session import Session, Shutdown
from tests.docs.sensor_table import table


def requests() -> str:
    """Return each request with what it takes, what it answers, and what it does."""
    session = Session(Path("nowhere"), Path("nowhere"))
    described = Interface(session, Shutdown(session)).app.openapi()
    rows = [
        (f"`{method.upper()} {path}`", _body(request), _answer(request), _does(request))
        for path, methods in described["paths"].items()
        for method, request in methods.items()
    ]
    models = described["components"]["schemas"]
    fields = [_fields(name, models[name]) for name in sorted(models) if _is_ours(name)]
    requested = table(("Request", "Takes", "Answers", "What it does"), rows)
    return f"\n{requested}\n\n## Models\n\n" + "\n\n".join(fields) + "\n\n"


def _is_ours(name: str) -> bool:
    return not name.startswith(("HTTP", "Validation"))


def _does(request: dict[str, Any]) -> str:
    return request.get("description", "").partition("\n\n")[0].replace("\n", " ")


def _body(request: dict[str, Any]) -> str:
    parts = [f"`{each['name']}`" for each in request.get("parameters", ())]
    content = request.get("requestBody", {}).get("content", {})
    parts += [_type(each["schema"]) for each in content.values()]
    return ", ".join(parts)


def _answer(request: dict[str, Any]) -> str:
    content = request["responses"].get("200", {}).get("content", {})
    return ", ".join(_type(each["schema"]) for each in content.values() if each.get("schema"))


def _fields(name: str, model: dict[str, Any]) -> str:
    about = model.get("description", "").partition("\n\n")[0].replace("\n", " ")
    if "properties" not in model:
        return f"### {name}\n\n{about}\n\n{_type(model)}"
    required = set(model.get("required", ()))
    lines = [
        f"- `{field}`: {_type(schema)}{'' if field in required else ', or its default'}"
        for field, schema in model["properties"].items()
    ]
    return f"### {name}\n\n{about}\n\n" + "\n".join(lines)


def _type(schema: dict[str, Any]) -> str:
    match schema:
        case {"$ref": path}:
            name = path.rpartition("/")[2]
            text = f"[{name}](#{name.lower()})"
        case {"anyOf": either}:
            text = " or ".join(_type(each) for each in either)
        case {"allOf": [only, *_]}:
            text = _type(only)
        case {"const": value}:
            text = f"`{value}`"
        case {"enum": values}:
            text = " or ".join(f"`{each}`" for each in values)
        case {"type": "array"}:
            text = f"list of {_type(schema.get('items', {}))}"
        case {"type": "object", "additionalProperties": values} if values is not True:
            text = f"object of {_type(values)}"
        case _:
            text = str(schema.get("type", "anything"))
    return text
