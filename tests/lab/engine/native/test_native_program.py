"""C that a room brings: loaded once, prebuilt where a wheel has it, called with arrays."""

import platform
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from homeward.native import library, program


def test_functions_that_many_threads_ask_for_at_once_are_loaded_once(cache, monkeypatch):
    loaded = []

    def load(source):
        loaded.append(source)
        time.sleep(0.05)  # the others come meanwhile
        return library.load(source)

    monkeypatch.setattr(program, "load", load)
    functions = program.Program("homeward.vision", {}, ())
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: functions(), range(8)))
    assert len(loaded) == 1
    assert found[0] is not None
    assert all(each is found[0] for each in found)


@pytest.mark.parametrize("damaged", [False, True])
def test_what_a_wheel_brought_is_taken_unless_it_is_damaged(damaged, cache, tmp_path, monkeypatch):
    package = f"of_a_wheel_{damaged}".lower()
    native = tmp_path / package / "native"
    native.mkdir(parents=True)
    (native.parent / "__init__.py").touch()
    (native / "first.h").write_text("#define TIMES 2\n")
    (native / "twice.c").write_text(
        "EACH_PROCESSOR int twice(long n, double *x) {\n"
        "  for (long i = 0; i < n; i++) x[i] *= TIMES;\n  return 0;\n}\n"
    )
    brought = native / library.PREBUILT
    assert library.prebuild(native, brought) == platform.machine()
    if damaged:
        brought.write_bytes(b"\x7fELF, and no more")
    monkeypatch.syspath_prepend(tmp_path)

    functions = program.Program(package, {"twice": "ia"}, ("twice",))
    assert functions()._name.startswith(str(cache if damaged else native))
    numbers = np.arange(20.0)
    assert functions().twice(numbers.size, numbers) == 0
    assert numbers.tolist() == (2 * np.arange(20.0)).tolist()
    monkeypatch.setenv("CC", "none-of-that-name")
    assert (program.Program(package, {}, ())() is None) == damaged


def test_arguments_are_of_their_type_row_by_row_and_may_be_read_only_or_empty():
    doubles = program.Array(np.float64)
    for wrong in (np.zeros((4, 3), int), np.zeros((4, 6))[:, ::2]):
        with pytest.raises(AssertionError):
            doubles.from_param(wrong)
    fixed = np.arange(12.0)
    fixed.flags.writeable = False
    for array in (fixed, np.zeros((0, 3))):
        assert doubles.from_param(array).value == array.ctypes.data
