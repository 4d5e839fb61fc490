"""Many runs at once against the interpreter, and against themselves in other company."""

import numpy as np
import pytest
from lab.model_by_hand import scene

from homeward.control.laws import homing
from homeward.geometry.frames import from_polar
from homeward.lab.engine.batch import execution as noise
from homeward.lab.engine.batch.execution import run_recorded
from homeward.lab.engine.batch.homing import run_homing
from homeward.lab.engine.native.compiler import NativeError, find_compiler
from homeward.lab.filters.ekf import ExtendedKalmanFilter, ProportionalIntegralFilter, augmented_ekf
from homeward.lab.model import PolarModel

try:
    find_compiler()
except NativeError as error:
    pytest.skip(f"native engine: {error}", allow_module_level=True)

RUNS = 11
KINDS = {
    "ekf": ExtendedKalmanFilter(PolarModel(3)),
    "a-ekf": augmented_ekf(3, [0, 2]),
    "pi-ekf": ProportionalIntegralFilter(PolarModel(3)),
}


def loop(kind, runs=RUNS, first=0):
    """Closed loops over layouts and first guesses of their own, two landmarks moved."""
    q, n = kind.model.q, kind.model.n
    scenes = [scene(q, 100 + first + i) for i in range(runs)]
    polar = np.array(scenes[0][1])
    stored = np.array([s[3] for s in scenes])
    stored[:, :2] += 0.3
    guess = polar + np.random.default_rng(1).normal(size=(64, 3))[first : first + runs] * 0.05
    state = np.zeros((runs, n))
    state[:, :3] = guess
    state[:, 3 + q :] = stored[:, list(kind.model.estimated)]
    size = n if kind.integral else 0
    given = {
        "pose": from_polar(scenes[0][1]),
        "landmarks": np.array([s[0] for s in scenes]),
        "stored": stored,
        "state": state,
        "covariance": np.diag(np.r_[np.full(3, 0.1**2), np.ones(q), np.full(n - 3 - q, 0.2**2)]),
        "speed": 0.125,
        "dt": 0.05,
        "input_covariance": np.diag([0.01**2, 0.02**2]),
        "state_variance": np.full(n, 1e-6),
        "variance": 0.02**2,
        "minimum_visible": 2,
        "stop_radius": 0.05,
        "bearing_sigma": 0.02,
        "disturbance_sigma": [0.01, 0.02],
        "visibility": 0.7,
    }
    if size:
        given |= {"proportional": 1e-3 * np.eye(n), "integral_gain": np.full((n, q), 0.01)}
    return given


@pytest.mark.parametrize("name", KINDS)
def test_closed_loops_agree_with_the_interpreter(name):
    kind = KINDS[name]
    asked = {"runs": RUNS, "steps": 60, "seed": 3, "history": ("state", "covariance", "control")}
    native = run_homing(kind, loop(kind), **asked, engine="native")
    slow = run_homing(kind, loop(kind), **asked, engine="interpreter")
    assert (native.engine, slow.engine) == ("native", "interpreter")
    for field in ("samples", "reached", "diverged"):
        assert np.array_equal(getattr(native, field), getattr(slow, field))
    for field in ("rmse", "nees", "pose", "state"):
        assert np.allclose(getattr(native, field), getattr(slow, field), rtol=1e-9, atol=1e-9)
    for key, values in native.history.items():
        assert np.allclose(values, slow.history[key], rtol=1e-9, atol=1e-9, equal_nan=True)
    assert native.history["covariance"].shape == (RUNS, 61, kind.model.n, kind.model.n)


def test_a_run_is_the_same_in_any_company():
    kind = KINDS["ekf"]
    asked = {"steps": 300, "seed": 8, "history": ("state", "pose")}
    whole = run_homing(kind, loop(kind), runs=RUNS, threads=1, engine="native", **asked)
    part = run_homing(kind, loop(kind, 6, 5), runs=6, first_run=5, threads=2, **asked)
    assert part.engine == "native"
    assert len(set(whole.samples.tolist())) > 1
    for field in ("samples", "reached", "rmse", "nees", "pose", "state"):
        assert np.array_equal(getattr(whole, field)[5:], getattr(part, field))
    for key, values in part.history.items():
        assert np.array_equal(whole.history[key][5:], values, equal_nan=True)


def test_another_seed_and_another_run_are_other_noise():
    kind = KINDS["ekf"]
    given = loop(kind, 1)
    results = [
        run_homing(kind, given, runs=2, steps=20, seed=s, first_run=f, engine="native").state
        for s, f in ((0, 0), (1, 0), (0, 2), (2**40, 0), (0, 2**40))
    ]
    states = np.concatenate(results)
    assert len(np.unique(states[:, 0])) == len(states)


