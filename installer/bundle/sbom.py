"""Writes the software bill of materials: CycloneDX 1.6 as JSON."""

from __future__ import annotations

import hashlib
import json
import os
import uuid
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib import metadata
from typing import Any, cast

from cyclonedx import model
from cyclonedx.model import bom as model_bom
from cyclonedx.model import component as model_component
from cyclonedx.model import contact as model_contact
from cyclonedx.model import license as model_license
from cyclonedx.model.component import ComponentType
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

from installer.bundle.model import BundledFile, Component
from installer.layout import PROGRAM

FILE_NAME = "sbom.cdx.json"
_LIBRARY = "cyclonedx-python-lib"
"""Named as the tool that has written it."""
MODULE = f"{PROGRAM}:module"
LICENCE_TEXT = f"{PROGRAM}:licence-text"
NOTE = f"{PROGRAM}:licence-note"

# The library's decorators hide the constructors from type checkers.
_Bom: Any = model_bom.Bom
_Entry: Any = model_component.Component
_Expression: Any = model_license.LicenseExpression
_Hash: Any = model.HashType
_Property: Any = model.Property
_Organisation: Any = model_contact.OrganizationalEntity

# Serial numbers are derived from this and the rest of the document.
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "https://cyclonedx.org/schema/bom-1.6")


def write_sbom(
    product: Component, others: Sequence[Component], documents: Iterable[BundledFile]
) -> bytes:
    """Write the bill of materials of a bundle.

    Parameters
    ----------
    product
        What the bundle is.
    others
        Everything else in it.
    documents
        Licence texts and pages, which are parts of the installation, too.

    Returns
    -------
    bytes
        The document; the same for the same bundle. It tells a time only if
        ``SOURCE_DATE_EPOCH`` gives one.
    """
    entries = {each.name: _entry(each) for each in others}
    root = _entry(product, ComponentType.APPLICATION, documents)
    bom = _Bom(components=entries.values(), serial_number=uuid.UUID(int=0))
    bom.metadata.component = root
    bom.metadata.supplier = _Organisation(name=product.supplier)
    bom.metadata.tools.components.add(
        _Entry(name=_LIBRARY, version=metadata.version(_LIBRARY), type=ComponentType.LIBRARY)
    )
    entries[product.name] = root
    for each in (product, *others):
        bom.register_dependency(entries[each.name], [entries[name] for name in each.needs])
    document = cast("dict[str, object]", json.loads(JsonV1Dot6(bom).output_as_string()))
    _set_time(document)
    del document["serialNumber"]
    digest = hashlib.sha256(_dump(document)).hexdigest()
    document["serialNumber"] = uuid.uuid5(_NAMESPACE, digest).urn
    return _dump(document)


def _dump(document: dict[str, object]) -> bytes:
    return (json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n").encode()


def _set_time(document: dict[str, object]) -> None:
    described = cast("dict[str, object]", document["metadata"])
    del described["timestamp"]
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if epoch is not None:
        described["timestamp"] = datetime.fromtimestamp(int(epoch), UTC).isoformat()


def _entry(
    component: Component,
    kind: ComponentType = ComponentType.LIBRARY,
    texts: Iterable[BundledFile] = (),
    within: str = "",
    supplier: str = "",
) -> object:
    """Make an entry; its reference names the component that it is within, which supplies it."""
    supplier = component.supplier or supplier
    reference = f"{within}{component.name}@{component.version or ''}"
    properties = [_Property(name=MODULE, value=name) for name in component.modules]
    properties += [
        _Property(name=LICENCE_TEXT, value=f"licenses/{text.path}") for text in component.texts
    ]
    if component.note:
        properties.append(_Property(name=NOTE, value=component.note))
    return _Entry(
        name=component.name,
        version=component.version,
        type=kind,
        bom_ref=reference,
        purl=PackageURL.from_string(component.purl) if component.purl else None,
        licenses=[_Expression(component.licence)],
        supplier=_Organisation(name=supplier) if supplier else None,
        properties=properties,
        components=[
            *(_file(file) for file in (*component.files, *texts)),
            *(_entry(part, within=f"{reference}/", supplier=supplier) for part in component.parts),
        ],
    )


def _file(file: BundledFile) -> object:
    return _Entry(
        name=file.path,
        type=ComponentType.FILE,
        bom_ref=f"file:{file.path}",
        hashes=[_Hash(alg=model.HashAlgorithm.SHA_256, content=file.sha256)],
    )
