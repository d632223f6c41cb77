"""Makes command lines from the source of functions, so that help does not load torch."""

import ast
import builtins
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from inspect import Parameter, Signature, unwrap
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

import recon
from recon.cli import running
from recon.cli.places import Overwrite, Place, Quiet, motion_output, writes
from recon.fitting.settings import FitSettings
from recon.simulation.settings import FurnitureName, LeftOver, SensorKind

Box = tuple[float, float, float, float, float, float]
TYPES: dict[str, Any] = {
    "BodyLike": Path | None,
    "MotionLike": Path,
    "MotionLike | Numbers": Path,
    "ObservationsLike": tuple[Path, ...],
    "ObservationFile | Path | str | None": Annotated[Path | None, arg(name="obs")],
    "str | Path | SkeletonRecording | MarkerRecording": Path,
    "str | Path": str,
    "Path | str": Path,
    "str | Path | None": Path | None,
    "ShapeLike": str,
    "str | Humor | Humos": Literal["humor", "humos"],
    "tuple[Corner, Corner] | None": Annotated[Box | None, arg(name="occluder")],
    "tuple[int, int] | None": str | None,
    "Axis": Literal["x", "y", "z"],
    "Up": Literal["x", "y", "z", "x-down", "y-down", "z-down"],
    "Unit": str,
    "Hand": Literal["left", "right"],
    "ImageSize": tuple[int, int],
    "FurnitureName": FurnitureName,
    "LeftOver": LeftOver,
    "SensorKind": SensorKind,
    "Literal": Literal,
    "Path": Path,
}
"""What is written on a command line for an argument of a function, by its annotation or a name in
it. Arguments of other types, such as functions and arrays, no command line can give."""


@dataclass(frozen=True)
class Verb:
    """A verb of the command line: its function, outputs and options."""

    function_name: str
    """The function as "module:name"."""
    places: tuple[Place, ...] = (Place("out", motion_output),)
    """Arguments that name its outputs; a result that it does not write is saved at the first."""
    out: str = (
        "motion file to write (AMASS .npz with joints, contacts and ground); OUT.json tells "
        "what happened."
    )
    """What is said of the argument that names its result."""
    out_follows: bool = False
    """Whether that is named after the inputs, without an option."""
    settings: FitSettings | None = None
    """Options that stand for the function's arguments of these names, with their defaults."""


def command_function(name: str, verb: Verb) -> Callable[..., None]:
    """Make the function that the command line calls for a verb, with the verb's signature."""
    function = _parsed_function(verb.function_name)
    taken = [] if verb.settings is None else [one.name for one in fields(verb.settings)]
    own = [one for one in _command_parameters(function) if one.name not in taken]
    shown = [*own, *_further_options(verb, {one.name for one in own})]
    given = [one for one in shown if one.annotation is not Parameter.empty]
    given.sort(key=lambda one: one.default is not Parameter.empty)

    def run(**arguments: Any) -> None:
        running.run(verb.function_name, [place.parameter for place in verb.places], arguments)

    # the type checker of the tests wraps `run`: name both the wrapper and the wrapped function
    for one in {run, unwrap(run)}:
        one.__name__, one.__doc__ = name, ast.get_docstring(function)
        one.__annotations__ = {parameter.name: parameter.annotation for parameter in given}
        vars(one)["__signature__"] = Signature(given)
    return writes(*verb.places)(run)


def _parsed_function(function_place: str) -> ast.FunctionDef:
    """Return the syntax tree of a function "module:name", without importing its module."""
    module, _, name = function_place.partition(":")
    path = Path(recon.__file__).parents[1].joinpath(*module.split(".")).with_suffix(".py")
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return next(one for one in tree.body if isinstance(one, ast.FunctionDef) and one.name == name)


def _command_parameters(node: ast.FunctionDef) -> list[Parameter]:
    """Return a parsed function's parameters; unannotated if no command line can give them."""
    plain = node.args.args
    missing = [None] * (len(plain) - len(node.args.defaults))
    defaults = [*missing, *node.args.defaults, *node.args.kw_defaults]
    every = zip((*plain, *node.args.kwonlyargs), defaults, strict=True)
    return [_parameter_of_argument(one, default) for one, default in every]


def _parameter_of_argument(node: ast.arg, default: ast.expr | None) -> Parameter:
    assert node.annotation is not None
    try:
        kind = _type_of_annotation(node.annotation)
    except NameError:
        return Parameter(node.arg, Parameter.KEYWORD_ONLY)
    if default is None:
        read = kind in (Path, tuple[Path, ...])
        return _option_parameter(node.arg, Positional[kind] if read else kind)
    value = ast.literal_eval(default)
    return _option_parameter(node.arg, kind, Path(value) if kind is Path else value)


def _type_of_annotation(node: ast.expr) -> Any:
    """Return the type for a command line that an annotation in source code stands for.

    Raises:
        NameError: when it is of something that no command line can give.
    """
    text = ast.unparse(node).replace('"', "'")
    if text in TYPES:
        return TYPES[text]
    match node:
        case ast.Constant(value=None | builtins.Ellipsis):
            return node.value
        case ast.Name(id="int" | "float" | "str" | "bool" | "tuple" as name):
            return getattr(builtins, name)
        case ast.BinOp(left=left, op=ast.BitOr(), right=right):
            return _type_of_annotation(left) | _type_of_annotation(right)
        case ast.Subscript(value=ast.Name(id="Literal"), slice=values):
            return Literal[ast.literal_eval(values)]
        case ast.Subscript(value=value, slice=ast.Tuple(elts=parts)):
            return _type_of_annotation(value)[tuple(_type_of_annotation(part) for part in parts)]
        case ast.Subscript(value=value, slice=part):
            return _type_of_annotation(value)[_type_of_annotation(part)]
        case _:
            raise NameError(text)


def _further_options(verb: Verb, own: set[str]) -> Iterator[Parameter]:
    """Yield the options that a verb has besides its function's own: out, json, quiet, ..."""
    if verb.settings is not None:
        yield _option_parameter("settings", OmitArgPrefixes[type(verb.settings)], verb.settings)
    if verb.places and (result := verb.places[0].parameter) not in own:
        if result == "json":
            yield _option_parameter("json", Annotated[Path | None, arg(help=verb.out)], None)
        else:
            also = " Also as --out OUT." if verb.out_follows else ""
            kind = Annotated[Path, arg(help=verb.out + also)]
            yield _option_parameter(result, Positional[kind] if verb.out_follows else kind)
    written = {place.parameter for place in verb.places}
    if "json" not in written and not own & written:
        yield _option_parameter(
            "json", Annotated[bool, arg(help="Print the report as JSON on stdout.")], False
        )
    if verb.places and "overwrite" not in own:
        yield _option_parameter("overwrite", Overwrite, False)
    if verb.places:
        yield _option_parameter("quiet", Quiet, False)


def _option_parameter(name: str, kind: Any, *default: Any) -> Parameter:
    """Make a keyword-only parameter of a signature, optionally with a default."""
    value = default[0] if default else Parameter.empty
    return Parameter(name, Parameter.KEYWORD_ONLY, annotation=kind, default=value)
