"""A process that works out chunks for another one: `python -m iphyre_jax.data.generated SEED PROTOCOL KIND`.

It reads a request a line, {"chunk": number}. It answers with the chunk as an NPZ file, and ends with its input.
"""

from __future__ import annotations

import json
import sys
from typing import cast

from iphyre_jax.data.generated.chunks import make_chunk
from iphyre_jax.data.generated.drawing import SceneKind
from iphyre_jax.data.generated.pool import GeneratorSettings
from iphyre_jax.envs.protocols import protocol_named
from iphyre_jax.execution import configuration
from iphyre_jax.execution.requests import next_request, open_answers, request_lines, send
from iphyre_jax.files import pack_npz


def main() -> None:
    """Answer until the input ends."""
    seed, protocol, kind = sys.argv[1:]
    settings = GeneratorSettings(int(seed), protocol_named(protocol), cast(SceneKind, kind))
    answers, requests = open_answers(), request_lines()
    configuration.configure(devices=1)  # the other cores have processes of their own
    while True:
        number = json.loads(next_request(requests, None))["chunk"]
        send(answers, {}, pack_npz(make_chunk(settings, number)))


if __name__ == "__main__":
    main()
