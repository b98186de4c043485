"""Finds places that may drop data and report no refusal.

The rule, for each function of a data room: an empty ``return``, a ``continue``, an ``except``, a
``suppress``, a line for the log, a comprehension or a function such as ``islice`` that leaves data
out, a slice, ``del`` or ``pop`` that keeps the rest of data, and an assignment after which data is
never read stand in a block with a ``refuse`` (or ``hold``) before, or have a comment that begins
with ``nothing is dropped:`` and says why, in the line or in the one above. A bounded ``deque`` has
such a comment, too. What answers a question, a function that returns ``bool``, ``str`` or a number
and a property, may return what it likes; one that may return None instead of a number may not, for
it may drop what it was to place.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

EXCUSE = "nothing is dropped:"
REPORTS = frozenset({"refuse", "hold", "_refuse"})
IN_DRIVERS = REPORTS | {"lost", "left_out"}
"""Verbs of a driver's sink; it adds to `dropped_bytes`, too."""
IN_RECORDER = REPORTS | {"_note"}
_LOGS = frozenset(
    {"debug", "info", "inform", "warn", "warning", "error", "exception", "critical", "print"}
    | {"_warn", "_say", "say", "_inform"}
)
_ANSWERS = frozenset({"bool", "str", "int", "float", "bool | None"})
_OF_DATA = re.compile(
    r"(?<![a-z])(samples?|rows?|values?(?!\(\))|beats?|forces|events?|stamps?|times|packets?|messages?|blocks?"
    r"|frames?|chunks?|markers?|rates|came|together|pairs|timed|intervals)(?![a-z])"
)
"""What a filter goes through that may drop data."""
_TAKE_OUT = frozenset({"pop", "popleft", "popitem", "clear", "remove"})
_LEAVE_OUT = frozenset({"filter", "islice", "takewhile", "dropwhile", "compress", "delete"})
_MASK = re.compile(r"(is|are|has|have)_|good|fit|kept|mask|valid")
"""An index that is True where something is kept."""
_NOTHING = re.compile(
    r"\[\]|\(\)|\{\}|b?''|(list|dict|set|tuple|deque|bytearray)\(\)|np\.(empty|zeros)\(\(?0\b.*|.*\[:0\]"
)
_Function = ast.FunctionDef | ast.AsyncFunctionDef
_LEAVES = ast.Return | ast.Raise | ast.Continue | ast.Break


class Drop(NamedTuple):
    """A place that may drop data unsaid."""

    line: int
    what: str


def drops(source: str, reports: frozenset[str] = REPORTS) -> list[Drop]:
    """Return all of a module.

    Parameters
    ----------
    source
    reports
        Methods by which it reports.
    """
    tree, lines = ast.parse(source), source.splitlines()
    # A comment in a line of its own is of the next one.
    excused = {
        number + line.lstrip().startswith("#")
        for number, line in enumerate(lines, 1)
        if EXCUSE in line
    }
    found: set[Drop] = set()
    for function in ast.walk(tree):
        if isinstance(function, _Function) and not is_answer(function):
            found.update(_in_block(function.body, excused, reports, is_reported=False))
            unread = _unread(function, function.body, [], reports)
            found.update(each for each in unread if each.line not in excused)
    return sorted(found)


