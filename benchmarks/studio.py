"""Frame rate of the studio: `python -m benchmarks.studio [--seconds 20]` measures it in Chromium.

40 landmarks, six of which were moved, and four estimators (robust and the paper's three) at 10 Hz.
Prints frames per second, the slowest frame, and the speed of the simulation relative to real time.
The goal is 60 frames per second on two idle cores.
"""

import sys
import tempfile
import time
from pathlib import Path

from benchmarks import monte_carlo
from homeward.lab.simulation.simulate import load_scenario, scenario_yaml

TESTS = Path(__file__).parents[1] / "tests"
ESTIMATORS = "robust,ekf,a-ekf,pi-ekf"
SETTLES_S, LANDMARKS = 3.0, 40
COUNT = """
new Promise((done) => {
  const times = [], begun = studio.frame.t, began = performance.now();
  const next = (now) => {
    times.push(now);
    if (now - times[0] < SECONDS * 1000) return requestAnimationFrame(next);
    const steps = times.slice(1).map((t, k) => t - times[k]).sort((a, b) => a - b);
    done([1000 * steps.length / (times.at(-1) - times[0]), steps[Math.floor(0.99 * steps.length)],
      steps.at(-1), (studio.frame.t - begun) * 1000 / (performance.now() - began)]);
  };
  requestAnimationFrame(next);
})
"""


def main() -> None:
    options = monte_carlo.parsed(__doc__, seconds=20.0)
    sys.path[:0] = [str(TESTS), str(TESTS / "studio")]
    from chromium import studio  # the browser of the tests

    changes = {"landmarks.count": LANDMARKS, "moved.count": 6, "rates.bearings": 10.0}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        scene = Path(folder) / "scene.yaml"
        scene.write_text(scenario_yaml(load_scenario("paper-homing", changes)), encoding="utf-8")
        with studio(Path(folder), str(scene), "--estimator", ESTIMATORS) as page:
            time.sleep(SETTLES_S)
            rate, late, worst, kept = page.find(COUNT.replace("SECONDS", str(options.seconds)))
    print(
        f"{LANDMARKS} landmarks, {ESTIMATORS}: {rate:.1f} frames per second, 99 % within "
        f"{late:.0f} ms, slowest {worst:.0f} ms; {100 * kept:.0f} % of real time"
    )


if __name__ == "__main__":
    main()
