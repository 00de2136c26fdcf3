"""How counters and order keys are packed into 31 bits."""

COUNTER_START = 256  # counters of the first insertions lie below
STATIC_RANKS = 64  # more static bars than a scene can have


class OrderKeyLayout:
    """Widths of the fields of counters and order keys, from the number of moving bodies.

    counter = start + step * per_step + rank * per_rank + position; key = (owner's rank, position in the owner's list,
    second point), most significant first. 31 bits must hold it: `max_steps` is 131 070 for n = 7, 16 382 for n = 12.
    """

    def __init__(self, moving: int) -> None:
        self.moving = moving
        rank_bits = max(moving - 1, 0).bit_length()
        self.per_rank = 2 ** (STATIC_RANKS + moving * moving).bit_length()
        self.per_step = self.per_rank << rank_bits
        self.inner_bits = 30 - rank_bits
        self.newest = 2**self.inner_bits - 1
        self.max_steps = (self.newest - COUNTER_START) // self.per_step - 1
