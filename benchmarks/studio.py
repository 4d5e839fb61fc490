"""How often does the studio draw? `python -m benchmarks.studio` counts in Chromium.

Of 40 landmarks six were moved; four estimators (robust and the paper's three) watch at 10 Hz, for
20 s. Prints pictures a second, the slowest of them, and how much of real time the simulation kept
up with. The goal is 60 pictures a second on two cores that nobody else uses.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from homeward.lab.simulation.simulate import load_scenario, scenario_yaml

TESTS = Path(__file__).parents[1] / "tests"
ESTIMATORS = "robust,ekf,a-ekf,pi-ekf"
SETTLES_S = 3.0
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
    """Measure, and print a line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--landmarks", type=int, default=40)
    options = parser.parse_args()
    sys.path[:0] = [str(TESTS), str(TESTS / "studio")]
    from chromium import studio  # the hand that tests drag with, too

    changes = {"landmarks.count": options.landmarks, "moved.count": 6, "rates.bearings": 10.0}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        scene = Path(folder) / "scene.yaml"
        scene.write_text(scenario_yaml(load_scenario("paper-homing", changes)), encoding="utf-8")
        with studio(Path(folder), str(scene), "--estimator", ESTIMATORS) as page:
            time.sleep(SETTLES_S)
            rate, late, worst, kept = page.find(COUNT.replace("SECONDS", str(options.seconds)))
    print(
        f"{options.landmarks} landmarks, {ESTIMATORS}: {rate:.1f} pictures a second, 99 % within "
        f"{late:.0f} ms, the slowest {worst:.0f} ms; {100 * kept:.0f} % of real time"
    )


if __name__ == "__main__":
    main()
