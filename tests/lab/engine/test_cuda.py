"""The GPU's kernel: compiled without a GPU, compared as C++ with the processor's, run on a GPU."""

import ctypes
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_batch import KINDS, RUNS, loop

from homeward.errors import HomewardError
from homeward.lab.engine.batch import execution, homing
from homeward.lab.engine.batch.execution import run_recorded
from homeward.lab.engine.batch.homing import run_homing
from homeward.lab.engine.batch.job import Job, Result, empty_result, shaped
from homeward.lab.engine.cuda.device import CudaError, bindings, compiled, gpu
from homeward.lab.engine.cuda.execution import argument_of, outputs_of
from homeward.lab.engine.cuda.source import cuda_source
from homeward.lab.filters.ekf import ExtendedKalmanFilter, augmented_ekf
from homeward.lab.model import PolarModel

HERE = Path(__file__).parent


def has_gpu() -> bool:
    try:
        return bool(gpu().name)
    except HomewardError:
        return False


def has_nvrtc() -> bool:
    try:
        return bindings() is not None
    except HomewardError:
        return False


needs_gpu = pytest.mark.skipif(not has_gpu(), reason="no NVIDIA GPU")
needs_nvrtc = pytest.mark.skipif(not has_nvrtc(), reason="NVRTC is not installed")
needs_cpp = pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")


def job_of(monkeypatch, call) -> Job:
    """Return the job that a call would execute."""

    class Caught(Exception):
        pass

    def catch(job, *_):
        raise Caught(job)

    with monkeypatch.context() as patch:
        patch.setattr(homing, "execute", catch)
        patch.setattr(execution, "execute", catch)
        with pytest.raises(Caught) as caught:
            call()
    return caught.value.args[0]


def homing_job(monkeypatch, kind, **how) -> Job:
    how = {"runs": RUNS, "steps": 60, "seed": 3} | how
    return job_of(monkeypatch, lambda: run_homing(kind, how.pop("given", loop(kind)), **how))


def as_cpp(job: Job, folder: Path, single=False, group=None) -> Result:
    """Run a job by its kernel's own source as C++."""
    code = cuda_source(job, single, group)
    text = [f'#include "{HERE / "cuda_as_cpp.h"}"', code.text]
    text.append(f'#include "{HERE / "cuda_as_cpp_main.h"}"')
    source, library = folder / "kernel.cpp", folder / f"kernel{len(list(folder.iterdir()))}.so"
    source.write_text("\n".join(text))
    flags = ["-std=c++20", "-O1", "-w", "-shared", "-fPIC", "-pthread"]
    subprocess.run(["g++", *flags, "-o", library, source], check=True)
    result = empty_result(job)
    arrays = outputs_of(result) | {
        "doubtful": np.zeros(job.runs, np.uint8),
        "next": np.zeros(1, np.int64),
        "only": np.zeros(1, np.int64),
    }
    arrays |= {f"given_{g.name}": g.values for g in job.start}
    arrays |= {f"series_{g.name}": g.values for g in job.series}
    places = {name: array.ctypes.data for name, array in arrays.items()}
    argument = argument_of(job, code, places | {"runs": job.runs, "selected": 0})
    ctypes.CDLL(str(library)).run_block(ctypes.byref(argument))
    result.again = int(arrays["doubtful"].sum())
    return shaped(job, result)


def assert_same(ours: Result, theirs: Result, tolerance: float) -> None:
    for name in ("samples", "stopped", "diverged"):
        assert np.array_equal(getattr(ours, name), getattr(theirs, name)), name
    for what in ("sums", "final", "history"):
        for name, array in getattr(theirs, what).items():
            found = getattr(ours, what)[name]
            assert np.allclose(found, array, rtol=tolerance, atol=tolerance, equal_nan=True), name


CASES = KINDS | {
    "euler": ExtendedKalmanFilter(PolarModel(4), "euler"),
    "a-ekf, one of 5": augmented_ekf(5, [3]),
}


@needs_cpp
@pytest.mark.parametrize(
    ("name", "group"), [*((name, 4) for name in CASES), ("ekf", 1), ("a-ekf, one of 5", 1)]
)
def test_the_kernel_does_what_the_processor_does(name, group, monkeypatch, tmp_path):
    history = ("state", "covariance", "pose", "control", "error", "nees", "bearings", "active")
    job = homing_job(monkeypatch, CASES[name], history=history)
    theirs = execution.execute(job, "native")
    assert_same(as_cpp(job, tmp_path, group=group), theirs, 1e-9)


@needs_cpp
def test_more_landmarks_than_bits_in_a_word(monkeypatch, tmp_path):
    kind = ExtendedKalmanFilter(PolarModel(35))
    job = homing_job(monkeypatch, kind, runs=2, steps=4, given=loop(kind, 2))
    assert_same(as_cpp(job, tmp_path, group=8), execution.execute(job, "interpreter"), 1e-9)
    kind = ExtendedKalmanFilter(PolarModel(65))
    job = homing_job(monkeypatch, kind, runs=1, given=loop(kind, 1))
    with pytest.raises(CudaError, match="64 landmarks"):
        cuda_source(job, single=False)


