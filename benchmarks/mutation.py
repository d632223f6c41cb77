"""Makes small faults in a module's source: the standard operators of mutation testing."""

import ast
import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

_COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_COUNTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.MatMult: ast.Mult, ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}  # fmt: skip
_CALLED = {
    "any": "all", "all": "any", "min": "max", "max": "min", "argmin": "argmax",
    "argmax": "argmin", "amin": "amax", "amax": "amin", "minimum": "maximum",
    "maximum": "minimum", "floor": "ceil", "ceil": "floor", "mT": "T", "zeros": "ones",
    "zeros_like": "ones_like", "ones": "zeros", "append": "clear", "sum": "mean",
}  # fmt: skip
"""Functions and methods that programmers mistake for each other."""


@dataclass(frozen=True)
class Mutant:
    """One fault: its line, the changed code before and after, and the whole changed source."""

    line: int
    operator: str
    before: str
    after: str
    source: str


def places(source: str) -> list[tuple[int, str]]:
    """List the possible faults of a source: index of the syntax node, and name of the operator.

    Docstrings, annotations, decorators, imports and `raise` statements are not changed.
    """
    return [
        (number, name)
        for number, node in enumerate(_changeable(ast.parse(source)))
        for name, change in _OPERATORS.items()
        if change(_copied(node))
    ]


def _copied(node: ast.AST) -> ast.AST:
    """Copy a syntax node two levels deep, as far as operators reach, so that it may be changed."""
    twin = copy.copy(node)
    for name, value in ast.iter_fields(node):
        setattr(twin, name, copy.copy(value))
    return twin


def mutant(source: str, place: tuple[int, str]) -> Mutant:
    """Apply an operator to a source at a place that `places` gave."""
    number, name = place
    tree = ast.parse(source)
    node = list(_changeable(tree))[number]
    before = ast.unparse(node)
    _OPERATORS[name](node)
    ast.fix_missing_locations(tree)
    return Mutant(node.lineno, name, before, ast.unparse(node), ast.unparse(tree))


def _changeable(tree: ast.AST) -> Iterator[ast.expr | ast.stmt]:
    """Yield statements and expressions that may be changed."""
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.Raise | ast.Import | ast.ImportFrom | ast.JoinedStr | ast.arg):
            continue
        inside: Sequence[Any] | None = None
        if isinstance(child, ast.AnnAssign):
            inside = [child.value]
        elif isinstance(child, ast.FunctionDef):
            inside = [*child.args.defaults, *child.args.kw_defaults, *child.body]
        elif isinstance(child, ast.ClassDef):  # decorators of classes are left as they are
            inside = child.body
        if inside is not None:
            yield from _changeable(ast.Module([one for one in inside if one is not None], []))
            continue
        if isinstance(child, ast.expr | ast.stmt):
            yield child
        yield from _changeable(child)


def _comparison(node: ast.AST) -> bool:
    if not isinstance(node, ast.Compare) or type(node.ops[0]) not in _COMPARED:
        return False
    node.ops[0] = _COMPARED[type(node.ops[0])]()
    return True


def _arithmetic(node: ast.AST) -> bool:
    if not isinstance(node, ast.BinOp | ast.AugAssign) or type(node.op) not in _COUNTED:
        return False
    node.op = _COUNTED[type(node.op)]()
    return True


def _connective(node: ast.AST) -> bool:
    if not isinstance(node, ast.BoolOp):
        return False
    node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    return True


_NUMBERS: dict[type, Callable[[Any], Any]] = {
    bool: lambda value: not value,
    int: lambda value: value + 1,
    float: lambda value: 2 * value or 1.0,
}


def _number(node: ast.AST) -> bool:
    if not isinstance(node, ast.Constant) or type(node.value) not in _NUMBERS:
        return False
    node.value = _NUMBERS[type(node.value)](node.value)
    return True


def _sign(node: ast.AST) -> bool:
    """Change `-x` and `not x` to `x`."""
    if not isinstance(node, ast.UnaryOp) or not isinstance(
        node.op, ast.USub | ast.Not | ast.Invert
    ):
        return False
    node.op = ast.UAdd() if isinstance(node.op, ast.USub) else node.op
    if isinstance(node.op, ast.Not):
        node.operand = ast.UnaryOp(ast.Not(), node.operand)
    elif isinstance(node.op, ast.Invert):
        node.operand = ast.UnaryOp(ast.Invert(), node.operand)
    return True


def _condition(node: ast.AST) -> bool:
    if not isinstance(node, ast.If | ast.While | ast.IfExp):
        return False
    node.test = ast.UnaryOp(ast.Not(), node.test)
    return True


def _function(node: ast.AST) -> bool:
    name = getattr(node, "attr", None) or getattr(node, "id", None)
    if name not in _CALLED or not isinstance(node, ast.Attribute | ast.Name):
        return False
    setattr(node, "attr" if isinstance(node, ast.Attribute) else "id", _CALLED[name])
    return True


def _left_out(node: ast.AST) -> bool:
    """Leave out a call whose value is not used."""
    if not isinstance(node, ast.Expr) or not isinstance(node.value, ast.Call):
        return False
    node.value = ast.Constant(None)
    return True


_OPERATORS: dict[str, Callable[[ast.AST], bool]] = {
    "comparison": _comparison,
    "arithmetic": _arithmetic,
    "connective": _connective,
    "constant": _number,
    "sign": _sign,
    "condition": _condition,
    "function": _function,
    "statement left out": _left_out,
}
