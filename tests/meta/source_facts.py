"""Annotations, lengths of functions and imports inside functions of the package, read from its syntax trees."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "tarc"


@cache
def syntax_trees() -> dict[str, ast.Module]:
    """Syntax tree by dotted module name."""
    trees = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
        trees[name] = ast.parse(path.read_text(encoding="utf-8"))
    return trees


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Every function and method, those inside functions included, with its module's name."""
    for module, tree in syntax_trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield module, node


def annotations() -> Iterator[ast.expr]:
    """Every annotation of a parameter, a result, a field or a variable."""
    for _, function in functions():
        arguments = function.args
        named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
        variadic = [variable for variable in (arguments.vararg, arguments.kwarg) if variable is not None]
        yield from (argument.annotation for argument in (*named, *variadic) if argument.annotation is not None)
        if function.returns is not None:
            yield function.returns
    for tree in syntax_trees().values():
        yield from (node.annotation for node in ast.walk(tree) if isinstance(node, ast.AnnAssign))


def is_bare_any(annotation: ast.expr) -> bool:
    """Whether an annotation is `Any`, alone or as a member of a union."""
    if isinstance(annotation, ast.BinOp):
        return is_bare_any(annotation.left) or is_bare_any(annotation.right)
    return isinstance(annotation, ast.Name) and annotation.id == "Any"


def n_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function from its `def`, without its docstring."""
    lines = (function.end_lineno or function.lineno) - function.lineno + 1
    first = function.body[0]
    if ast.get_docstring(function, clean=False) is not None:
        lines -= (first.end_lineno or first.lineno) - first.lineno + 1
    return lines


def imports_inside_functions() -> set[tuple[str, str]]:
    """Pairs of a module and a module of the package that a function in it imports."""
    pairs = set()
    for module, function in functions():
        for node in ast.walk(function):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "tarc":
                within = [f"{node.module}.{alias.name}" for alias in node.names]
                pairs |= {(module, name if name in syntax_trees() else str(node.module)) for name in within}
            elif isinstance(node, ast.Import):
                pairs |= {(module, alias.name) for alias in node.names if alias.name.split(".")[0] == "tarc"}
    return pairs


def raised_classes() -> Iterator[tuple[str, str]]:
    """Every raised class, with its module's name."""
    for module, tree in syntax_trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                yield module, ast.unparse(node.exc.func)


def caught_classes() -> Iterator[tuple[str, str]]:
    """Every class that a handler or `suppress` catches, with its module's name; empty for one that catches all."""
    for module, tree in syntax_trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ExceptHandler):
                classes = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("suppress"):
                classes = node.args
            else:
                continue
            yield from ((module, "" if kind is None else ast.unparse(kind)) for kind in classes)
