import logging

from numba import njit

from twc_env.exploration.compilation import _FirstCompilation, announce_compilation


def compiled(module: str):
    def add(a, b):
        return a + b

    add.__module__ = module
    return njit(add)(1, 2)


def test_the_first_kernel_of_this_package_that_is_compiled_is_announced_once(caplog):
    from numba.core import event

    listener = _FirstCompilation()
    event.register("numba:compile", listener)
    try:
        with caplog.at_level(logging.WARNING, "twc_env"):
            compiled("another.package")
            assert not caplog.records
            compiled("twc_env.world.lidar")
            compiled("twc_env.world.lidar")
    finally:
        event.unregister("numba:compile", listener)
    # Another environment of this process may have spoken up already, or may do so now.
    assert 1 <= len(caplog.records) <= 2
    assert all("first use" in record.message for record in caplog.records)


def test_environments_ask_for_it_once_per_process():
    announce_compilation()
    before = announce_compilation.cache_info().misses
    announce_compilation()
    assert announce_compilation.cache_info().misses == before
