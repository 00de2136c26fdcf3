"""Deprecated names of `scenes.compile`."""

from iphyre_jax._deprecated import moved

__getattr__ = moved(__name__, {"build": ("iphyre_jax", "compile_scene"), "timing": ("iphyre_jax", "step_timing")})
