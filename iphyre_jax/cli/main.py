"""The command `iphyre-jax`: arguments in, exit code out, one line for every error."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence

ERROR = 2  # exit code
INTERRUPTED = 130  # exit code of a command that was ended with Ctrl-C
VIEWER_PACKAGES = ("PIL", "imageio_ffmpeg")  # of the extra `viewer`; all others are of `train`
UNREAD = 141  # exit code of a command whose output nobody reads any more, as behind `| head`


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit.

    Args:
        arguments: in place of those of the process.
    """
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code.

    0 if all went well, also after --help; 2 with one line on the standard error for a mistake of the caller, or with a
    short box if an option is wrong; 130 for a run that was ended with Ctrl-C; 141 if nobody reads the output any more.
    """
    try:
        commands = importlib.import_module("iphyre_jax.cli.app")
        return int(commands.run(arguments))
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package == "iphyre_jax":
            raise
        extra = "viewer" if package in VIEWER_PACKAGES else "train"
        return _fail(
            f"this command needs the extra '{extra}' ({error.name} is missing): pip install 'iphyre-jax[{extra}]'"
        )
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else the interpreter complains as it ends
        return UNREAD
    except (ValueError, OSError) as error:
        return _fail(str(error))
    except SystemExit as end:  # of the parser: --help and wrong options
        return end.code if isinstance(end.code, int) else ERROR if end.code else 0
    except KeyboardInterrupt:
        return INTERRUPTED


def _fail(message: str) -> int:
    """Say what is wrong on the standard error."""
    print(f"iphyre-jax: {message}", file=sys.stderr)
    return ERROR
