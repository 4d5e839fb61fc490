"""Refusal of files that are no text tables, by their first bytes."""

from __future__ import annotations

from pathlib import Path

from homeward.errors import InputError

EXPORT, UNPACK = "export it as CSV", "unpack it"
FORMATS = (
    ((b"PK\x03\x04",), "a spreadsheet or zip archive", "export it as CSV, or unpack it"),
    ((b"\xd0\xcf\x11\xe0",), "a spreadsheet", EXPORT),
    ((b"\x1f\x8b", b"\x28\xb5\x2f\xfd", b"BZh", b"\xfd7zXZ"), "a compressed file", UNPACK),
    ((b"\x93NUMPY",), "a numpy array", "write it as CSV with numpy.savetxt"),
    (tuple(bytes([0x80, n]) for n in range(2, 6)), "a Python pickle", EXPORT),
    ((b"\x89HDF", b"MATLAB"), "a MATLAB or HDF5 file", "export it as CSV, as with writetable"),
    ((b"PAR1", b"ARROW1"), "a Parquet or Arrow file", EXPORT),
    ((b"\x89PNG", b"\xff\xd8\xff"), "an image", "use `homeward see` on a folder of images"),
    ((b"%PDF",), "a PDF", "give the table that it shows as CSV"),
    ((b"versionhttps://git-lfs",), "a pointer of Git LFS", "fetch the file with `git lfs pull`"),
    ((b"<!DOCTYPE", b"<html", b"<?xml"), "a web page or XML", "download the file itself as CSV"),
    (
        (b'{"tags":[{"ID"', b'{"field":{'),
        "a field layout of WPILib",
        "copy it to landmarks.yaml in the drive folder",
    ),
    (
        (b"header:stamp:", b"---header:stamp:"),
        "the output of `ros2 topic echo`",
        "use `ros2 topic echo --csv`, or record a bag",
    ),
    ((b'{"', b"[{", b"[["), "JSON", EXPORT),
)
"""First bytes, also without white space; description and advice."""


def refuse_other_formats(begin: bytes, path: Path) -> None:
    """Raise `InputError` with advice where a file that begins so has a format of no text table."""
    plain = b"".join(begin[:64].split())
    for starts, what, advice in FORMATS:
        if begin.startswith(starts) or plain.startswith(starts):
            raise InputError(f"{what}, not a text table; {advice}", path)
    if b"\0" in begin:
        raise InputError("a binary file, not a text table; export its data as a CSV file", path)
