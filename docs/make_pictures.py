"""Make the pictures of README and docs again: `.venv/bin/python docs/make_pictures.py [NAME ...]`.

Pages are drawn by Chromium, which must be on the PATH; the recording by Rerun's viewer without a
window, which needs a Vulkan driver. Where the machine has none, Chromium's will do:
`LD_LIBRARY_PATH=/usr/lib/chromium VK_ICD_FILENAMES=/usr/lib/chromium/vk_swiftshader_icd.json`.
"""

import shutil
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo
from rerun.experimental import ViewerClient

from homeward.lab.observability.study import observe
from homeward.lab.planning.analysis import analyse
from homeward.lab.planning.settings import load_plan
from homeward.lab.report.observe import draw_family
from homeward.lab.report.plan import draw_begin
from homeward.lab.simulation.render.drive import Eye
from homeward.lab.simulation.render.room.settings import load_room
from homeward.runs.report.canvas import png
from homeward.runs.report.folder import write_run
from homeward.runs.single_run import SAMPLE, RunSettings, finish, prepare
from homeward.vision.opencv import opencv

IMAGES = Path(__file__).parent / "images"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
RERUN = Path(sys.executable).with_name("rerun")
PAGE_SIZE, PAGE_MOMENT_S = (1280, 720), 87.0
VIEWER_SIZE, VIEWER_MOMENT_S = (1000, 640), 139.0
PORT, SETTLE_S = 9896, 10.0
PANORAMA = {"camera.width": 1024, "camera.height": 256}
FISHEYE = {"camera.projection": "fisheye", "camera.width": 1280, "camera.height": 640}
FISHEYE |= {"camera.field_of_view": 3.2, "tags.size": 0.2, "tags.walls": 24}
"""Settings of docs/do/rooms.md and docs/do/cameras.md."""


def main() -> None:
    """Draw the pictures with these names, or all; the report of the sample has its summary."""
    pictures = {
        "observe-two.png": lambda file: file.write_bytes(png(draw_family(observe(2)), dpi=90)),
        "plan-warehouse.png": _picture_plan,
        "rendered-room.jpg": partial(_picture_room, PANORAMA),
        "rendered-fisheye.jpg": partial(_picture_room, FISHEYE),
        "studio.png": _picture_studio,
        "sample-report.png": _picture_report,
        "sample-recording.png": _picture_recording,
    }
    if CHROMIUM is None:
        sys.exit("no chromium on the PATH")
    for name in sys.argv[1:] or pictures:
        pictures[name](IMAGES / name)


def _picture_plan(file: Path) -> None:
    """Draw where homing can begin in the warehouse."""
    file.write_bytes(png(draw_begin(analyse(load_plan("warehouse"))), dpi=90))


def _run_sample(folder: Path) -> str:
    """Write a run of the sample drive; return its summary."""
    drive, estimator, settings = prepare(RunSettings(drive=SAMPLE))
    track = finish(drive, estimator, settings)
    return write_run(folder, drive, track, settings.model_dump(mode="json"))


def _picture_report(file: Path) -> None:
    """Draw the top of the report of the sample; a test compares its summary with the README."""
    with tempfile.TemporaryDirectory() as scratch:
        summary = _run_sample(Path(scratch) / "run")
        _picture_page(Path(scratch) / "run" / "report.html", file)
    words = PngInfo()
    words.add_itxt("summary", summary)
    with Image.open(file) as picture:
        picture.save(file, pnginfo=words, optimize=True)


def _picture_room(changes: dict[str, object], file: Path) -> None:
    """Render what the camera of a living room's robot sees at home."""
    eye = Eye(load_room("living-room", changes=changes))
    cv2 = opencv()
    cv2.imwrite(str(file), eye.home_picture(), [cv2.IMWRITE_JPEG_QUALITY, 80])


def _picture_studio(file: Path) -> None:
    """Draw the studio, a while after a landmark was moved; as its tests do, with a real pointer."""
    sys.path.append(str(IMAGES.parents[1] / "tests"))
    from studio.chromium import studio

    width, height = PAGE_SIZE
    words = ("warehouse", "--estimator", "robust,ekf,a-ekf")
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch,
        studio(Path(scratch), *words, width=width, height=height) as page,
    ):
        page.until("studio.frame.t > 12")
        page.drag("landmark L06", 60, -40)
        page.until("studio.frame.rivals.robust.moved.L06 > 0.9")
        page.until("studio.frame.t > 45")
        page.picture(file)


def _picture_page(page: Path, file: Path) -> None:
    """Draw the top of a page, at a moment of its drive."""
    subprocess.run(
        [
            str(CHROMIUM),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--virtual-time-budget=8000",
            f"--window-size={PAGE_SIZE[0]},{PAGE_SIZE[1]}",
            f"--screenshot={file}",
            f"{page.as_uri()}#t={PAGE_MOMENT_S}",
        ],
        check=True,
        capture_output=True,
    )


def _picture_recording(file: Path) -> None:
    """Draw the run of the sample in Rerun's viewer, at a moment of its drive."""
    with tempfile.TemporaryDirectory() as scratch:
        _run_sample(Path(scratch) / "run")
        _picture_viewer(Path(scratch) / "run", file)


def _picture_viewer(run: Path, file: Path) -> None:
    size = f"{VIEWER_SIZE[0]}x{VIEWER_SIZE[1]}"
    words = [str(RERUN), "--headless", "--port", str(PORT), "--window-size", size]
    words += [str(run / "rerun.rbl"), str(run / "run.mcap")]
    with subprocess.Popen(words, stderr=subprocess.DEVNULL) as viewer:
        try:
            time.sleep(SETTLE_S)
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{PORT}/proxy")
            # A software renderer is slow with its first frame.
            time.sleep(SETTLE_S)
            client.set_time("message_log_time", timestamp=VIEWER_MOMENT_S, play_state="paused")
            time.sleep(SETTLE_S)
            file.write_bytes(client.take_screenshot())
        finally:
            viewer.terminate()


if __name__ == "__main__":
    main()
