"""Licence expressions: what distributions declare, as SPDX, and which of them may be shipped."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, cast

import license_expression

from installer.bundle.distributions import Distribution
from installer.bundle.errors import UnknownLicenceError

# The library has no types; its nodes are told apart by their classes' names.
_spdx: Any = cast("Callable[[], Any]", license_expression.get_spdx_licensing)()  # pyright: ignore[reportUnknownMemberType]

_COPYLEFT = re.compile(r"[AL]?GPL-", re.IGNORECASE)
_EXCEPTIONS = frozenset({"Bootloader-exception", "GCC-exception-3.1"})

# Metadata older than SPDX expressions says it in words.
_WORDS = {
    "apache 2.0": "Apache-2.0",
    "apache license 2.0": "Apache-2.0",
    "isc license": "ISC",
    "mit license": "MIT",
}
_CLASSIFIERS = {
    "License :: OSI Approved :: Apache Software License": "Apache-2.0",
    "License :: OSI Approved :: ISC License (ISCL)": "ISC",
    "License :: OSI Approved :: MIT License": "MIT",
    "License :: OSI Approved :: Python Software Foundation License": "PSF-2.0",
}


def normalise(expression: str) -> str:
    """Return an SPDX expression in its usual spelling.

    Raises
    ------
    UnknownLicenceError
        If it is not an expression or names a licence that SPDX does not know.
    """
    message = f"{expression!r} is no SPDX licence expression; say it in installer/bundle/known.py."
    try:
        parsed = _spdx.parse(expression)
        unknown = cast("list[str]", _spdx.unknown_license_keys(parsed))
    except (license_expression.ExpressionError, license_expression.ExpressionParseError) as error:
        raise UnknownLicenceError(message) from error
    if parsed is None or any(not key.startswith("LicenseRef-") for key in unknown):
        raise UnknownLicenceError(message)
    return str(parsed.render())


def declared(distribution: Distribution) -> str:
    """Return the SPDX expression that a distribution's metadata amounts to.

    Raises
    ------
    UnknownLicenceError
        If the metadata does not say it clearly ("BSD" is any of several licences).
    """
    expressions = distribution.values("License-Expression")
    if expressions:
        return normalise(expressions[0])
    for words in distribution.values("License"):
        try:
            return normalise(_WORDS.get(words.lower(), words))
        except UnknownLicenceError:
            continue
    classifiers = distribution.values("Classifier")
    named = {_CLASSIFIERS[each] for each in classifiers if each in _CLASSIFIERS}
    licences = [each for each in classifiers if each.startswith("License :: OSI Approved :: ")]
    if len(named) == 1 == len(licences):
        return named.pop()
    message = (
        f"{distribution.info} does not say clearly which licence it is under; "
        "look it up and name it in installer/bundle/known.py."
    )
    raise UnknownLicenceError(message)


def may_ship(expression: str) -> bool:
    """Tell whether some choice that an expression leaves is free of copyleft.

    The GNU licences are refused unless by an exception they put no terms on the whole:
    that of PyInstaller's bootloader, and that of GCC's runtime libraries.
    """
    return _may_ship(_spdx.parse(expression))


def _may_ship(expression: object) -> bool:
    node = cast("Any", expression)
    match type(node).__name__:
        case "AND":
            return all(_may_ship(each) for each in node.args)
        case "OR":
            return any(_may_ship(each) for each in node.args)
        case "LicenseWithExceptionSymbol":
            excepted = node.exception_symbol.key in _EXCEPTIONS
            return excepted or _may_ship(node.license_symbol)
        case _:
            return _COPYLEFT.search(str(node.key)) is None


def choice(expression: str, available: frozenset[str]) -> tuple[str, ...] | None:
    """Choose among what an expression leaves so that only available licences are needed.

    Parameters
    ----------
    expression
        SPDX expression.
    available
        SPDX identifiers of the licences that may be chosen.

    Returns
    -------
    tuple of str or None
        The identifiers that together fulfil the expression; None if there is no such choice.
    """
    return _choice(_spdx.parse(expression), available)


def _choice(expression: object, available: frozenset[str]) -> tuple[str, ...] | None:
    node = cast("Any", expression)
    match type(node).__name__:
        case "AND":
            choices = [_choice(each, available) for each in node.args]
            chosen = [each for each in choices if each is not None]
            if len(chosen) < len(choices):
                return None
            return tuple(sorted({key for each in chosen for key in each}))
        case "OR":
            options = (_choice(each, available) for each in node.args)
            return next((each for each in options if each is not None), None)
        case _:
            key = str(node.render())
            return (key,) if key in available else None
