"""Parses a command line into a verb and its arguments, or an error message."""

import functools
import inspect
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import Annotated, Any, NoReturn, get_args, get_origin, get_type_hints

from recon.cli import listing
from recon.cli.examples import EXAMPLES
from recon.core.visible import visible

BAD_USAGE = 2


def parsed_command(words: Sequence[str]) -> Callable[[], None]:
    """Parse a command line; return a function without arguments that runs its verb.

    Raises:
        SystemExit: after `--help`, and, with code 2, when the words are no command.
    """
    import tyro

    words = _with_all_joined_to_verb(list(words))
    if any(word == "" or (word.startswith("--") and word.endswith("=")) for word in words):
        _exit_with_error("one argument is empty, as of a variable that is not set; leave it out")
    first = words[0] if len(words) > 0 else ""
    if first in listing.CORE or (first and first in listing.verb_names()):
        return _parsed_verb(first, words[1:])
    names = listing.verb_names()
    if first and not first.startswith("-"):
        _exit_with_error(
            f"there is no verb {first}{_did_you_mean(first, names)}; the verbs are "
            f"{', '.join(names)}. `recon --help` tells what they do"
        )
    if unknown := _unknown_options(words, ("-h", "--help", *_COMPLETION)):
        _exit_with_error(f"there is no option {unknown[0]}; `recon --help` lists the verbs")
    app = tyro.extras.SubcommandApp()
    for name in names:
        app.command(name=name)(_with_short_help(listing.function_of_verb(name)))
    return app.cli(prog="recon", description=listing.__doc__ or "", args=words or ["--help"])


def _with_all_joined_to_verb(words: list[str]) -> list[str]:
    """Replace `VERB --all` by the verb `VERB-all`, which another package registers."""
    option = listing.WHOLE.get(words[0], ()) if words else ()
    for k in range(len(words)):
        for spelt in (list(option), ["=".join(option)]):
            if option and words[k : k + len(spelt)] == spelt:
                return [f"{words[0]}-all", *words[1:k], *words[k + len(spelt) :]]
    return words


_COMPLETION = ("--tyro-print-completion", "--tyro-write-completion")


def _parsed_verb(name: str, words: Sequence[str]) -> Callable[[], None]:
    """Parse the arguments of one verb; return a function that runs the verb with them."""
    import tyro

    verb = listing.function_of_verb(name)
    options = options_of(verb)
    if "--out" not in options and "out" in inspect.signature(verb).parameters:
        words = _with_out_option_last(words)
    later = _storing_arguments(verb)
    ask = functools.partial(
        tyro.cli, later, prog=f"recon {name}", description=_description(name, verb), args=words
    )
    try:
        return ask(console_outputs="-h" in words or "--help" in words)
    except SystemExit as end:
        if not end.code:
            raise
    if unknown := _unknown_options(words, options):
        word = unknown[0]
        _exit_with_error(
            f"`recon {name}` has no option {word}{_did_you_mean(word, options)}; "
            f"`recon {name} --help` lists its options"
            + (f"; a file of this name is ./{word}" if "." in word else "")
        )
    # all other errors are reported by tyro, the parser
    return ask()


def _with_out_option_last(words: Sequence[str]) -> Sequence[str]:
    """Move `--out PLACE` to the end, for verbs whose output is the last argument."""
    for k, word in enumerate(words):
        if word == "--out" and k + 1 < len(words):
            return [*words[:k], *words[k + 2 :], words[k + 1]]
        if word.startswith("--out="):
            return [*words[:k], *words[k + 1 :], word.removeprefix("--out=")]
    return words


def options_of(verb: Callable[..., None]) -> set[str]:
    """Return the names of all options of a verb, such as --fps, with --no-... of switches."""
    parameters = inspect.signature(verb).parameters.values()
    return {"-h", "--help", *_COMPLETION}.union(
        *(_option_names(one.name, one.annotation, one.default) for one in parameters)
    )


def _option_names(name: str, hint: Any, default: Any) -> set[str]:
    """Return the option names for one parameter; a dataclass gives one option per field."""
    from tyro.conf import Positional

    if is_dataclass(default):
        hints = get_type_hints(type(default), include_extras=True)
        return set().union(
            *(
                _option_names(f.name, hints[f.name], getattr(default, f.name))
                for f in fields(default)
            )
        )
    marks = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    if set(marks) & set(get_args(Positional[str])[1:]):
        return set()
    names = [other for mark in marks if (other := getattr(mark, "name", None))] or [name]
    word = names[0].replace("_", "-")
    return {f"--{word}", f"--no-{word}"} if isinstance(default, bool) else {f"--{word}"}


def _storing_arguments(verb: Callable[..., None]) -> Callable[..., Callable[[], None]]:
    """Wrap a verb so that a call does not run it, but returns a function that does."""

    @functools.wraps(verb)
    def store_arguments(*args: Any, **kwargs: Any) -> Callable[[], None]:
        return functools.partial(verb, *args, **kwargs)

    return store_arguments


def _with_short_help(verb: Callable[..., None]) -> Callable[..., Callable[[], None]]:
    """Wrap a verb as `_storing_arguments` does, with its docstring cut to one paragraph."""
    storing = _storing_arguments(verb)
    storing.__doc__ = (inspect.getdoc(verb) or "").partition("\n\n")[0]
    return storing


def _description(name: str, verb: Callable[..., None]) -> str:
    text = (inspect.getdoc(verb) or "").partition("\n\nArgs:")[0]
    if name not in EXAMPLES:
        return text
    return "\n".join((text, "", "Examples:", *(f"  {one}" for one in EXAMPLES[name])))


def _unknown_options(words: Sequence[str], options: Iterable[str]) -> list[str]:
    """Return those words of a command line that look like options but are unknown."""
    known = set(options)
    names = [word.partition("=")[0] for word in words]
    return [
        name for name in names
        if name.startswith("-") and name.strip("-")[:1].isalpha()
        and name.replace("_", "-") not in known
    ]  # fmt: skip


def _did_you_mean(word: str, known: Iterable[str]) -> str:
    near = get_close_matches(word.replace("_", "-"), sorted(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def _exit_with_error(message: str) -> NoReturn:
    sys.stderr.write(f"recon: {visible(message)}\n")
    raise SystemExit(BAD_USAGE)