def diverging(monkeypatch) -> Job:
    """Return a job whose runs diverge blindly after some samples, the fifth at once."""
    given = loop(KINDS["ekf"]) | {"visibility": 0.0, "state_variance": np.eye(6)[2] * 2e8}
    given["state"][4, 0] = 1e12
    return homing_job(monkeypatch, KINDS["ekf"], given=given, history=("pose",))


@needs_cpp
def test_a_run_that_diverges_keeps_its_last_good_sample(monkeypatch, tmp_path):
    job = diverging(monkeypatch)
    theirs = execution.execute(job, "native")
    assert theirs.samples[4] == 0
    assert 1 < theirs.samples[theirs.diverged].max() < 20
    ours = as_cpp(job, tmp_path)
    assert_same(ours, theirs, 1e-9)
    assert ours.again >= theirs.diverged.sum()


@needs_cpp
def test_given_noise_and_recorded_runs(monkeypatch, tmp_path):
    kind = KINDS["ekf"]
    rng = np.random.default_rng(5)
    series = {"noise": 0.02 * rng.normal(size=(RUNS, 30, 3)), "mask": rng.random((30, 3)) < 0.6}
    job = homing_job(monkeypatch, kind, steps=30, series=series)
    assert_same(as_cpp(job, tmp_path), execution.execute(job, "native"), 1e-9)
    given = {k: v for k, v in loop(kind).items() if k in kind_variables(kind)}
    seen = {"control": rng.normal(size=(RUNS, 20, 2)) * 0.1, "bearings": rng.normal(size=(20, 3))}
    job = job_of(
        monkeypatch, lambda: run_recorded(kind, given | {"gate": np.inf}, seen, runs=RUNS, steps=20)
    )
    assert_same(as_cpp(job, tmp_path), execution.execute(job, "native"), 1e-9)


def kind_variables(kind):
    return execution.filter_program(kind).shapes


@needs_cpp
def test_floats_stay_near_doubles(monkeypatch, tmp_path):
    job = homing_job(monkeypatch, KINDS["ekf"], steps=20)
    ours, theirs = as_cpp(job, tmp_path, single=True), execution.execute(job, "native")
    assert np.array_equal(ours.samples, theirs.samples)
    assert np.allclose(ours.final["state"], theirs.final["state"], atol=2e-4)
    assert not np.array_equal(ours.final["state"], theirs.final["state"])


@needs_nvrtc
@pytest.mark.parametrize("single", [False, True])
def test_the_kernel_compiles_without_a_gpu(single, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for kind in (KINDS["pi-ekf"], augmented_ekf(12)):
        job = homing_job(monkeypatch, kind, given=loop(kind), history=("covariance",))
        code = compiled(cuda_source(job, single).text, "sm_90")
        assert code.startswith(b"\x7fELF")
        assert compiled(cuda_source(job, single).text, "sm_90") == code
    assert len(list(tmp_path.glob("homeward/*.cubin"))) == 2
    with pytest.raises(CudaError, match="NVRTC failed: homeward"):
        compiled("nonsense", "sm_90")


def test_what_the_gpu_cannot_do_is_said(monkeypatch):
    job = homing_job(monkeypatch, KINDS["ekf"], history=("innovation",))
    with pytest.raises(CudaError, match="cannot return innovation"):
        cuda_source(job, single=False)
    plain = replace(job.program, separable=None)
    with pytest.raises(CudaError, match="the paper's filters"):
        cuda_source(replace(job, program=plain), single=False)


@pytest.mark.skipif(has_gpu(), reason="there is a GPU")
def test_without_a_gpu_the_reason_is_one_line():
    with pytest.raises(HomewardError) as caught:
        run_homing(KINDS["ekf"], loop(KINDS["ekf"]), runs=RUNS, steps=2, engine="cuda")
    assert "\n" not in str(caught.value)


@needs_gpu
@pytest.mark.parametrize("name", CASES)
def test_the_gpu_does_what_the_processor_does(name, monkeypatch):
    job = homing_job(monkeypatch, CASES[name], history=("state", "covariance", "error"))
    ours = execution.execute(job, "cuda")
    assert ours.engine == "cuda"
    assert_same(ours, execution.execute(job, "native"), 1e-9)


@needs_gpu
def test_chunks_and_companions_change_nothing_on_the_gpu(monkeypatch):
    from homeward.lab.engine.cuda import execution as cuda

    kind = KINDS["ekf"]
    job = homing_job(monkeypatch, kind, runs=40, given=loop(kind, 40), history=("pose",))
    whole = execution.execute(job, "cuda", precision="single")
    monkeypatch.setattr(cuda, "SHARE", 1e-7)
    assert_same(execution.execute(job, "cuda", precision="single"), whole, 0.0)


@needs_gpu
def test_runs_that_floats_spoil_are_computed_again(monkeypatch):
    job = diverging(monkeypatch)
    found = execution.execute(job, "cuda", precision="single")
    assert found.again == found.diverged.sum() > 0
    theirs = execution.execute(job, "cuda")
    assert np.array_equal(found.samples[found.diverged], theirs.samples[theirs.diverged])
