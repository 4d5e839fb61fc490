"""The images of a drive folder."""

import pytest

from homeward.drives.images import read_images
from homeward.errors import InputError


def folder(tmp_path, text):
    drive = tmp_path / "drive"
    (drive / "frames").mkdir(parents=True)
    (drive / "frames" / "1.jpg").write_bytes(b"one")
    (tmp_path / "secret.png").write_bytes(b"not yours")
    (drive / "images.csv").write_text(text)
    return drive


def test_images_are_found_beside_their_table(tmp_path):
    drive = folder(tmp_path, "t,file\n1.5,frames/1.jpg\n2.5,frames/1.jpg\n")
    images = read_images(drive, {})
    assert images.t.tolist() == [1.5, 2.5]
    assert [f.read_bytes() for f in images.files] == [b"one", b"one"]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("t,file\n1,../secret.png\n", "is outside the folder"),
        ("t,file\n1,frames/2.jpg\n", "does not exist"),
        (f"t,file\n1,{'x' * 5000}.jpg\n", "cannot be a file"),
        ("t,file\n1,images.csv\n", r"neither \.jpg nor \.png"),
        ("t,file\n2,frames/1.jpg\n1,frames/1.jpg\n", "runs backwards"),
        ("t,name\n1,frames/1.jpg\n", "file"),
        ("t,file\nnan,frames/1.jpg\n", "t: must be a finite number"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused_in_a_line(tmp_path, text, complaint):
    with pytest.raises(InputError, match=complaint) as caught:
        read_images(folder(tmp_path, text), {})
    assert "\n" not in str(caught.value)


def test_a_link_out_of_the_folder_is_refused(tmp_path):
    drive = folder(tmp_path, "t,file\n1,link.png\n")
    (drive / "link.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(InputError, match="outside"):
        read_images(drive, {})
