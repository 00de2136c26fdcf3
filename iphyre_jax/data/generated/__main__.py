"""A process that works out chunks for another one: `python -m iphyre_jax.data.generated SEED PROTOCOL`.

It reads the number of a chunk a line. It answers with LENGTH bytes, the length of what follows, and the chunk as an NPZ
file, and ends with its input.
"""

from __future__ import annotations

import os
import sys

from iphyre_jax.data.generated.chunks import make_chunk
from iphyre_jax.data.generated.workers import LENGTH
from iphyre_jax.envs.protocols import protocol_named
from iphyre_jax.execution import configuration
from iphyre_jax.files import pack_npz


def main() -> None:
    """Answer until the input ends."""
    seed, protocol = int(sys.argv[1]), protocol_named(sys.argv[2])
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # output of libraries must not mix with answers
    configuration.configure(devices=1)  # the other cores have processes of their own
    for line in sys.stdin.buffer:
        content = pack_npz(make_chunk(seed, int(line), protocol))
        try:
            answers.write(len(content).to_bytes(LENGTH, "big") + content)
            answers.flush()
        except BrokenPipeError:  # the other one was killed
            os._exit(0)  # closing `answers` would raise the same again


if __name__ == "__main__":
    main()