def is_answer(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether it answers a question."""
    is_property = any("property" in ast.unparse(each) for each in function.decorator_list)
    returns = ast.unparse(function.returns) if function.returns else ""
    return is_property or returns.strip("'\"") in _ANSWERS


def _in_block(
    body: list[ast.stmt], excused: set[int], reports: frozenset[str], *, is_reported: bool
) -> Iterator[Drop]:
    """Look at the statements of a block; a report in one covers those that follow it there."""
    reported = is_reported
    for statement in body:
        reported = reported or _reports(statement, reports)
        is_excused = statement.lineno in excused
        if not (reported or is_excused):
            yield from _of(statement)
            yield from _filters(statement, excused)
        for block in _blocks(statement):
            inside = [each for each in block if not isinstance(each, _Function | ast.ClassDef)]
            yield from _in_block(inside, excused, reports, is_reported=False)
        for handler in getattr(statement, "handlers", []):
            first = handler.body[0].lineno
            is_excused = bool({handler.lineno, first} & excused)
            is_told = _reports_or_raises(handler, reports)
            if not (is_excused or is_told):
                yield Drop(handler.lineno, "except")
            yield from _in_block(handler.body, excused, reports, is_reported=False)


def _of(statement: ast.stmt) -> Iterator[Drop]:
    line = statement.lineno
    if isinstance(statement, ast.Continue):
        yield Drop(line, "continue")
    if isinstance(statement, ast.Return) and _is_empty(statement.value):
        yield Drop(line, "return")
    if isinstance(statement, ast.With) and "suppress(" in ast.unparse(statement.items[0]):
        yield Drop(line, "except")
    if isinstance(statement, ast.Expr) and _calls(statement, _LOGS):
        yield Drop(line, "log")
    if isinstance(statement, ast.Assign | ast.AnnAssign) and "maxlen=" in ast.unparse(statement):
        yield Drop(line, "deque")
    if _cuts(statement):
        yield Drop(line, "cut")


def _cuts(statement: ast.stmt) -> bool:
    """Whether it takes something out of data and keeps the rest: a slice, `del` or `pop`."""
    if isinstance(statement, ast.Delete):
        return any(_is_data(whole) for whole in map(_whole, statement.targets) if whole)
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call):
        called = statement.value.func
        return (
            isinstance(called, ast.Attribute)
            and called.attr in _TAKE_OUT
            and _is_data(called.value)
        )
    if not isinstance(statement, ast.Assign):
        return False
    names = {ast.unparse(each) for target in statement.targets for each in _elements(target)}
    wholes = [whole for whole in map(_whole, _elements(statement.value)) if whole]
    return any(ast.unparse(each) in names and _is_data(each) for each in wholes)


def _elements(expression: ast.expr) -> list[ast.expr]:
    return expression.elts if isinstance(expression, ast.Tuple) else [expression]


def _whole(expression: ast.expr) -> ast.expr | None:
    """Return what it is a part of; one with another axis is all of it."""
    if not isinstance(expression, ast.Subscript) or "newaxis" in ast.unparse(expression.slice):
        return None
    return expression.value


def _is_data(expression: ast.expr) -> bool:
    return bool(_OF_DATA.search(ast.unparse(expression)))


def _leaves_out(call: ast.Call) -> bool:
    """Whether it is a function that passes on a part of data."""
    name = ast.unparse(call.func).rpartition(".")[2]
    return name in _LEAVE_OUT and any(_is_data(each) for each in call.args)


def _filters(statement: ast.stmt, excused: set[int]) -> Iterator[Drop]:
    """Look at what a statement leaves out of data, but not at the blocks that stand inside."""
    inside = {id(each) for block in _blocks(statement) for each in block}
    inside |= {id(each) for each in getattr(statement, "handlers", [])}
    parts = [each for each in ast.iter_child_nodes(statement) if id(each) not in inside]
    for each in (found for part in parts for found in ast.walk(part)):
        if isinstance(each, ast.Call) and _leaves_out(each) and statement.lineno not in excused:
            yield Drop(each.lineno, "filter")
        if (
            isinstance(each, ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp)
            and any(one.ifs and _OF_DATA.search(ast.unparse(one.iter)) for one in each.generators)
            and excused.isdisjoint(range(statement.lineno, (each.end_lineno or 0) + 1))
        ):
            yield Drop(each.lineno, "filter")


# Data that an assignment leaves unread: it is emptied or replaced before anything has read it, or
# a part of it goes on and the rest is never looked at.


def _unread(
    function: _Function, body: list[ast.stmt], before: list[ast.stmt], reports: frozenset[str]
) -> Iterator[Drop]:
    """Look at the assignments of a block; what is reported before one covers it."""
    seen = list(before)
    for statement in body:
        if not any(_reports(each, reports) for each in seen):
            for target, value in _assigned(statement):
                # Where a block replaces what was assigned before it, that holds without the block.
                is_emptied = bool(_NOTHING.fullmatch(ast.unparse(value)))
                earlier = seen if is_emptied else seen[len(before) :]
                is_read = _reads(statement, ast.unparse(target))
                if not is_read and _is_lost(target, earlier, function, is_emptied=is_emptied):
                    yield Drop(statement.lineno, "unread")
            for part in _kept_in_part(statement):
                if not _has_rest(part, statement, function, _reach(statement, body)):
                    yield Drop(statement.lineno, "part")
        for block in [*_blocks(statement), *(e.body for e in getattr(statement, "handlers", []))]:
            yield from _unread(function, block, seen, reports)
        seen.append(statement)


def _assigned(statement: ast.stmt) -> Iterator[tuple[ast.expr, ast.expr]]:
    if isinstance(statement, ast.AnnAssign) and statement.value is not None:
        yield statement.target, statement.value
    for target in statement.targets if isinstance(statement, ast.Assign) else []:
        values = _elements(statement.value)  # type: ignore[union-attr]  # it is the same one
        if isinstance(target, ast.Tuple) and len(target.elts) == len(values):
            yield from zip(target.elts, values, strict=True)
        else:
            yield target, statement.value  # type: ignore[union-attr]


def _is_lost(
    target: ast.expr, seen: list[ast.stmt], function: _Function, *, is_emptied: bool
) -> bool:
    """Whether an assignment to data loses what nothing has read since it was there."""
    name = ast.unparse(target)
    stored = [at for at, each in enumerate(seen) if name in _names(each, ast.Store)]
    arguments = {each.arg for each in ast.walk(function.args) if isinstance(each, ast.arg)}
    is_of_call = isinstance(target, ast.Name) and name not in arguments
    was_there = bool(stored) or (is_emptied and not is_of_call and function.name != "__init__")
    if not (was_there and _is_data(target)):
        return False
    since = seen[stored[-1] if stored else 0 :]
    # What was assigned inside of a block may not have been.
    is_sure = not stored or isinstance(since[0], ast.Assign | ast.AnnAssign)
    passed = [e for e in since if not (isinstance(e, ast.If) and isinstance(e.body[-1], _LEAVES))]
    return is_sure and not any(_reads(each, name) for each in passed)


def _reads(statement: ast.stmt, name: str) -> bool:
    """Whether a statement reads data, and not only how much there is, or whether there is some."""
    tests = [e.test for e in ast.walk(statement) if isinstance(e, ast.If | ast.While)]
    counts = [*_lengths(statement), *(each for each in tests if ast.unparse(each) == name)]
    inside = {id(one) for each in counts for one in ast.walk(each)}
    is_of_it = {name, name.partition(".")[0]} - {"self"}
    return any(
        ast.unparse(each) in is_of_it and id(each) not in inside
        for each in ast.walk(statement)
        if isinstance(each, ast.Name | ast.Attribute) and isinstance(each.ctx, ast.Load)
    )


def _names(node: ast.AST, context: type[ast.expr_context]) -> set[str]:
    return {
        ast.unparse(each)
        for each in ast.walk(node)
        if isinstance(each, ast.Name | ast.Attribute) and isinstance(each.ctx, context)
    }


def _kept_in_part(statement: ast.stmt) -> Iterator[ast.Subscript]:
    """Yield the local data of which a statement takes a slice or those that fit a condition."""
    if list(_blocks(statement)):
        return
    for each in ast.walk(statement):
        if isinstance(each, ast.Subscript) and isinstance(each.ctx, ast.Load):
            is_local = _root(each.value) not in ("", "self")
            if is_local and _is_data(each.value) and _is_part(each.slice):
                yield each


def _root(expression: ast.expr) -> str:
    """Return the name at the left of attributes; empty if there is none."""
    while isinstance(expression, ast.Attribute):
        expression = expression.value
    return expression.id if isinstance(expression, ast.Name) else ""


def _is_part(index: ast.expr) -> bool:
    parts = index.elts if isinstance(index, ast.Tuple) else [index]
    return any(
        (isinstance(each, ast.Slice) and (each.lower is not None or each.upper is not None))
        or isinstance(each, ast.Compare)
        or (isinstance(each, ast.Name) and bool(_MASK.match(each.id)))
        or (isinstance(each, ast.UnaryOp) and isinstance(each.op, ast.Invert))
        for each in parts
    )


def _reach(statement: ast.stmt, body: list[ast.stmt]) -> int:
    """Return the last line that may be run after a statement of a block, by the block alone."""
    ends = (each.end_lineno or 0 for each in body if isinstance(each, _LEAVES))
    return next((end for end in ends if end >= statement.lineno), sys.maxsize)


def _has_rest(part: ast.Subscript, statement: ast.stmt, function: _Function, reach: int) -> bool:
    """Whether data is read elsewhere: in or after a statement, or in a loop around it."""
    whole, index = _root(part.value), part.slice
    loops = [
        each
        for each in ast.walk(function)
        if isinstance(each, ast.For | ast.While | ast.AsyncFor)
        and each.lineno < statement.lineno <= (each.end_lineno or 0)
    ]
    # A loop over places takes one piece after the other.
    if {one for each in loops for one in _names(each, ast.Store)} & _names(index, ast.Load):
        return True
    unread = {id(each) for part in [index, *_lengths(function)] for each in ast.walk(part)}
    reads = [
        each.lineno
        for each in ast.walk(function)
        if isinstance(each, ast.Name)
        and each.id == whole
        and isinstance(each.ctx, ast.Load)
        and id(each) not in unread
    ]
    here = range(statement.lineno, (statement.end_lineno or 0) + 1)
    # The other piece may stand before.
    pieces = [
        each
        for each in ast.walk(function)
        if isinstance(each, ast.Subscript)
        and ast.unparse(each.value) == ast.unparse(part.value)
        and _is_part(each.slice)
    ]
    if len(pieces) > 1:
        return True
    if whole in _names(statement, ast.Store):
        return False
    kept = [each for each in loops if whole not in _names(each, ast.Store)]
    around = [range(each.lineno, (each.end_lineno or 0) + 1) for each in kept]
    is_around = any(line in each and line not in here for line in reads for each in around)
    return (
        sum(line in here for line in reads) > 1
        or is_around
        or any(here[-1] < line <= reach for line in reads)
    )


def _lengths(node: ast.AST) -> list[ast.Call]:
    calls = [each for each in ast.walk(node) if isinstance(each, ast.Call)]
    return [each for each in calls if ast.unparse(each.func) == "len"]


def _is_empty(value: ast.expr | None) -> bool:
    if value is None or (isinstance(value, ast.Constant) and not value.value):
        return True
    if isinstance(value, ast.Dict):
        return not value.keys
    return isinstance(value, ast.List | ast.Tuple) and not value.elts


def _reports(statement: ast.stmt, reports: frozenset[str]) -> bool:
    """Whether it reports: by a method, or, in a driver, by adding to the bytes that it drops."""
    if isinstance(statement, ast.AugAssign):
        return "lost" in reports and "dropped_bytes" in ast.unparse(statement.target)
    return _calls(statement, reports)


def _reports_or_raises(handler: ast.ExceptHandler, reports: frozenset[str]) -> bool:
    is_raised = any(isinstance(each, ast.Raise) for each in ast.walk(handler))
    return is_raised or any(_reports(each, reports) for each in handler.body)


def _calls(statement: ast.stmt, names: frozenset[str]) -> bool:
    """Whether a simple statement calls one of these; of a compound one, what stands inside not."""
    if list(_blocks(statement)):
        return False
    calls = (each.func for each in ast.walk(statement) if isinstance(each, ast.Call))
    return any(
        (each.attr if isinstance(each, ast.Attribute) else getattr(each, "id", "")) in names
        for each in calls
    )


def _blocks(statement: ast.stmt) -> Iterator[list[ast.stmt]]:
    for name in ("body", "orelse", "finalbody"):
        block = getattr(statement, name, None)
        if isinstance(block, list) and block:
            yield block
    for case in getattr(statement, "cases", []):
        yield case.body


# The modules through which samples and messages pass: the data rooms.

ROOT = Path(__file__).parents[2]
_COMMON = "common/biosensor_common"
_NODE, _AGENT = "ros_side/lsl_to_ros/lsl_to_ros", "gateway_win/biosensor_gateway"
_PATTERNS = (
    f"{_COMMON}/lsl/inlet.py",
    f"{_COMMON}/lsl/network.py",
    f"{_COMMON}/lsl/sender_clocks.py",
    f"{_COMMON}/ros/layout.py",
    f"{_NODE}/lsl/*.py",
    f"{_NODE}/topics/*.py",
    f"{_NODE}/statistics/*.py",
    f"{_NODE}/routes.py",
    f"{_NODE}/subscriber_thread.py",
    *(f"{_NODE}/ros_to_lsl/{each}.py" for each in (
        "application", "graph", "node", "reports", "senders", "stamps",
        "topic_bridge", "topic_outlets",
    )),
    *(f"{_AGENT}/streaming/{each}.py" for each in (
        "marker_stream", "outlets", "silence", "sink", "stages",
    )),
    f"{_AGENT}/streaming/events/*.py",
    f"{_AGENT}/agent/marker_commands.py",
    f"{_AGENT}/features/*.py",
    f"{_AGENT}/pulses.py",
    f"{_AGENT}/page/network/*.py",
    f"{_AGENT}/captures/*.py",
    *(f"{_AGENT}/recording/recorder/{each}.py" for each in (
        "live_file", "presence", "programs", "receiver", "recording_file",
    )),
)  # fmt: skip
_DRIVERS = (f"{_AGENT}/devices/*/driver/emitter.py", f"{_AGENT}/devices/*/driver/*.py")


PATTERNS = (*_PATTERNS, *_DRIVERS)


def data_rooms() -> list[Path]:
    """Return their files, but those without a function, which drop nothing."""
    found = sorted({path for each in PATTERNS for path in ROOT.glob(each)})
    return [path for path in found if "def " in source_of(path)]


def source_of(room: Path) -> str:
    """Return the code through which data pass, in the lines where it stands: of a driver's modules
    the emitters, for what else is in them talks with the device."""
    text = room.read_text()
    if "driver" not in room.parts or room.name == "emitter.py":
        return text
    kept = {
        number
        for each in ast.parse(text).body
        if isinstance(each, ast.ClassDef) and each.name.endswith("Emitter")
        for number in range(each.lineno, (each.end_lineno or 0) + 1)
    }
    lines = enumerate(text.splitlines(), 1)
    return "\n".join(line if number in kept else "" for number, line in lines)


def reports_of(room: Path) -> frozenset[str]:
    """Return the methods by which a room reports: drivers have the verbs of their sink, the
    recorder tells the verdict on its recording."""
    if "recorder" in room.parts:
        return IN_RECORDER
    return IN_DRIVERS if "driver" in room.parts else REPORTS
