"""Access to an NVIDIA GPU through its driver: compilation at run time, memory, launches."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from homeward.errors import HomewardError, needs_extra
from homeward.io.writing import scratch_folder
from homeward.native.cache import Cache, default_folder, key_of

FLOATS = ("--ftz=true", "--prec-div=false", "--prec-sqrt=false")
"""Options for the arithmetic of floats; they do not affect doubles."""


class CudaError(HomewardError):
    """A job cannot run on a GPU; the message is one line."""


def bindings() -> tuple[ModuleType, ModuleType]:
    """Return the Python modules of driver and compiler; `InputError` if not installed."""
    try:
        from cuda.bindings import driver, nvrtc
    except ImportError:
        raise needs_extra("batches on a GPU", "gpu") from None
    return driver, nvrtc


def compiled(text: str, architecture: str) -> bytes:
    """Return the machine code of CUDA C++ for an architecture such as ``sm_90``; needs no GPU.

    Raises `CudaError` when there is no compiler, or it fails.
    """
    _, nvrtc = bindings()
    try:
        version = _checked(nvrtc.nvrtcVersion())
    except RuntimeError as error:
        raise CudaError(f"NVRTC cannot be loaded ({error})") from None
    cache = Cache(default_folder(), ".cubin")
    key = key_of(text, architecture, str(version))
    trusted = cache.problem() is None
    if trusted and (found := cache.find(key)) is not None:
        return found.read_bytes()
    options = [f"--gpu-architecture={architecture}", "--std=c++17", "-w", *FLOATS]
    program = _checked(nvrtc.nvrtcCreateProgram(text.encode(), b"homeward.cu", 0, [], []))
    try:
        (result,) = nvrtc.nvrtcCompileProgram(program, len(options), [o.encode() for o in options])
        if result != nvrtc.nvrtcResult.NVRTC_SUCCESS:
            log = bytearray(_checked(nvrtc.nvrtcGetProgramLogSize(program)))
            _checked(nvrtc.nvrtcGetProgramLog(program, log))
            lines = log.decode(errors="replace").strip("\0\n ").splitlines() or ["no message"]
            raise CudaError(f"NVRTC failed: {lines[0]}")
        code = bytearray(_checked(nvrtc.nvrtcGetCUBINSize(program)))
        _checked(nvrtc.nvrtcGetCUBIN(program, code))
    finally:
        nvrtc.nvrtcDestroyProgram(program)
    if trusted:
        with scratch_folder(cache.folder) as workshop:
            file = workshop / "code.cubin"
            file.write_bytes(code)
            cache.keep(key, file)
    return bytes(code)


def _checked(answer: tuple[Any, ...]) -> Any:
    """Return the result of a call of driver or compiler; `CudaError` when it failed."""
    error, *values = answer
    if int(error) != 0:
        raise CudaError(f"CUDA failed: {error.name}")
    return values[0] if len(values) == 1 else tuple(values)


class CudaKernel(NamedTuple):
    """A function on the GPU, and the number of its blocks that run at once."""

    function: Any
    threads: int
    shared: int
    blocks: int


class Gpu:
    """The first NVIDIA GPU of this machine; `CudaError` when there is none."""

    def __init__(self) -> None:
        self._driver, _ = bindings()
        try:
            _checked(self._driver.cuInit(0))
            device = _checked(self._driver.cuDeviceGet(0))
            self._context = _checked(self._driver.cuDevicePrimaryCtxRetain(device))
        except RuntimeError:
            raise CudaError("there is no NVIDIA driver") from None
        self.use()
        name = _checked(self._driver.cuDeviceGetName(128, device))
        self.name: str = name.split(b"\0")[0].decode()
        attribute = self._driver.CUdevice_attribute
        major, minor, self.processors = (
            int(_checked(self._driver.cuDeviceGetAttribute(a, device)))
            for a in (
                attribute.CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR,
                attribute.CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR,
                attribute.CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT,
            )
        )
        self.architecture = f"sm_{major}{minor}"

    def use(self) -> None:
        """Make it the current device of this thread."""
        _checked(self._driver.cuCtxSetCurrent(self._context))

    def free_bytes(self) -> int:
        """Return its free memory."""
        return int(_checked(self._driver.cuMemGetInfo())[0])

    @contextmanager
    def arrays(self) -> Iterator[Arrays]:
        """Memory that is freed at the end."""
        arrays = Arrays(self._driver)
        try:
            yield arrays
        finally:
            arrays.free()

    def launch(self, kernel: CudaKernel, argument: ctypes.Structure, groups: int) -> float:
        """Run a kernel on one argument, and return its time [s].

        Threads fetch their own work; there is none for more blocks than `groups`.
        """
        driver = self._driver
        pointers = (ctypes.c_void_p * 1)(ctypes.addressof(argument))
        blocks = max(1, min(kernel.blocks, groups))
        begin, end = (_checked(driver.cuEventCreate(0)) for _ in range(2))
        try:
            _checked(driver.cuEventRecord(begin, 0))
            _checked(
                driver.cuLaunchKernel(
                    kernel.function,
                    *(blocks, 1, 1),
                    *(kernel.threads, 1, 1),
                    kernel.shared,
                    0,
                    ctypes.addressof(pointers),
                    0,
                )
            )
            _checked(driver.cuEventRecord(end, 0))
            _checked(driver.cuEventSynchronize(end))
            return float(_checked(driver.cuEventElapsedTime(begin, end))) / 1e3
        finally:
            for event in (begin, end):
                driver.cuEventDestroy(event)


class Arrays:
    """Memory of the GPU that is freed together."""

    def __init__(self, driver: ModuleType) -> None:
        self._driver = driver
        self._pointers: list[int] = []

    def put(self, array: np.ndarray) -> int:
        """Copy an array to the GPU, and return its address."""
        pointer = self._allocate(array)
        if array.nbytes:
            _checked(self._driver.cuMemcpyHtoD(pointer, array.ctypes.data, array.nbytes))
        return pointer

    def blank(self, array: np.ndarray) -> int:
        """Return the address of memory for an array, filled with NaN, or zeros for integers."""
        pointer = self._allocate(array)
        byte = 0xFF if array.dtype.kind == "f" else 0
        _checked(self._driver.cuMemsetD8(pointer, byte, max(array.nbytes, 1)))
        return pointer

    def fetch(self, pointer: int, array: np.ndarray) -> None:
        """Copy from an address on the GPU into an array."""
        if array.nbytes:
            _checked(self._driver.cuMemcpyDtoH(array.ctypes.data, pointer, array.nbytes))

    def free(self) -> None:
        """Free the memory."""
        while self._pointers:
            self._driver.cuMemFree(self._pointers.pop())

    def _allocate(self, array: np.ndarray) -> int:
        self._pointers.append(int(_checked(self._driver.cuMemAlloc(max(array.nbytes, 8)))))
        return self._pointers[-1]


@lru_cache(maxsize=1)
def gpu() -> Gpu:
    """Return the GPU, always the same object; `CudaError` when there is none."""
    return Gpu()


@lru_cache(maxsize=16)
def loaded_kernel(device: Gpu, text: str, threads: int, shared: int) -> CudaKernel:
    """Compile and load ``homeward_batch`` for blocks of `threads` with `shared` bytes of memory."""
    driver, _ = bindings()
    module = _checked(driver.cuModuleLoadData(compiled(text, device.architecture)))
    function = _checked(driver.cuModuleGetFunction(module, b"homeward_batch"))
    attribute = driver.CUfunction_attribute.CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
    _checked(driver.cuFuncSetAttribute(function, attribute, shared))
    each = _checked(driver.cuOccupancyMaxActiveBlocksPerMultiprocessor(function, threads, shared))
    return CudaKernel(function, threads, shared, int(each) * device.processors)
