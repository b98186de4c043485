"""Tables of findings, of known programs and of what virtual devices do, in Markdown."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from biosensor_common import naming
from biosensor_common.known_senders import KNOWN, KnownStream
from biosensor_common.quantities import ContentType
from biosensor_common.spec import DeviceIdentity, FromDevice, SensorSpec, StreamSpec
from biosensor_gateway.demo.virtual_devices import virtual_class, virtual_names
from biosensor_gateway.devices.registry import (
    declaration,
    declaration_names,
    driver,
    sensor_names,
)
from biosensor_gateway.page.interface import Interface
from biosensor_gateway.page.session import Session, Shutdown
from biosensor_gateway.recording.xdf.explanations import EXPLANATIONS
from biosensor_gateway.simulation.faults import OF_A_KIND, FaultKind, Kind, Untidiness


def senders() -> str:
    """Return a row for each program: what its streams are called, and their topics."""
    programs = dict.fromkeys(stream.program for stream in KNOWN)
    rows = [(program, _names(program), _topics(program)) for program in programs]
    return f"\n{table(('Program', 'LSL streams', 'Topics behind `biosensors/`'), rows)}\n\n"


def _of(program: str) -> list[KnownStream]:
    return [stream for stream in KNOWN if stream.program == program]


def _names(program: str) -> str:
    return ", ".join(f"`{_readable(stream.name)}`" for stream in _of(program))


def _readable(pattern: str) -> str:
    readable = pattern.replace("(?P<unit>.+)", "<device>").replace("[- ]", "-")
    return readable.replace("_?[oO]", "O").replace("_?[sS]", "S")


def _topics(program: str) -> str:
    identities = [(DeviceIdentity(each.sensor, ""), each.data_name) for each in _of(program)]
    prefix = "biosensors/"
    return ", ".join(f"`{naming.topic(*each).removeprefix(prefix)}`" for each in identities)


def findings() -> str:
    """Return a section for each code."""
    parts = [
        f"### {each.title}\n\n`{code}`\n\n- **For a study:** {each.means}\n"
        f"- **To do:** {each.to_do}\n"
        for code, each in EXPLANATIONS.items()
    ]
    return "\n" + "\n".join(parts) + "\n"


KINDS: tuple[Kind, ...] = (*(each for each in FaultKind if each in OF_A_KIND), *Untidiness)


def untidiness() -> str:
    """Return a row for each virtual device, and below it the reasons by their numbers."""
    reasons: list[str] = []
    rows = [
        (f"`{name}`", *(_cell(name, kind, reasons) for kind in KINDS)) for name in virtual_names()
    ]
    head = ("", *(f"`{kind.value}`" for kind in KINDS))
    notes = "\n".join(f"{number}. {reason}" for number, reason in enumerate(reasons, 1))
    return f"\n{table(head, rows)}\n\n{notes}\n\n"


def _cell(name: str, kind: Kind, reasons: list[str]) -> str:
    found = virtual_class(name)
    if kind in found.effects:
        return "has"
    reason = found.impossible()[kind]
    if reason not in reasons:
        reasons.append(reason)
    return f"{reasons.index(reason) + 1}"


# The table of what the page's server can be asked for, from its own description in OpenAPI.


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


# Tables of sensors and topics in Markdown, made from the declarations.

CONTRACT, OURS = "●", "○"
# More channels than this are shown by the first and the last.
_SHOWN_CHANNELS = 10
# What tells of the device and not of its wearer; the short table leaves it out.
_HOUSEKEEPING = frozenset(
    {ContentType.BATTERY, ContentType.QUALITY, ContentType.RSSI, ContentType.STATUS}
)

_COLUMNS = (
    "",
    "Topic",
    "Message",
    "Channels [unit]",
    "Rate, Hz",
    "Chunk topic",
    "LSL type, format",
)


def sensors() -> str:
    """Return a row for each sensor: its page and its signals."""
    specs = [spec for spec in _in_order() if _rank(spec) == 0]
    rows = [
        (f"[{spec.title}](docs/sensors/{spec.name}.md)", f"`{spec.name}`", _signals(spec))
        for spec in specs
    ]
    return f"\n{table(('Sensor', 'Name', 'Signals, as LSL types'), rows)}\n\n"


def topics() -> str:
    """Return all topics: a table for each sensor with a driver first, the agent's own last."""
    return "".join(f"\n{_section(spec)}\n" for spec in _in_order()) + "\n"


def table(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a table in Markdown."""
    ruler = "|".join("---" for _ in columns)
    return "\n".join([_line(columns), f"|{ruler}|", *map(_line, rows)])


def _line(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"


def _in_order() -> list[SensorSpec]:
    return sorted((declaration(name) for name in declaration_names()), key=_rank)


def _rank(spec: SensorSpec) -> int:
    return 2 if spec.name == "gateway" else int(spec.name not in sensor_names())


def _is_an_example(spec: SensorSpec) -> bool:
    """Whether the settings of each device declare what it has, and this is one of them."""
    return _rank(spec) == 0 and driver(spec.name).declare is not None


def _signals(spec: SensorSpec) -> str:
    if _is_an_example(spec):
        return "what its settings declare"
    signals = [stream for stream in spec.streams if stream.content_type not in _HOUSEKEEPING]
    # Continuous ones first: who looks for a sensor looks for these.
    signals.sort(key=lambda stream: not stream.is_regular)
    # A headset has two streams of one type.
    return ", ".join(dict.fromkeys(_signal(stream) for stream in signals))


def _signal(stream: StreamSpec) -> str:
    rate = f" {_rate(stream)} Hz" if stream.is_regular and not stream.is_from_device else ""
    return f"{stream.content_type}{rate}"


def _section(spec: SensorSpec) -> str:
    source = ("driver", "no driver", "the agent itself")[_rank(spec)]
    if _is_an_example(spec):
        source += "; its settings declare the streams, here those of the example"
    rows = [_cells(spec, stream) for stream in spec.streams]
    return f"## {spec.title}\n\n`{spec.name}` ({source})\n\n{table(_COLUMNS, rows)}"


def _cells(spec: SensorSpec, stream: StreamSpec) -> tuple[str, ...]:
    return (
        CONTRACT if stream.contract else OURS,
        f"`{spec.name}/{stream.data_name}`",
        stream.message_type.rpartition("/")[2],
        _channels(stream),
        _rate(stream),
        f"`…/{stream.chunk}_chunk`" if stream.chunk else "",
        f"{stream.content_type}, {stream.format}",
    )


def _rate(stream: StreamSpec) -> str:
    if isinstance(stream.rate, FromDevice):
        return "set by the device"
    return f"{stream.rate:.5g}" if stream.is_regular else "irregular"


def _channels(stream: StreamSpec) -> str:
    groups: list[str] = []
    for unit, labels in _by_unit(stream):
        if len(labels) > _SHOWN_CHANNELS:
            shown = f"{labels[0]} … {labels[-1]} ({len(labels)})"
        else:
            shown = ", ".join(labels)
        groups.append(shown if unit == "none" else f"{shown} [{unit}]")
    return "; ".join(groups)


def _by_unit(stream: StreamSpec) -> Iterator[tuple[str, list[str]]]:
    """Yield neighbouring channels of one unit together, in channel order."""
    labels: list[str] = []
    for index, channel in enumerate(stream.channels):
        labels.append(channel.label)
        following = stream.channels[index + 1 :]
        if not following or following[0].unit != channel.unit:
            yield channel.unit, labels
            labels = []
