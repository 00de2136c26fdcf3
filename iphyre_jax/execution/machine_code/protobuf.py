"""Protocol buffers as they stand in a file: numbered fields, without the names and types of a schema.

The wire format is https://protobuf.dev/programming-guides/encoding. No schema of XLA's messages comes with jaxlib.
"""

from __future__ import annotations

from typing import Final

_VARINT: Final = 0
_FIXED_SIZES: Final = {1: 8, 5: 4}  # bytes, by wire type
_BYTES: Final = 2
_BITS: Final = 64  # of the longest number


class Message:
    """A message of numbered fields.

    Args:
        content: its bytes.

    Raises:
        ValueError: they are no message; one line.
    """

    def __init__(self, content: bytes) -> None:
        self._values: dict[int, list[int | bytes]] = {}
        at = 0
        while at < len(content):
            tag, at = read_varint(content, at)
            value, at = _read_value(content, at, tag & 7)
            self._values.setdefault(tag >> 3, []).append(value)

    def __contains__(self, field: int) -> bool:
        """Return whether a field is there; without a schema, one with its default value is not."""
        return field in self._values

    def number(self, field: int) -> int:
        """Return a whole number; 0 if it is missing, as a schema would say."""
        value = self._values.get(field, [0])[-1]
        if not isinstance(value, int):
            raise ValueError(f"field {field}: expected a number, got bytes")
        return value

    def all_bytes(self, field: int) -> list[bytes]:
        """Return every value of a field that holds bytes."""
        values = self._values.get(field, [])
        if not all(isinstance(value, bytes) for value in values):
            raise ValueError(f"field {field}: expected bytes, got a number")
        return [value for value in values if isinstance(value, bytes)]

    def all_messages(self, field: int) -> list[Message]:
        """Return every value of a field that holds messages."""
        return [Message(value) for value in self.all_bytes(field)]

    def bytes(self, field: int) -> bytes:
        """Return the one value of a field that holds bytes."""
        values = self.all_bytes(field)
        if len(values) != 1:
            raise ValueError(f"field {field}: expected one value, got {len(values)}")
        return values[0]

    def message(self, *path: int) -> Message:
        """Return the message at a path of fields, each of which has one value."""
        message = self
        for field in path:
            message = Message(message.bytes(field))
        return message


def read_varint(content: bytes, at: int) -> tuple[int, int]:
    """Return the whole number at a place, and the place behind it."""
    value = 0
    for shift in range(0, _BITS + 6, 7):
        if at >= len(content):
            break
        byte, at = content[at], at + 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise ValueError(f"byte {at}: expected a whole number")


def _read_value(content: bytes, at: int, kind: int) -> tuple[int | bytes, int]:
    if kind == _VARINT:
        return read_varint(content, at)
    size = _FIXED_SIZES.get(kind, 0)
    if kind == _BYTES:
        size, at = read_varint(content, at)
    if (not size and kind != _BYTES) or at + size > len(content):
        raise ValueError(f"byte {at}: expected a value of {size} bytes, of wire type {kind}")
    return content[at : at + size], at + size
