"""Generated scenes: drawn from the elements of the ten basic games, kept if random plans sometimes solve them."""

from iphyre_jax.data.generated.generate import generate_scenes
from iphyre_jax.data.generated.pool import GeneratedScenes, generated_file, load_generated, save_generated

__all__ = ["GeneratedScenes", "generate_scenes", "generated_file", "load_generated", "save_generated"]
