"""The project itself: light import, honest exports, rooms that keep their walls, kernels that compile at import."""

import importlib
import pkgutil
import subprocess
import sys

import pytest

import fleetmap

HEAVY = ("numba", "shapely", "matplotlib", "zenoh", "scipy", "networkx", "typer", "rich", "PIL")


def test_importing_fleetmap_imports_nothing_heavy():
    code = f"import sys, fleetmap; print([m for m in {HEAVY!r} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_every_exported_name_exists_and_none_is_forgotten():
    assert sorted(fleetmap.__all__) == fleetmap.__all__
    for name in fleetmap.__all__:
        assert getattr(fleetmap, name) is not None
    assert set(fleetmap._HOMES) | {"__version__", "sync"} == set(fleetmap.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        fleetmap.nothing  # noqa: B018


def test_the_codecs_room_is_not_the_standard_library():
    assert importlib.import_module("fleetmap.codecs").__name__ == "fleetmap.codecs"
    assert not hasattr(importlib.import_module("codecs"), "encode_snapshot")


def test_every_room_exports_what_its_all_says():
    for info in pkgutil.iter_modules(fleetmap.__path__, "fleetmap."):
        module = importlib.import_module(info.name)
        for name in getattr(module, "__all__", []):
            assert hasattr(module, name), f"{info.name}.{name}"


def test_kernels_state_their_signatures_so_that_an_import_compiles_them():
    from numba.core.dispatcher import Dispatcher

    from fleetmap.model.kernel_cache import kernel_modules

    assert kernel_modules()
    for name in kernel_modules():
        for kernel in vars(importlib.import_module(name)).values():
            if isinstance(kernel, Dispatcher):
                assert kernel.signatures, f"{name}.{kernel.__name__} has no explicit signature"
