"""The compiler options that make the step fast, set only in processes that do nothing but compile.

They change the speed of a program, not its results. Some make jaxlib 0.10.2 abort on ordinary programs (scatters in
loops), which is one reason why no user's process has them.
"""

from __future__ import annotations

from collections.abc import Mapping

# Names with "-" go to LLVM, those with "--" are separate flags. `physics/lanes.py` looks whether the first is set;
# nothing else in the project names an option.
OPTIONS: Mapping[str, str] = {
    # One loop for several results, instead of one for each that repeats what they share.
    "xla_cpu_use_multi_output_fusion": "true",
    # LLVM compares more pairs of arrays before it gives up vectorising a loop with many results.
    "-vectorize-memory-check-threshold": "100000",
    # The widest vectors, bits; the default is half of AVX-512. No effect on machines without it.
    "--xla_cpu_prefer_vector_width": "512",
}
# For few lanes. LLVM would not vectorise, because it estimates that its checks for overlapping arrays cost more than
# vectors save, and it would unroll copies of rows. With 128 lanes these options cost 5 to 13 %.
FEW_LANES: Mapping[str, str] = {"-force-vector-width": "16", "-unroll-full-max-count": "8"}
MANY = 128
_EXTRA = "--xla_backend_extra_options="


def options_for(lanes: int) -> Mapping[str, str]:
    """Return the options for a program of so many worlds side by side."""
    return {**OPTIONS, **FEW_LANES} if 1 < lanes < MANY else OPTIONS


def xla_flags(options: Mapping[str, str]) -> str:
    """Return options as a value of XLA_FLAGS."""
    settings = [f"{name}={value}" for name, value in options.items()]
    extra = ",".join(setting for setting in settings if not setting.startswith("--"))
    own = [setting for setting in settings if setting.startswith("--")]
    return " ".join([*([_EXTRA + extra] if extra else []), *own])
