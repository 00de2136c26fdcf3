"""Generated scenes: made of the ten basic games and their elements, kept if random plans sometimes solve them."""

from iphyre_jax.data.generated.generate import generate_scenes
from iphyre_jax.data.generated.pool import GeneratedScenes, generated_file, load_generated, save_generated

__all__ = ["GeneratedScenes", "generate_scenes", "generated_file", "load_generated", "save_generated"]
