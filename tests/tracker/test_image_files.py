"""Pictures that are small as a file and large in memory are refused by their header."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from bendtrack.labeling.checks import check_labels
from bendtrack.labeling.store import image_size_wh
from bendtrack.models.data.images import read_image_file
from bendtrack.tracker.errors import LabelError
from bendtrack.tracker.image_files import decode_image, header_size_wh
from bendtrack.tracker.project import Project


def png(width: int, height: int) -> bytes:
    """A black picture; only its header is right."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b""))
        + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize("size_wh", [(9000, 9000), (26_000, 26_000), (2**31 - 1, 2**31 - 1)])
def test_large_pictures_are_refused_before_they_are_decoded(
    project: Project, size_wh: tuple[int, int]
) -> None:
    path = project.labels_dir / "arm" / "img00000.png"
    path.write_bytes(png(*size_wh))
    tracemalloc.start()
    for read in (lambda: read_image_file(path), lambda: check_labels(project)):
        with pytest.raises(LabelError, match="expected an image of at most 67 megapixels") as caught:
            read()
        assert str(path) in str(caught.value)
    assert image_size_wh(path) is None
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif"])
@pytest.mark.parametrize("shape", [(30, 40), (30, 40, 3)])
def test_every_kind_of_picture_is_read(suffix: str, shape: tuple[int, ...]) -> None:
    depths = (np.uint8, np.uint16) if suffix in (".png", ".tif") else (np.uint8,)
    for depth in depths:
        contents = cv2.imencode(suffix, np.full(shape, 7, depth))[1].tobytes()
        assert header_size_wh(contents) == (40, 30)
        image = decode_image(contents, cv2.IMREAD_COLOR)
        assert image is not None
        assert image.shape == (30, 40, 3)


@pytest.mark.parametrize(
    "contents", [b"", b"no image", b"II*\0", b"II*\0\x08\0\0\0\xff\xff", b"\x89PNG\r\n\x1a\n"]
)
def test_what_is_no_picture(contents: bytes) -> None:
    assert header_size_wh(contents) is None
    assert decode_image(contents, cv2.IMREAD_COLOR) is None


def test_a_large_tiff_of_a_depth_that_pillow_does_not_know() -> None:
    contents = bytearray(cv2.imencode(".tif", np.zeros((30, 40, 3), np.uint16))[1].tobytes())
    directory = struct.unpack("<I", contents[4:8])[0]
    for entry in range(struct.unpack("<H", contents[directory : directory + 2])[0]):
        at = directory + 2 + 12 * entry
        (tag,) = struct.unpack("<H", contents[at : at + 2])
        if tag in (256, 257):
            contents[at + 2 : at + 4] = struct.pack("<H", 4)
            contents[at + 8 : at + 12] = struct.pack("<I", 30_000)
    with pytest.raises(LabelError, match="at most 67 megapixels"):
        header_size_wh(bytes(contents))


def test_a_path_of_another_kind_is_said(tmp_path: Path) -> None:
    with pytest.raises(LabelError, match="missing or unreadable"):
        read_image_file(tmp_path / "missing.png")
