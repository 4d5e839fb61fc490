"""What a camera recorded, of any kind, made into a drive."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from homeward.drives.drive import Drive
from homeward.drives.ros.containers.magic import is_log
from homeward.drives.ros.reading import read_log
from homeward.drives.text.files import is_there
from homeward.errors import InputError
from homeward.vision.recorded.folder import IMAGE_SETTINGS, see_folder
from homeward.vision.recorded.frames import VIDEOS
from homeward.vision.recorded.settings import read_image_settings
from homeward.vision.recorded.tags import see_tags
from homeward.vision.tags.messages import tag_eye


def see_recording(
    path: Path,
    tell: Callable[[float], None] | None = None,
    ready: Callable[[], None] | None = None,
    *,
    tags: str | None = None,
    topics: Path | None = None,
    force: bool = False,
) -> Drive:
    """Return the drive of a folder of images, a video, or a log with pictures in it.

    Parameters
    ----------
    path : Path
        Videos and logs need tags.
    tell, ready, force
        As in `see_folder`.
    tags : str, optional
        Family of the tags that are looked for, instead of what panoramas show; None: as
        images.yaml says.
    topics : Path, optional
        Of a log, as in `read_log`.

    Raises
    ------
    InputError
        When it is none of these, or as `see_folder` and `see_tags` say.
    """
    video = path.suffix.lower() in VIDEOS
    if not video and is_log(path):
        if tags is None:
            raise InputError("of pictures in a log only tags are read: --tags 36h11", path)
        if ready is not None:
            ready()
        # The camera comes from CameraInfo or topics, as for tags that a log has already.
        return read_log(path, topics, tell, tag_eye(tags))
    if topics is not None:
        raise InputError("there are no topics to choose in images", path)
    told = (path.parent if video else path) / IMAGE_SETTINGS
    if video or tags or (is_there(told) and read_image_settings(told).tags):
        if ready is not None:
            ready()
        return see_tags(path, tags, tell)
    return see_folder(path, tell, ready, force)
