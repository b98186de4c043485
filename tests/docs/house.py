"""Reports how the code is cut into modules: counts, and what wants a second look.

Part of ``make check``, where it never fails; ``--list`` shows what one count is made of. All of
it is found by reading the code, so that a count is a hint and no verdict.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PRODUCT = ("common", "gateway_win", "ros_side/lsl_to_ros")
LEFT_OUT = {"build", "launch", "setup.py"}
SHORT_MODULE, LONG_MODULE, LONG_FUNCTION = 60, 500, 60
DOORS = {"__init__.py", "__main__.py"}
GERUND = re.compile(r"(_|^)(?!(during|missing|ping|ring|string|thing)(_|$))[a-z0-9]+ing(_|$)")
# For people, not for a checker. Behind code it is told from a text by the two spaces before it.
COMMENT = re.compile(r"(^ *|\S.*  )#(?! ?(noqa|type:|pyright:|pragma|!))")
SECTION = re.compile(
    r"^(?:Parameters|Attributes)\n-+\n(.*?)(?=^\S[^\n]*\n-+\n|^\.\. |\Z)", re.MULTILINE | re.DOTALL
)
# A name, or names, and no line below; a shape beside the name is a text.
SILENT = re.compile(r"^(?! )[\w, *]+$(?!\n+ )", re.MULTILINE)

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Module:
    """A file of code: its path below the tree, the name that imports it, and its parts."""

    path: Path
    name: str
    text: str

    def __post_init__(self) -> None:
        self.nodes = list(ast.walk(ast.parse(self.text)))
        self.lines = self.text.count("\n")

    def at(self, node: Function | ast.ClassDef, more: object = "") -> str:
        return f"{self.path}:{node.lineno} {node.name} {more}".rstrip()


def files(root: Path, folders: Sequence[str]) -> Iterator[tuple[Path, str]]:
    """Yield each file of code below some folders of a tree, and the name that imports it."""
    for folder in folders:
        for path in sorted((root / folder).rglob("*.py")):
            inside = path.relative_to(root / folder)
            if LEFT_OUT.isdisjoint(inside.parts):
                yield path, ".".join(inside.with_suffix("").parts).removesuffix(".__init__")


def second_look(root: Path) -> dict[str, list[str]]:
    """Find everything that is counted in the product, under the words by which it is shown."""
    modules = [
        Module(path.relative_to(root), name, path.read_text("utf-8"))
        for path, name in files(root, PRODUCT)
    ]
    every = [(module, node) for module in modules for node in module.nodes]
    functions = [(module, node) for module, node in every if isinstance(node, Function)]
    classes = [(module, node) for module, node in every if isinstance(node, ast.ClassDef)]
    calls = Counter(_name(node.func) for _, node in every if isinstance(node, ast.Call))
    inner = [module for module in modules if module.path.name not in DOORS]
    # Drivers of sensors consist of the same parts.
    free = [module for module in inner if "devices" not in module.path.parts]
    names = Counter(module.path.name for module in free)
    single = _with_one_importer(modules)
    return {
        "modules with one importer": [f"{path} <- {user}" for path, user, _ in single],
        "  in the same folder": [f"{path} <- {user}" for path, user, near in single if near],
        f"modules under {SHORT_MODULE} lines": [
            f"{module.path} {module.lines}" for module in inner if module.lines < SHORT_MODULE
        ],
        "modules of one function": [str(module.path) for module in inner if _is_function(module)],
        "modules named by a gerund": [
            str(module.path) for module in inner if GERUND.search(module.path.stem)
        ],
        "modules that share a file name, but in devices": [
            str(module.path) for module in free if names[module.path.name] > 1
        ],
        "records built at one place": [
            module.at(node)
            for module, node in classes
            if {"dataclass", "NamedTuple"} & {*map(_name, node.decorator_list + node.bases)}
            and calls[node.name] == 1
        ],
        "functions that only hand on their arguments": [
            module.at(node) for module, node in functions if _hands_on(node)
        ],
        "protocols with one implementation": [*_protocols(classes)],
        "documented parameters without text": [
            module.at(node, names)
            for module, node in (*functions, *classes)
            for names in silent_parameters(ast.get_docstring(node) or "")
        ],
        f"modules over {LONG_MODULE} lines": [
            f"{module.path} {module.lines}" for module in modules if module.lines > LONG_MODULE
        ],
        f"functions over {LONG_FUNCTION} lines": [
            module.at(node, length)
            for module, node in functions
            if (length := (node.end_lineno or 0) - node.lineno + 1) > LONG_FUNCTION
        ],
    }


def _with_one_importer(modules: list[Module]) -> list[tuple[Path, str, bool]]:
    """Return each module that one other imports, that one, and whether both share a folder."""
    known = {module.name: module.path for module in modules}
    users: dict[str, set[str]] = defaultdict(set)
    for module in modules:
        for node in module.nodes:
            found = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                found = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            for name in known.keys() & set(found) - {module.name}:
                users[name].add(module.name)
    return [
        (known[name], user, known[name].parent == known[user].parent)
        for name, (user, *others) in sorted(users.items())
        if not others and known[name].name not in DOORS
    ]


def _without_words(body: list[ast.stmt]) -> list[ast.stmt]:
    """Leave out docstrings."""
    return [node for node in body if not isinstance(getattr(node, "value", None), ast.Constant)]


def _is_function(module: Module) -> bool:
    tree = module.nodes[0]
    assert isinstance(tree, ast.Module)
    imports = (ast.Import, ast.ImportFrom)
    body = [node for node in _without_words(tree.body) if not isinstance(node, imports)]
    return len(body) == 1 and isinstance(body[0], Function)


def _name(node: ast.AST) -> str:
    """Return the last name of what is called, subclassed, assigned or used as a decorator."""
    match node:
        case ast.Call(func=inner) | ast.Subscript(value=inner) | ast.Starred(value=inner):
            return _name(inner)
        case ast.Attribute(attr=name) | ast.Name(id=name):
            return name
        case _:
            return ""


def _hands_on(function: Function) -> bool:
    """Tell whether its body is one call with its own arguments and no others."""
    match _without_words(function.body):
        case [ast.Expr(value=value) | ast.Return(value=value)]:
            call = value.value if isinstance(value, ast.Await) else value
        case _:
            return False
    if not isinstance(call, ast.Call) or function.decorator_list:
        return False
    arguments = (*function.args.args, function.args.vararg, *function.args.kwonlyargs)
    own = [argument.arg for argument in arguments if argument]
    given = [*call.args, *(keyword.value for keyword in call.keywords)]
    return [*map(_name, given)] == [name for name in own if name not in {"self", "cls"}]


def _members(node: ast.ClassDef) -> set[str]:
    """Return the names of methods and attributes, also of those that methods set."""
    named: set[str] = set()
    for part in ast.walk(node):
        if isinstance(part, Function):
            named.add(part.name)
        elif isinstance(part, ast.Assign | ast.AnnAssign):
            for target in part.targets if isinstance(part, ast.Assign) else [part.target]:
                named.update(map(_name, getattr(target, "elts", [target])))
    return named - {"__init__"}


def _protocols(classes: list[tuple[Module, ast.ClassDef]]) -> Iterator[str]:
    """Yield those of which one class has all members, by name; of libraries nothing is known."""
    protocols = [entry for entry in classes if "Protocol" in map(_name, entry[1].bases)]
    rest = [
        (node.name, _members(node)) for module, node in classes if (module, node) not in protocols
    ]
    for module, node in protocols:
        wanted = _members(node)
        found = [name for name, members in rest if wanted <= members]
        if len(found) == 1:
            yield module.at(node, f"<- {found[0]}")


def silent_parameters(docstring: str) -> list[str]:
    """Return the parameters and attributes of which a docstring gives nothing but the name."""
    return [names for section in SECTION.findall(docstring) for names in SILENT.findall(section)]


def report(root: Path) -> Iterator[str]:
    """Yield the lines of the report."""
    rooms: dict[str, list[int]] = defaultdict(list)
    for title, folders in (("product", PRODUCT), ("tests", ("tests",))):
        comments = 0
        for path, name in files(root, folders):
            lines = path.read_text("utf-8").splitlines()
            comments += sum(bool(COMMENT.search(line)) for line in lines)
            rooms[title].append(len(lines))
            if title == "product":
                package = name if path.name == "__init__.py" else name.rpartition(".")[0]
                rooms["  " + ".".join(package.split(".")[:2])].append(len(lines))
        share = 100 * comments / max(sum(rooms[title]), 1)
        yield f"{title + ': comments in 100 lines':<48}{share:>8.1f}"
    for room, sizes in sorted(rooms.items()):
        yield f"{room:<48}{len(sizes):>8} modules{sum(sizes):>9} lines"
    for what, found in second_look(root).items():
        yield f"{what:<48}{len(found):>8}"


def main() -> None:
    """Print the report, or what one of its counts is made of."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--list", metavar="WORDS", help="show what is counted under these words")
    wanted = parser.parse_args().list
    if wanted is None:
        print("\n".join(report(ROOT)))
        return
    for what, found in second_look(ROOT).items():
        if wanted in what:
            print(what, *found, sep="\n  ")


if __name__ == "__main__":
    main()
