"""Protocol buffers without a schema."""

from __future__ import annotations

import pytest

from iphyre_jax.execution.machine_code.protobuf import Message, read_varint

# Field 1: 300. Field 2: a message whose field 3 is 7. Field 4: 8 bytes. Field 5: 4 bytes. Field 1 again: 5.
CONTENT = b"\x08\xac\x02\x12\x02\x18\x07\x21abcdefgh\x2dwxyz\x08\x05"


def test_fields() -> None:
    message = Message(CONTENT)
    assert message.number(1) == 5  # the last one counts
    assert message.message(2).number(3) == 7
    assert (message.bytes(4), message.bytes(5)) == (b"abcdefgh", b"wxyz")
    assert message.number(9) == 0
    assert 1 in message
    assert 9 not in message
    assert message.all_messages(9) == []


@pytest.mark.parametrize("number", [0, 127, 128, 300, 2**32, 2**64 - 1])
def test_whole_numbers_of_any_length(number: int) -> None:
    parts = [number >> shift & 127 for shift in range(0, max(number.bit_length(), 1), 7)]
    content = bytes(part | 128 for part in parts[:-1]) + bytes(parts[-1:])
    assert read_varint(b"?" + content + b"?", 1) == (number, 1 + len(content))


@pytest.mark.parametrize("size", [size for size in range(1, len(CONTENT)) if size not in (3, 7, 16, 21)])
def test_a_message_cut_short_is_refused(size: int) -> None:
    with pytest.raises(ValueError, match=r"byte \d+: expected a") as raised:
        Message(CONTENT[:size])
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("content", [b"\x0b", b"\x08" + b"\xff" * 12])
def test_what_is_no_field_is_refused(content: bytes) -> None:
    with pytest.raises(ValueError, match=r"byte \d+: expected a"):
        Message(content)


def test_another_kind_of_value_is_refused() -> None:
    message = Message(CONTENT)
    with pytest.raises(ValueError, match="field 1: expected bytes, got a number"):
        message.bytes(1)
    with pytest.raises(ValueError, match="field 2: expected a number, got bytes"):
        message.number(2)
    with pytest.raises(ValueError, match="field 9: expected one value, got 0"):
        message.message(9)
