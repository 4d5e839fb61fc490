"""Made-up results of a study, for tests of its figures and files."""

import numpy as np
import yaml

from homeward.lab.studies.study.plan import load_study, make_plan
from homeward.lab.studies.study.results import Results
from homeward.lab.studies.study.runs import RUN, SERIES


def made_up_study(folder, decades=1.0, label="A-EKF", **changes):
    """Return made-up results, spread over `decades`."""
    study = {
        "name": "made up",
        "runs": 12,
        "loop": "closed",
        "scenario": "paper-homing",
        "grid": {"moved.count": [0, 1, 2]},
        "estimators": [
            "robust",
            "ekf",
            {"estimator": "a-ekf", "label": label, "grid": {"parameter_sigma": [0.1, 0.3]}},
        ],
    }
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump({**study, **changes}))
    plan = make_plan(load_study(str(path)))
    rng = np.random.default_rng(2)
    size = (len(plan.cases), len(plan.contenders), plan.study.runs)

    def spread(*shape):
        return 0.1 * 10.0 ** rng.uniform(0.0, decades, shape)

    run = {name: spread(*size) for name in RUN}
    run["reached_home"] = rng.integers(0, 2, size).astype(float)
    series = {name: spread(*size, len(plan.times)) for name in SERIES}
    return Results(plan, run, series, np.full(size, "", dtype="<U20"))
