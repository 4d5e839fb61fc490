"""Compiled steps against the oracle, and everything that a compiler or a cache can do to one."""

import os
import platform
import stat
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from test_steps import kinds, run

from homeward.engine.batch.execution import execute
from homeward.engine.batch.job import Job, given_values
from homeward.engine.choice import choose
from homeward.engine.kernels import filter_kernels
from homeward.engine.native import compiler, library, program
from homeward.engine.native.cache import Cache, default_folder
from homeward.engine.native.compiler import NativeError, find_compiler
from homeward.engine.native.source import NativeProgram, source_of
from homeward.engine.program.stages import OBSERVE, Program, Symbolic, filter_parts
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.model import PolarModel

try:
    REAL = find_compiler().command[0]
except NativeError as error:
    pytest.skip(f"native engine: {error}", allow_module_level=True)

Q = 3


@pytest.fixture(autouse=True)
def _fresh(monkeypatch):
    """Forget what this process has loaded, so that each test sees the cache and the compiler."""
    for known in (library._load, compiler._find):
        known.cache_clear()
    yield
    for known in (library._load, compiler._find):
        known.cache_clear()


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    """A cache folder that only this test has."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "homeward"


def toy(value=2.0):
    """A program that takes no time to compile: y = value * sin(x)."""
    x = ca.SX.sym("x")
    return Program({"part": (Symbolic(ca.Function("f", [x], [value * ca.sin(x)], ["x"], ["y"])),)})


def answer(program):
    native = NativeProgram(program)
    native.variables["x"][:] = 0.5
    native.part("part")()
    return float(native.variables["y"][0])


def fake_compiler(folder, monkeypatch, body):
    """Make CC a shell script; $OUT in it is the library that is asked for."""
    script = folder / "fake-cc"
    asked = 'if [ "$1" = --version ]; then echo fake 1.0; exit 0; fi\n'
    find = 'while [ "$1" != -o ]; do shift; done; OUT=$2\n'
    script.write_text("#!/bin/sh\n" + asked + find + body + "\n")
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))


@pytest.mark.parametrize("unrolled_up_to", [0, 48])
@pytest.mark.parametrize("name", ["ekf", "a-ekf, one", "pi-ekf"])
def test_compiled_steps_agree_with_the_oracle(name, unrolled_up_to):
    kind = kinds(Q)[name]
    native = NativeProgram(Program(filter_parts(kind, unrolled_up_to)))
    assert run(kind, native.part("predict"), native.part("update"), Q, 600, 1, np.inf, 1) < 1e-9
    assert run(kind, native.part("predict"), native.part("update"), Q, 600, 4, 6.0, 2) < 1e-9


def every_operation():
    """A function with every operation that can be emitted, and numbers that try them."""
    x, y = ca.SX.sym("x", 9), ca.SX.sym("y", 9)
    forms = [
        *(f(x) for f in (ca.sin, ca.cos, ca.sqrt, ca.fabs, ca.ceil, ca.floor)),
        *(f(x, y) for f in (ca.atan2, ca.hypot)),
        *(x + y, x - y, x * y, x / y, -x, x**2, 2 * x, 1 / y),
        *(x < y, x <= y, x == y, x != y, ca.logic_not(x), ca.logic_and(x, y), ca.logic_or(x, y)),
        *(ca.fmin(x, 0.5), ca.fmax(x, 0.5), ca.if_else(x > 0, y, x)),
    ]
    f = ca.Function("f", [x, y], [ca.densify(ca.vertcat(*forms))], ["x", "y"], ["z"])
    values = [0.0, -0.0, 1.0, -1.0, 1e-30, 3e5, -7e8, 2.5, -0.4, 1e15, -1e30, np.pi, 0.25]
    rows = [(np.roll(values, 5 * k)[:9], np.roll(values, 3 * k)[:9]) for k in range(13)]
    return f, [(*row, np.array(f(*row)).ravel()) for row in rows]


def test_every_operation_is_the_interpreters():
    f, rows = every_operation()
    native = NativeProgram(Program({"part": (Symbolic(f),)}))
    for x, y, z in rows:
        native.variables["x"][:], native.variables["y"][:] = x, y
        native.part("part")()
        assert np.allclose(native.variables["z"], z, rtol=1e-14, atol=1e-15, equal_nan=True)


WIDTHS = {"own": [], "four": ["-mno-avx512f"], "two": ["-mno-avx"]}
"""Lanes by what keeps this machine's compiler from using more; two are NEON's, too."""


@pytest.mark.parametrize("width", WIDTHS)
def test_every_operation_in_lanes_is_the_interpreters(width, monkeypatch):
    if WIDTHS[width] and platform.machine() != "x86_64":
        pytest.skip("only x86 has vectors of several widths")
    monkeypatch.setenv("CC", " ".join([REAL, *WIDTHS[width]]))
    f, rows = every_operation()
    program, count = Program({OBSERVE: (Symbolic(f),)}), len(rows)
    start = [
        given_values(k, np.array([r[i] for r in rows]), (9,), count) for i, k in enumerate("xy")
    ]
    nothing = dict.fromkeys(("series", "draws", "guarded", "sums", "history"), ())
    job = Job(
        program=program,
        extra={},
        runs=count,
        steps=0,
        first_run=0,
        seed=0,
        start=tuple(start),
        final=("z",),
        stop=None,
        **nothing,
    )
    z = execute(job, "native", 1).final["z"]
    assert np.allclose(z, [r[2] for r in rows], rtol=1e-14, atol=1e-15, equal_nan=True)
    lanes = library.load(source_of(program, False).text).lanes
    assert lanes == {"four": 4, "two": 2}.get(width, lanes)


def test_circular_functions_are_right_to_the_last_digits():
    x = ca.SX.sym("x", 200)
    f = ca.Function("f", [x], [ca.sin(x), ca.cos(x)], ["x"], ["s", "c"])
    native = NativeProgram(Program({"part": (Symbolic(f),)}))
    rng = np.random.default_rng(0)
    for scale in (1e-8, 1.0, 10.0, 1e4, 9e5, 1e7, 1e15):
        native.variables["x"][:] = angles = rng.uniform(-scale, scale, 200)
        native.part("part")()
        assert np.allclose(native.variables["s"], np.sin(angles), rtol=4e-16, atol=2e-16)
        assert np.allclose(native.variables["c"], np.cos(angles), rtol=4e-16, atol=2e-16)


def test_an_unknown_operation_is_refused():
    x = ca.SX.sym("x")
    odd = Program({"part": (Symbolic(ca.Function("f", [x], [ca.erf(x)], ["x"], ["y"])),)})
    with pytest.raises(NotImplementedError, match="operation"):
        source_of(odd, single=True)


def test_code_is_compiled_once_and_kept_for_its_owner_alone(cache, monkeypatch):
    assert answer(toy()) == pytest.approx(2 * np.sin(0.5), abs=1e-15)
    kept = list(cache.glob("*"))
    assert len(kept) == 1
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    library._load.cache_clear()
    monkeypatch.setattr(compiler.Compiler, "compile", None)
    assert answer(toy()) == pytest.approx(2 * np.sin(0.5), abs=1e-15)
    with pytest.raises(TypeError):
        answer(toy(3.0))


@pytest.mark.parametrize("harm", ["cut", "foreign", "empty", "folder"])
def test_a_file_that_is_not_what_it_was_is_never_loaded(cache, harm, tmp_path):
    answer(toy())
    file = next(cache.glob("*.so"))
    good = file.read_bytes()
    file.unlink()
    if harm == "folder":
        file.mkdir()
    else:
        foreign = good.replace(b"homeward_part", b"homeward_trap")
        file.write_bytes({"cut": good[: len(good) // 2], "foreign": foreign, "empty": b""}[harm])
    library._load.cache_clear()
    assert answer(toy()) == pytest.approx(2 * np.sin(0.5), abs=1e-15)


@pytest.mark.parametrize("harm", ["open", "file", "link", "foreign", "read-only"])
def test_a_cache_that_cannot_be_trusted_is_not_used(cache, harm, tmp_path, monkeypatch):
    cache.parent.mkdir()
    if harm == "open":
        cache.mkdir()
        cache.chmod(0o777)
    elif harm == "file":
        cache.write_text("")
    elif harm == "link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        cache.symlink_to(tmp_path / "elsewhere")
    elif harm == "foreign":
        monkeypatch.setattr(os, "getuid", lambda: 12345)
    else:
        cache.mkdir(mode=0o700)
        asked = os.access
        monkeypatch.setattr(os, "access", lambda p, *m: p != cache and asked(p, *m))
    native = NativeProgram(toy())
    assert "not kept" in native.library.notes[0]
    assert "\n" not in native.library.notes[0]
    native.variables["x"][:] = 0.5
    native.part("part")()
    assert native.variables["y"][0] == pytest.approx(2 * np.sin(0.5), abs=1e-15)
    assert not list(tmp_path.rglob("*.so"))


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("echo 'x.c:1: error: no space left' >&2; exit 1", "no space left"),
        ("exit 0", "wrote no file"),
        ("echo garbage > $OUT", "cannot be loaded"),
        ("head -c 300 /bin/sh > $OUT", "cannot be loaded"),
        ("mkdir $OUT", "wrote no file"),
        ("sleep 60 & sleep 60", "took more than"),
        ("kill -9 $$", "failed"),
        (f"echo 'int x;' > $OUT.c; {REAL} -shared -o $OUT $OUT.c", "cannot be loaded"),
    ],
)
def test_a_compiler_that_fails_is_said_to_and_leaves_nothing(
    cache, body, words, tmp_path, monkeypatch
):
    monkeypatch.setattr(compiler, "COMPILE_S", 0.5)
    fake_compiler(tmp_path, monkeypatch, body)
    began = time.monotonic()
    with pytest.raises(NativeError, match=words) as caught:
        answer(toy())
    assert "\n" not in str(caught.value)
    assert time.monotonic() - began < 30
    assert list(cache.glob("*")) == []


@pytest.mark.parametrize("named", ["/nowhere/cc", "/", "'unbalanced", "/etc/passwd"])
def test_a_compiler_that_is_none_is_said_to_be(named, monkeypatch):
    monkeypatch.setenv("CC", named)
    with pytest.raises(NativeError, match="CC="):
        find_compiler()


def test_a_compiler_with_arguments_is_called_with_them(cache, monkeypatch):
    monkeypatch.setenv("CC", f"{REAL} -g0")
    assert answer(toy()) == pytest.approx(2 * np.sin(0.5), abs=1e-15)


def test_a_version_that_hangs_is_not_waited_for(cache, tmp_path, monkeypatch):
    script = tmp_path / "slow-cc"
    script.write_text("#!/bin/sh\nsleep 60\n")
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setattr(compiler, "VERSION_S", 0.3)
    with pytest.raises(NativeError, match="took more than"):
        find_compiler()


def test_where_the_system_has_no_compiler_a_package_may_bring_one(cache, tmp_path, monkeypatch):
    package = tmp_path / "ziglang"
    package.mkdir()
    (package / "__init__.py").touch()
    zig = package / "zig"
    # Its first word is cc; what stands in for it needs the system's assembler.
    zig.write_text(f'#!/bin/sh\nshift\nPATH={os.environ["PATH"]} exec {REAL} "$@"\n')
    zig.chmod(0o755)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert find_compiler().command == (str(zig), "cc")
    assert answer(toy()) == pytest.approx(2 * np.sin(0.5), abs=1e-15)


@pytest.fixture
def zig():
    """Zig's compiler, as the extra `compiler` brings it."""
    if (package := find_spec("ziglang")) is None:
        pytest.skip("no ziglang: pip install the extra compiler")
    return Path(package.origin).with_name("zig")