def test_a_filter_over_recorded_runs_agrees_with_the_interpreter():
    kind, steps = KINDS["pi-ekf"], 40
    given = loop(kind)
    world = ("pose", "landmarks", "speed", "stop_radius", "bearing_sigma", "disturbance_sigma")
    given = {k: v for k, v in given.items() if k not in (*world, "visibility")}
    rng = np.random.default_rng(2)
    series = {
        "control": np.tile([0.125, 0.4], (steps, 1)),
        "bearings": rng.uniform(-3, 3, (RUNS, steps, 3)),
        "mask": (rng.random((RUNS, steps, 3)) < 0.6).astype(float),
    }
    asked = {"runs": RUNS, "steps": steps, "history": ("state", "accepted")}
    native = run_recorded(kind, {**given, "gate": 9.0}, series, **asked, engine="native")
    slow = run_recorded(kind, {**given, "gate": 9.0}, series, **asked, engine="interpreter")
    assert np.allclose(native.history["state"], slow.history["state"], rtol=1e-9, atol=1e-9)
    assert np.array_equal(native.history["accepted"], slow.history["accepted"])
    assert 0 < native.history["accepted"].mean() < 0.6
    assert np.allclose(native.final["covariance"], slow.final["covariance"], rtol=1e-9, atol=1e-9)
    alone = run_recorded(
        kind,
        {k: v[3] if k in ("stored", "state") else v for k, v in given.items()} | {"gate": 9.0},
        {k: v[3] if v.ndim == 3 else v for k, v in series.items()},
        **asked | {"runs": 1},
        engine="native",
    )
    assert np.allclose(alone.final["state"][0], native.final["state"][3], rtol=1e-9, atol=1e-9)


def test_nan_is_a_bearing_that_was_not_seen():
    kind, steps = KINDS["ekf"], 12
    given = {k: loop(kind)[k] for k in ("state", "covariance", "stored", "dt", "variance")}
    control = np.tile([0.125, 0.4], (steps, 1))
    bearings = np.random.default_rng(0).uniform(-3, 3, (RUNS, steps, 3))
    seen = bearings > 0
    asked = {"runs": RUNS, "steps": steps}
    given |= {"gate": np.inf, "input_covariance": 1e-4 * np.eye(2)}
    missing = {"control": control, "bearings": np.where(seen, bearings, np.nan)}
    masked = {"control": control, "bearings": bearings, "mask": seen.astype(float)}
    a = run_recorded(kind, given, missing, **asked, engine="native")
    b = run_recorded(kind, given, masked, **asked, engine="native")
    assert np.array_equal(a.final["state"], b.final["state"])
    assert np.isfinite(a.final["state"]).all()
    assert not a.diverged.any()


@pytest.mark.parametrize(
    "change", [{"runs": 0}, {"steps": -1}, {"seed": -1}, {"seed": 2**64}, {"first_run": -1}]
)
def test_numbers_that_make_no_batch_are_refused(change):
    kind = KINDS["ekf"]
    with pytest.raises(ValueError, match=r"at least 1|must be in"):
        run_homing(kind, loop(kind, 1), **({"runs": 1, "steps": 1} | change))


def test_a_run_that_diverges_ends_alone():
    kind = KINDS["ekf"]
    given = loop(kind)
    given["state"][4, 0] = 1e12
    result = run_homing(kind, given, runs=RUNS, steps=20, engine="native")
    assert np.flatnonzero(result.diverged).tolist() == [4]
    assert result.samples[4] == 0
    assert np.isinf(result.rmse[4]).all()
    assert np.isfinite(np.delete(result.rmse, 4, 0)).all()


def test_values_in_place_of_draws_are_used():
    kind, steps = KINDS["ekf"], 10
    given, none = loop(kind), {"disturbance_sigma": 0.0, "bearing_sigma": 0.0}
    silent = run_homing(kind, {**given, **none, "visibility": 1.0}, runs=RUNS, steps=steps)
    series = {"noise": np.zeros((steps, 3)), "mask": np.ones((steps, 3)), "disturbance": [[0, 0]]}
    replaced = run_homing(kind, given, runs=RUNS, steps=steps, series=series)
    assert np.allclose(silent.state, replaced.state, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [({"stard": 1.0}, "stard"), ({"stored": np.zeros(5)}, "stored"), ({"pose": "x"}, "x")],
)
def test_what_does_not_fit_is_named(change, words):
    kind = KINDS["ekf"]
    with pytest.raises(ValueError, match=words):
        run_homing(kind, {**loop(kind), **change}, runs=RUNS, steps=2)


def test_noise_is_philox():
    # The known answers of the authors' own test vectors.
    for bits, seed, answer in (
        (0, 0, "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
        (2**32 - 1, 2**64 - 1, "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ):
        words = noise.philox(np.full((4, 1), bits, np.uint64), seed)
        assert " ".join(f"{int(w):08x}" for w in words[:, 0]) == answer


def test_noise_is_normal_and_uniform():
    z = np.concatenate([noise.normals(4, run, 0, 0, 1000) for run in range(100)])
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert abs(z.var() - 1) < 4 * np.sqrt(2 / z.size)
    assert abs((np.abs(z) < 1.959964).mean() - 0.95) < 0.003
    u = np.concatenate([noise.uniforms(4, 0, step, 1, 1000) for step in range(100)])
    assert abs(u.mean() - 0.5) < 4 / np.sqrt(12 * u.size)
    assert (u >= 0).all()
    assert (u < 1).all()


def test_the_law_can_be_another():
    def straight(polar, speed):
        return homing(polar, speed)._replace(omega=0 * polar.R)

    kind = KINDS["ekf"]
    result = run_homing(kind, loop(kind), runs=RUNS, steps=5, law=straight, history=("control",))
    assert np.array_equal(result.history["control"][:, 1:, 1], np.zeros((RUNS, 5)))
