"""The locator of keys, checked against what the standard library's parser reads."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from typing import cast

from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.settings.problems import KeyPath, key_lines

TRICKY = '''\
# [lsl] session_id = "no"
"text" = """
[fake]
fake_key = 1 # no comment
""\\"still inside = 2
closed by five quotes"""""
literal = \'\'\'
[[device]]
\'\'\'
hash = "# not a comment = 1"
date = 1979-05-27 07:32:32
a.b.c = 1.5

[lsl] # key = 3
peers = [ # [x]
    "one", # "two",
    "three = 3",

    [{ deep = "]", "qu.oted" = 'x#y' }],
]
"esc\\u0061ped" = true
[[device]]
unit = "A"
  [device.extra]
  gain = 1
[[device]]
unit = "B"
[device.extra]
gain = 2
[[device.part]]
name = "p"
[[device.part]]
name = "q"
[ "dotted.table" . 'sub' ]
x=1'''


def flatten(value: object, path: KeyPath = ()) -> Iterator[tuple[KeyPath, object]]:
    if path:
        yield path, value
    if isinstance(value, dict):
        for key, inner in cast("dict[str, object]", value).items():
            yield from flatten(inner, (*path, key))
    elif isinstance(value, list):
        for index, inner in enumerate(cast("list[object]", value)):
            yield from flatten(inner, (*path, index))


def test_every_key_of_a_tricky_file_is_found() -> None:
    lines = key_lines(TRICKY)
    assert set(lines) == {path for path, _ in flatten(tomllib.loads(TRICKY))}


def test_lines_in_a_tricky_file() -> None:
    lines = key_lines(TRICKY)
    expected: dict[KeyPath, str] = {
        ("text",): '"text"',
        ("literal",): "literal",
        ("hash",): "hash",
        ("a", "b", "c"): "a.b.c",
        ("lsl",): "[lsl]",
        ("lsl", "peers", 1): '"three',
        ("lsl", "peers", 2, 0, "deep"): "[{ deep",
        ("lsl", "peers", 2, 0, "qu.oted"): "[{ deep",
        ("lsl", "escaped"): '"esc',
        ("device", 1, "unit"): 'unit = "B"',
        ("device", 0, "extra", "gain"): "gain = 1",
        ("device", 1, "extra", "gain"): "gain = 2",
        ("device", 1, "part", 1, "name"): 'name = "q"',
        ("dotted.table", "sub", "x"): "x=1",
    }
    source = TRICKY.split("\n")
    found = {path: source[lines[path] - 1].strip() for path in expected}
    assert all(found[path].startswith(start) for path, start in expected.items()), found


def test_windows_line_ends_count_once() -> None:
    assert key_lines('a = """\r\n"""\r\nb = 1\r\n')["b",] == 3


NAMES = st.text(st.sampled_from("abcxyz_-0"), min_size=1, max_size=3)
KEYS = st.one_of(
    NAMES,
    NAMES.map(lambda name: f'"{name}"'),
    NAMES.map(lambda name: f"'{name}.[{name}] # ='"),
)
NOISE = st.sampled_from(["", " ", "# [x] = {", "\t#]"])
TEXTS = st.sampled_from(
    ['"a = [#"', "'b\" = ]'", '"""\n[t]\nk = 1\n"" """""', "'''\nk = 1 '\n'''", '"\\""', '""', "''"]
)
SCALARS = st.one_of(st.just("<n>"), TEXTS, st.sampled_from(["true", "-1.5e3", "07:32:00"]))


def containers(values: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    separators = st.sampled_from([", ", ",\n  ", ", # ] }\n"])
    arrays = st.tuples(separators, st.lists(values, max_size=3)).map(
        lambda drawn: f"[\n{drawn[0].join(drawn[1])}\n]"
    )
    tables = st.lists(st.tuples(KEYS, values), max_size=3, unique_by=lambda pair: pair[0]).map(
        lambda pairs: "{ " + ", ".join(f"{key} = {value}" for key, value in pairs) + " }"
    )
    return st.one_of(arrays, tables)


VALUES = st.recursive(SCALARS, containers, max_leaves=5)
ASSIGNMENTS = st.tuples(st.lists(KEYS, min_size=1, max_size=2), VALUES, NOISE).map(
    lambda drawn: f"{' . '.join(drawn[0])} = {drawn[1]} {drawn[2]}"
)
HEADERS = st.tuples(st.lists(KEYS, min_size=1, max_size=3), st.booleans(), NOISE).map(
    lambda drawn: (
        f"{'[[' if drawn[1] else '['}{'.'.join(drawn[0])}{']]' if drawn[1] else ']'} {drawn[2]}"
    )
)
STATEMENTS = st.lists(st.one_of(ASSIGNMENTS, HEADERS, NOISE), max_size=12)


def valid_document(statements: list[str]) -> str:
    """Join the statements that fit to those before, each number made unique."""
    text = ""
    number = 1000
    for statement in statements:
        addition = statement
        while "<n>" in addition:
            addition = addition.replace("<n>", str(number), 1)
            number += 1
        try:
            tomllib.loads(f"{text}{addition}\n")
        except tomllib.TOMLDecodeError:
            continue
        text = f"{text}{addition}\n"
    return text


@given(STATEMENTS.map(valid_document))
def test_keys_are_found_where_they_stand(text: str) -> None:
    lines = key_lines(text)
    leaves = dict(flatten(tomllib.loads(text)))
    assert set(lines) == set(leaves)
    source = text.split("\n")
    for path, value in leaves.items():
        line = source[lines[path] - 1]
        keys = [part for part in path if isinstance(part, str)]
        if isinstance(path[-1], str):
            assert keys[-1] in line
        if isinstance(value, int) and value >= 1000:
            assert str(value) in line
