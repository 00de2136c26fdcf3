"""Registers every id with gymnasium when imported, for gymnasium's own form of an id, "module:id".

`gymnasium.make("iphyre_jax.gym:iphyre/on-the-fly-hole-v1")` needs nothing imported or registered first, also in worker
processes, which know no ids of their parent.

Raises:
    ImportError: gymnasium is missing; one line that names the extra.
"""

from iphyre_jax.adapters import register_gymnasium

register_gymnasium()