@pytest.mark.slow
def test_zigs_compiler_needs_nothing_of_the_system(zig, cache, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert find_compiler().command == (str(zig), "cc")
    assert answer(toy()) == pytest.approx(2 * np.sin(0.5), abs=1e-15)


@pytest.mark.slow
def test_a_wheel_may_be_of_another_machine(zig, cache, tmp_path, monkeypatch):
    other = "aarch64" if platform.machine() == "x86_64" else "x86_64"
    (tmp_path / "nothing.c").touch()
    monkeypatch.setenv("CC", f"{zig} cc -target {other}-linux-gnu.2.17")
    assert library.prebuild(tmp_path, tmp_path / "made.so") == other
    with pytest.raises(NativeError):  # nothing that is to run here
        answer(toy())


def test_without_a_compiler_the_interpreter_runs_and_says_so(cache, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compiler, "find_spec", lambda name: None)
    kind = ExtendedKalmanFilter(PolarModel(3))
    asked = filter_kernels(kind, "native")
    assert asked.engine == "interpreter"
    assert len(asked.notes) == 1
    assert "no C compiler found" in asked.notes[0]
    assert filter_kernels(kind, "auto", steps=10**8).notes == asked.notes
    # A short run would not have been compiled anyway.
    assert filter_kernels(kind, "auto", steps=100).notes == ()
    assert run(kind, asked.predict, asked.update, 3, 50, 1, np.inf, 1) < 1e-9


def test_auto_compiles_where_it_pays_and_uses_what_is_there(cache):
    kind = ExtendedKalmanFilter(PolarModel(3))
    assert filter_kernels(kind, "auto", steps=100).engine == "interpreter"
    assert not cache.exists()
    assert filter_kernels(kind, "auto", steps=10**7).engine == "native"
    assert filter_kernels(kind, "auto", steps=1).engine == "native"
    assert filter_kernels(kind, "interpreter", steps=10**7).engine == "interpreter"


def test_the_choice_passes_other_errors_on():
    def broken():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        choose("native", 0.0, broken, broken, "")


def test_processes_that_compile_at_once_agree(cache, tmp_path):
    program = "import test_native as t, sys; sys.stdout.write(repr(t.answer(t.toy(5.0))))"
    here = Path(__file__).parent
    paths = [str(here), str(here.parent), str(here.parent / "filters"), *sys.path]
    given = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    several = [
        subprocess.Popen([sys.executable, "-c", program], env=given, stdout=subprocess.PIPE)
        for _ in range(3)
    ]
    answers = {p.communicate(timeout=100)[0] for p in several}
    assert [float(a) for a in answers] == [pytest.approx(5 * np.sin(0.5), abs=1e-15)]
    assert all(Cache(cache).find(f.stem.split("-")[0]) for f in cache.glob("*.so"))
    assert not list(cache.glob("compiling-*"))


def test_the_cache_folder_follows_the_platform(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", "relative/is/ignored")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_folder() == tmp_path / ".cache" / "homeward"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "x"))
    assert default_folder() == tmp_path / "x" / "homeward"


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
    assert (functions.maker == find_compiler().identity) == damaged
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
