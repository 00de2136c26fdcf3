"""The subcommands of `iphyre-jax`: parsing and dispatch. Needs the extra `train`."""

from __future__ import annotations

import ast
import importlib
import os
import pkgutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import make_dataclass
from functools import reduce
from operator import or_
from shutil import get_terminal_size
from types import MappingProxyType
from typing import Annotated, Any, Final, NoReturn

import tyro
from rich.console import Console

from iphyre_jax.cli.console import CommandConsole
from iphyre_jax.execution.compilation.cache_folder import OFF_WORDS
from iphyre_jax.execution.configuration import configure, default_options
from iphyre_jax.execution.forks import check_fork

NARROWEST = 20  # columns of a help text
CONFIGURE_VARIABLE = "IPHYRE_JAX_CONFIGURE"
PLAY_NOTHING = ("games", "scene")

Action = Callable[[Any, Console], int | None]

# Module, arguments and function of each. Only what is called is imported: agents alone take more than a second.
SUBCOMMANDS: Final[Mapping[str, tuple[str, str, str]]] = MappingProxyType(
    {
        "train": ("train", "Train", "run"),
        "resume": ("train", "Resume", "run"),
        "evaluate": ("train", "Evaluate", "run"),
        "compare": ("train", "Compare", "run"),
        "verify-pretrained": ("train", "VerifyPretrained", "verify_pretrained"),
        "analyse": ("analyse", "Analyse", "run"),
        "ask": ("ask", "Ask", "run"),
        "classifier": ("classifier", "ClassifierCommand", "run"),
        "sequence": ("sequence", "SequenceCommand", "run"),
        "world": ("world", "WorldCommand", "run"),
        "simulate": ("simulate", "Simulate", "run"),
        "games": ("simulate", "Games", "games"),
        "scene": ("scenes", "SceneCommand", "run"),
        "render": ("viewer.render", "Render", "run"),
        "replay": ("viewer.pages", "Replay", "replay"),
        "play": ("viewer.pages", "PlayPage", "play"),
        "score": ("viewer.pages", "Score", "score"),
        "collect": ("data", "Collect", "run"),
        "generate": ("generate", "Generate", "run"),
    }
)


def run(arguments: Sequence[str] | None = None) -> int:
    """Parse the arguments, run the command and return the exit code.

    Calls `configure` first, unless the environment variable IPHYRE_JAX_CONFIGURE is "off".
    """
    name, command = _with_present_name(*_parse(list(sys.argv[1:] if arguments is None else arguments)))
    if name not in PLAY_NOTHING:
        if os.environ.get(CONFIGURE_VARIABLE, "").lower() not in OFF_WORDS:
            configure()
        check_fork()  # some commands use JAX before they play
    _, action = _loaded(name)
    with default_options():
        return action(command, CommandConsole()) or 0


def _loaded(name: str) -> tuple[type, Action]:
    """Return what a subcommand takes, and what it does."""
    module, kind, action = SUBCOMMANDS[name]
    loaded = importlib.import_module(f"iphyre_jax.cli.{module}")
    return getattr(loaded, kind), getattr(loaded, action)


def _parse(arguments: list[str]) -> tuple[str, object]:
    """Return the subcommand that arguments name, and what it takes."""
    if get_terminal_size().columns < NARROWEST:  # the parser never ends with some five
        os.environ["COLUMNS"] = str(NARROWEST)
    name, *own = arguments or [""]
    if name not in SUBCOMMANDS:
        _explain(arguments)
    kind, _ = _loaded(name)
    default: object = tyro.MISSING_NONPROP
    if name == "train":  # its defaults depend on the agent that the arguments name
        from iphyre_jax.cli import train

        own = train.renamed(own)
        default = train.defaults(own)
    return name, tyro.cli(kind, prog=f"iphyre-jax {name}", args=own, default=default)


def _explain(arguments: Sequence[str]) -> NoReturn:
    """Print the help of all subcommands, or what is wrong with arguments that name none, and exit."""
    kinds = [Annotated[_described(name), tyro.conf.subcommand(name)] for name in SUBCOMMANDS]
    description = (
        "I-PHYRE in JAX: train, evaluate and compare agents, play and render games, check scenes. "
        "iphyre-jax --version prints the version."
    )
    commands: Any = reduce(or_, kinds)
    tyro.cli(commands, prog="iphyre-jax", description=description, args=arguments)
    raise AssertionError(f"{arguments} name a subcommand")


def _described(name: str) -> type:
    """Return an empty dataclass with the docstring of what a subcommand takes; nothing is imported."""
    module, kind, _ = SUBCOMMANDS[name]
    source = pkgutil.get_data("iphyre_jax.cli", f"{module.replace('.', '/')}.py") or b""
    classes = (node for node in ast.parse(source).body if isinstance(node, ast.ClassDef))
    text = next(ast.get_docstring(node) for node in classes if node.name == kind)
    return make_dataclass(kind, (), namespace={"__doc__": text})


def _with_present_name(name: str, command: Any) -> tuple[str, object]:  # noqa: ANN401 - of any subcommand
    """Replace `evaluate NAME` and `evaluate FILE`, with a warning, by the commands that took their place."""
    if name != "evaluate":
        return name, command
    from iphyre_jax.train.storage import pretrained

    named: object
    if command.run.is_file():
        present, named = "score", command.run
    elif not command.run.exists() and str(command.run) in pretrained.names():
        present, named = "verify-pretrained", str(command.run)
    else:
        return name, command
    old, new = f"evaluate {named}", f"{present} {named}"
    print(f"iphyre-jax: FutureWarning: `{old}` is deprecated; use `iphyre-jax {new}`", file=sys.stderr)
    kind, _ = _loaded(present)
    return present, kind(named)
