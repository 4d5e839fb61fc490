"""Write rerun.rbl of the report's templates again: `.venv/bin/python docs/make_blueprint.py`.

`homeward run` writes a copy next to run.mcap; `rerun out/demo/rerun.rbl out/demo/run.mcap` opens
both. Rerun applies a blueprint to recordings of the same application, named after the file: run.
"""

from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

FILE = Path(__file__).parents[1] / "src/homeward/runs/report/templates/rerun.rbl"
SIZES = {"home": 1.5, "path": 1.2, "true_path": 0.5, "rays": 1.2, "landmarks": 5.0, "robot": 1.5}
"""Radii of the points of each cloud [screen points]; their sign marks them for Rerun."""
# Rerun takes the positions of a PointCloud2 by itself and keeps each other field as a component.
COLOURS = VisualizerComponentMapping(
    "Points3D:colors",
    ComponentSourceKind.SourceComponent,
    source_component="Points3D:color",
)


def blueprint() -> rrb.Blueprint:
    """Return how Rerun first shows a run: the map or the camera, the status, and series."""
    clouds = {
        f"/homeward/{topic}": [
            rr.Points3D.from_fields(radii=[-size]).visualizer(mappings=[COLOURS])
        ]
        for topic, size in SIZES.items()
    }
    scene = rrb.Spatial3DView(
        name="Map",
        contents=list(clouds),
        overrides=clouds,
        spatial_information=rrb.SpatialInformation(target_frame="map"),
    )
    camera = rrb.Spatial2DView(name="Camera", origin="/camera/image/compressed")
    series = [
        rrb.TimeSeriesView(name=name, origin=f"/homeward/{topic}")
        for topic, name in {
            "sigma": "Standard deviation: x [m], y [m], heading [rad]",
            "error": "Error: x [m], y [m], heading [rad]",
            "moved_probability": "Probability of having moved",
        }.items()
    ]
    status = rrb.TextLogView(name="Status", origin="/homeward/status")
    left = rrb.Vertical(rrb.Tabs(scene, camera), status, row_shares=[4, 1])
    return rrb.Blueprint(
        rrb.Horizontal(left, rrb.Vertical(*series), column_shares=[3, 2]),
        rrb.TimePanel(timeline="message_log_time", state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


if __name__ == "__main__":
    blueprint().save("run", str(FILE))
