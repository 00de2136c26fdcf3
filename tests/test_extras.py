"""What an optional extra brings and is missing is named, with the extra, where Python code meets it."""

from __future__ import annotations

import importlib
import sys

import pytest

import iphyre_jax.train
import iphyre_jax.viewer


@pytest.mark.parametrize(
    ("module", "package", "extra"),
    [
        ("iphyre_jax.viewer.frames", "PIL", "viewer"),
        ("iphyre_jax.viewer.films", "PIL", "viewer"),
        ("iphyre_jax.viewer.sheets", "PIL", "viewer"),
        ("iphyre_jax.viewer.painter", "PIL", "viewer"),
        ("iphyre_jax.train", "flax", "train"),
        ("iphyre_jax.train.loop", "orbax", "train"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(
    module: str, package: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for part in ("train", "viewer"):  # importing them anew binds these names, which is undone at the end
        monkeypatch.setattr(iphyre_jax, part, getattr(iphyre_jax, part))
    for name in list(sys.modules):
        if name.startswith(("iphyre_jax.viewer", "iphyre_jax.train")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ModuleNotFoundError, match=r"^iphyre_jax\.\S+ needs the extra") as caught:
        importlib.import_module(module)
    assert str(caught.value).endswith(f"('{extra}' ({package} is missing): pip install 'iphyre-jax[{extra}]'"[1:])
    assert caught.value.name == package
