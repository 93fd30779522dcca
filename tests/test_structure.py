"""Claims about the package's own structure: which folder imports which, and what a name stands for."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import rx90b_flex
from rx90b_flex.effects import Effect

ROOT = Path(rx90b_flex.__file__).parent
SOURCES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(ROOT.rglob("*.py"))}
FRONT = ("__init__", "__main__", "verbs", "cli")  # public names and commands, made of everything else


def part(path: Path) -> str:
    """Folder of the package, or file of its top level."""
    inside = path.relative_to(ROOT)
    return inside.parts[0] if len(inside.parts) > 1 else inside.stem


def imports(tree: ast.Module) -> Iterator[str]:
    """Modules of the package that a file imports as it is loaded."""
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("rx90b_flex."):
            yield str(node.module)


def test_no_folder_imports_one_that_imports_it() -> None:
    graph: dict[str, set[str]] = {}
    for path, tree in SOURCES.items():
        if part(path) not in FRONT:
            others = {module.split(".")[1] for module in imports(tree)} - {part(path)}
            graph.setdefault(part(path), set()).update(others)
    try:
        list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise AssertionError(f"a circle: {' -> '.join(error.args[1])}") from None


def test_effects_and_files_know_nothing_of_robots() -> None:
    for path, tree in SOURCES.items():
        if part(path) in ("effects", "files"):
            wrong = [m for m in imports(tree) if m.split(".")[1] not in ("effects", "files", "compiled", "pieces")]
            assert not wrong, f"{path}: {wrong}"


def test_a_class_name_stands_for_one_thing() -> None:
    names = Counter(n.name for tree in SOURCES.values() for n in ast.walk(tree) if isinstance(n, ast.ClassDef))
    assert [name for name, count in names.items() if count > 1] == []


def test_nobody_asks_for_the_kind_of_an_effect_or_a_residual() -> None:
    """But their own folders: whatever goes by a kind is a member or a trait."""
    classes = [(n, part(path)) for path, tree in SOURCES.items() for n in ast.walk(tree) if isinstance(n, ast.ClassDef)]
    home = {"Effect": "effects", "Residual": "diagnose"}
    for _ in range(10):  # as deep as bases of bases go
        for node, folder in classes:
            bases = {name.id for base in node.bases for name in ast.walk(base) if isinstance(name, ast.Name)}
            if bases & home.keys():
                home.setdefault(node.name, folder)
    assert len(home) > 60
    for path, tree in SOURCES.items():
        asked = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "isinstance"]
        kinds = {name.id for n in asked for name in ast.walk(n.args[1]) if isinstance(name, ast.Name)}
        assert not [k for k in kinds - {"Effect"} if home.get(k, part(path)) != part(path)], path


def test_the_files_that_the_architecture_page_names_are_there() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = re.findall(r"`([\w/]+(?:\.py|/))`", text)
    assert len(named) > 50
    missing = [name for name in named if not ((ROOT.parent if name.startswith("tests") else ROOT) / name).exists()]
    assert missing == []


def test_an_effect_is_small() -> None:
    """What a robot needs of one; what others ask stands in bases and objects of its own."""
    assert len([name for name in vars(Effect) if not name.startswith("_")]) <= 15


LONGEST_FILE, LONGEST_FUNCTION = 800, 60  # lines; a function is counted from its first decorator, without its docstring


def functions(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Each function's name and its lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            docstring = node.body[:1] if ast.get_docstring(node) is not None else []
            yield node.name, lines(first, node) - sum(lines(each.lineno, each) for each in docstring)


def lines(first: int, node: ast.stmt) -> int:
    return int(node.end_lineno or first) - first + 1


def test_files_are_short() -> None:
    lengths = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in SOURCES}
    long = {name: length for name, length in lengths.items() if length >= LONGEST_FILE}
    assert long == {}


def test_functions_are_short() -> None:
    every = ((f"{path.relative_to(ROOT)}: {name}", n) for path, tree in SOURCES.items() for name, n in functions(tree))
    long = {name: length for name, length in every if length >= LONGEST_FUNCTION}
    assert long == {}
