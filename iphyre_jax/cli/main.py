"""The command `iphyre-jax`: takes arguments, returns an exit code, explains every error in one line."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence

from iphyre_jax import __version__

ERROR = 2  # exit code of a mistake
INTERRUPTED = 130  # exit code after Ctrl-C
OUTPUT_CLOSED = 141  # exit code if the reader of the output has gone, as with `| head`
EXTRA_OF = {  # of missing packages; all others: `train`
    "PIL": "viewer",
    "imageio_ffmpeg": "viewer",
    "anthropic": "llm",
    "openai": "llm",
    "h5py": "minari",
    "minari": "minari",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit.

    Args:
        arguments: the command line; by default that of the process.
    """
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    0: success, also for --help and --version. 2: a mistake, explained in one line on the standard error, or in a short
    box if an option is wrong. 130: Ctrl-C; 143 and 129: SIGTERM and SIGHUP, by which a training run is saved as by
    Ctrl-C. 141: the reader of the output has gone.
    """
    try:
        if list(sys.argv[1:] if arguments is None else arguments) == ["--version"]:
            print(f"iphyre-jax {__version__}", flush=True)
            return 0
        commands = importlib.import_module("iphyre_jax.cli.app")
        return int(commands.run(arguments))
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package == "iphyre_jax":
            raise
        extra = EXTRA_OF.get(package, "train")
        return _fail(
            f"this command needs the extra '{extra}' ({error.name} is missing): pip install 'iphyre-jax[{extra}]'"
        )
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else the interpreter complains as it ends
        return OUTPUT_CLOSED
    except OSError as error:
        named = error.strerror and error.filename  # the system's words, without its number
        return _fail(f"{error.filename}: {error.strerror}" if named else str(error))
    except (ValueError, MemoryError) as error:
        return _fail(str(error) or "out of memory")
    except SystemExit as end:  # of the parser: --help and wrong options
        return end.code if isinstance(end.code, int) else ERROR if end.code else 0
    except KeyboardInterrupt:
        return INTERRUPTED


def _fail(message: str) -> int:
    """Print an error, or several, in one line and return its exit code."""
    print(f"iphyre-jax: {'; '.join(message.splitlines())}", file=sys.stderr)
    return ERROR
