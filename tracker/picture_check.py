"""Is a picture likely, given the pictures before and after it? For damage that a decoder does not notice.

Most decoders take flipped bits for picture data. The pictures then change in a way that no scene does: where frames
stand alone, for a few of them and back; else much at once, and back at the next key frame. In a file that is known to
be damaged also what changes while its packet is as small as ever. A few thousand samples of each picture are compared
with those before; what follows is decided once the video has ended, from a few numbers a frame.
"""

from __future__ import annotations

from array import array
from collections import deque
from itertools import pairwise

import av
import cv2
import numpy as np

from .decoding import Row
from .types import BoolArray, FloatArray, ImageArray

# Samples along the axes of the luma; chroma has half as many, since damage of colour alone is common.
_SAMPLES_XY = (80, 60)
# Decoders that notice damage themselves: of 190 damaged films by them the check found nothing more.
_NOTICING = ("h264", "mpeg4", "mpeg2video", "mpeg1video")
# Grey levels by which a changed sample differs: above the noise of cameras, below what damage does.
_CHANGED = 14
# Changed samples are a burst when they are so many times the usual share around, plus so large a share of all.
_BURST_RATIO, _BURST_SHARE = 1.8, 0.004
# Frames on each side whose median says what is usual.
_AROUND = 16
# The same for changes that do not go back; and for those that a key frame undoes, of which so large a share goes back.
_ONSET_SHARE = 0.02
_UNDONE_SHARE, _UNDONE = 0.06, 0.7
# The same where a file is known to be damaged, against the frames right before and after.
_STRICT_RATIO, _STRICT_SHARE = 1.2, 0.008
# Of fewer frames nothing is usual.
_LEAST_ROWS = 8
# A packet carries what has changed when it is so many times larger than usual, and by so large a share of what a key
# frame takes for as much of the picture.
_LARGER, _CARRIES = 1.5, 0.5
# So many frames in a row are compared with the one before them.
_FRAMES_BACK = 3
# Of what changes at a key frame so large a share is as it was a group before, where damage ends.
_RETURNED = 0.5
# When more than this share changes, the light or the camera did.
_EVERYTHING = 0.8
_BLOCK = 512  # rows at a time, so that memory does not grow with the video


class PictureCheck:
    """Takes the rows of a video in order; at the end says which pictures are doubtful.

    Parameters
    ----------
    codec : str
        FFmpeg's name of the codec.
    """

    def __init__(self, codec: str) -> None:
        self._is_needed = codec not in _NOTICING
        self._sampler: _Sampler | None = None
        self._rows = array("q")  # indices of the rows below
        self._changed = array("d")  # share of samples that differ from the row before
        self._returned = array("d")  # at key frames: share of these that are as they were a group before
        self._since: dict[tuple[int, int], float] = {}  # (a row, one before it) -> share that differs
        self._time = array("d")
        self._bytes = array("q")
        self._key = array("b")
        self._last: deque[ImageArray] = deque(maxlen=_FRAMES_BACK + 1)
        self._of_group: tuple[ImageArray, ...] = ()
        self._usual, self._n_after_burst = 0.02, 0

    def add(self, index: int, row: Row, time_s: float) -> None:
        """Take the next row; those without a sound picture are left out.

        Parameters
        ----------
        index : int
            Of the frame.
        row : Row
            As decoded.
        time_s : float
            Its time, s.
        """
        if not self._is_needed or row.picture is None or row.damaged:
            return
        if self._sampler is None or not self._sampler.fits(row.picture):
            self._sampler = _Sampler(row.picture)
        now = self._sampler.samples(row.picture)
        if self._last and len(self._last[-1]) != len(now):
            return
        place = len(self._rows)
        changed = returned = 0.0
        if self._last:
            different = _different(now, self._last[-1])
            changed = float(np.count_nonzero(different)) / len(now)
            if changed > 1.4 * self._usual + _BURST_SHARE / 2:
                self._n_after_burst = _FRAMES_BACK + 1
            self._usual += 0.1 * (min(changed, 2 * self._usual + _BURST_SHARE) - self._usual)
            if self._n_after_burst:
                self._n_after_burst -= 1
                for back in range(2, len(self._last) + 1):
                    apart = np.count_nonzero(_different(now, self._last[-back]))
                    self._since[place, place - back] = float(apart) / len(now)
            if row.key and changed > _BURST_SHARE and self._of_group:
                as_before = ~_different(now, self._of_group[0])
                for other in self._of_group[1:]:
                    as_before |= ~_different(now, other)
                returned = float(np.count_nonzero(different & as_before)) / np.count_nonzero(different)
        if row.key:
            self._of_group = (*((self._last[-1],) if self._last else ()), now)
        self._last.append(now)
        self._rows.append(index)
        self._changed.append(changed)
        self._returned.append(returned)
        self._time.append(time_s)
        self._bytes.append(row.size_bytes)
        self._key.append(row.key)

    def doubtful(self, *, is_damaged: bool = False) -> list[int]:
        """Indices of the frames that are unlikely, once all rows have been added.

        Parameters
        ----------
        is_damaged : bool
            Whether the file is known to be damaged: smaller changes count as damage then.

        Returns
        -------
        list of int
            In order.
        """
        n = len(self._rows)
        if n < _LEAST_ROWS:
            return []
        changed, key = np.array(self._changed), np.array(self._key, bool)
        changed[0] = np.nan
        step_s = np.diff(np.array(self._time), prepend=np.nan)
        longer = np.maximum(1.0, np.nan_to_num(step_s / max(np.nanmedian(step_s), 1e-9), nan=1.0))
        usual = _around(changed)
        known = np.nan_to_num(changed)
        burst = known > _BURST_RATIO * longer * usual + _BURST_SHARE
        if key.all():
            doubtful = self._there_and_back(burst, usual * longer)
        else:
            # Encoders of such codecs blur and sharpen whole groups: alone, only what a key frame undoes is damage.
            doubtful = self._undone_by_key(known > _BURST_RATIO * longer * usual + _UNDONE_SHARE)
        if not key.all() and is_damaged:
            doubtful |= self._there_and_back(burst, usual * longer)
            unexplained = known > _BURST_RATIO * longer * usual + _ONSET_SHARE
            unexplained |= known > _STRICT_RATIO * longer * _next_to(changed) + _STRICT_SHARE
            doubtful |= self._unexplained(unexplained & ~doubtful & (known < _EVERYTHING), changed, usual)
        elif key.all() and n > 2 * _LEAST_ROWS:
            # The first and the last have a neighbour on one side only.
            doubtful[0] |= bool(burst[1]) and not doubtful[1]
            doubtful[-1] |= bool(burst[-1]) and not doubtful[-2]
        return [self._rows[place] for place in np.flatnonzero(doubtful)]

    def _there_and_back(self, burst: BoolArray, usual: FloatArray) -> BoolArray:
        """Pictures unlike the one before them, while one soon after is like it again."""
        doubtful = np.zeros(len(burst), bool)
        for first in np.flatnonzero(burst):
            if doubtful[first] or first == 0:
                continue
            for length in range(1, _FRAMES_BACK + 1):
                after = first + length
                if after >= len(burst) or (not burst[after] and length == 1):
                    break
                apart = self._since.get((int(after), int(first) - 1), np.inf)
                least = min(self._changed[first], self._changed[after])
                moved = (length + 1) * usual[first]
                if apart < _BURST_RATIO * moved + _BURST_SHARE and apart < 0.8 * least:
                    doubtful[first:after] = True
                    break
        return doubtful

    def _undone_by_key(self, burst: BoolArray) -> BoolArray:
        """From a burst between two key frames to the second of them, where that brings back what the burst changed."""
        doubtful = np.zeros(len(burst), bool)
        keys = np.flatnonzero(np.array(self._key, bool))
        for begin, at in pairwise(keys):
            within = begin + 1 + np.flatnonzero(burst[begin + 1 : at])
            if len(within) and burst[at] and self._returned[at] > _UNDONE:
                doubtful[within[0] : at] = True
        return doubtful

    def _unexplained(self, burst: BoolArray, changed: FloatArray, usual: FloatArray) -> BoolArray:
        """Where frames build on each other: from a burst that no packet carries, or to a key frame that undoes one."""
        key, size = np.array(self._key, bool), np.array(self._bytes, float)
        doubtful = np.zeros(len(burst), bool)
        usual_size = _around(np.where(key, np.nan, size))
        keys = np.flatnonzero(key)
        ends = np.append(keys[keys > 0], len(key))
        key_size = float(np.median(size[key])) if key.any() else 0.0
        with np.errstate(invalid="ignore"):
            carried = (size > _LARGER * usual_size) & (
                size - usual_size > _CARRIES * (changed - usual) * key_size
            )
        for start in np.flatnonzero(burst & ~key & ~carried):
            doubtful[start : ends[np.searchsorted(ends, start, side="right")]] = True
        at_keys = changed[keys[keys > 0]]
        usual_at_keys = float(np.median(at_keys)) if len(at_keys) > 2 else 0.0
        spacing = np.diff(keys)
        regular = float(np.median(spacing)) if len(spacing) else 0.0
        for number, at in enumerate(keys):
            if at == 0 or not burst[at] or changed[at] < _BURST_RATIO * usual_at_keys + _ONSET_SHARE:
                continue
            begin = keys[number - 1] if number else 0
            end = keys[number + 1] if number + 1 < len(keys) else len(key)
            if self._returned[at] > _RETURNED or doubtful[begin:at].any():
                early = np.flatnonzero(burst[begin:at])
                doubtful[begin + (early[0] if len(early) else 0) : at] = True
            elif at - begin == regular or number == len(keys) - 1:
                # An encoder puts a key frame where the scene changes, hardly ever by chance: damage before or after.
                doubtful[at:end] = True
                if number == 1:
                    doubtful[begin:at] = True
        return doubtful


class _Sampler:
    """Takes samples of the planes of pictures on a grid; how, is worked out once for a size and format."""

    def __init__(self, picture: av.VideoFrame) -> None:
        self._layout = picture.format.name, picture.width, picture.height
        components = picture.format.components
        self._planes: list[tuple[slice, slice, int, int]] = []  # rows, columns, their number, bits above 8
        is_packed = len(picture.planes) == 1
        for number, plane in enumerate(picture.planes[:3]):
            bits = components[min(number, len(components) - 1)].bits
            pixel = max(1, len(components)) if is_packed else 1
            share = 2 if number else 1
            step_y = max(1, plane.height * share // _SAMPLES_XY[1])
            step_x = max(1, plane.width * share // _SAMPLES_XY[0]) * pixel
            columns = slice(0, min(plane.line_size // (1 + (bits > 8)), plane.width * pixel), step_x)
            self._planes.append((slice(0, plane.height, step_y), columns, plane.line_size, max(0, bits - 8)))

    def fits(self, picture: av.VideoFrame) -> bool:
        """Whether a picture has the size and format."""
        return self._layout == (picture.format.name, picture.width, picture.height)

    def samples(self, picture: av.VideoFrame) -> ImageArray:
        """Samples (S,) uint8; of more than 8 bits the upper 8."""
        found = []
        planes = picture.planes
        for plane, (rows, columns, line_bytes, more_bits) in zip(planes, self._planes, strict=False):
            if plane.line_size != line_bytes:  # the decoder has other buffers now
                return _Sampler(picture).samples(picture)
            if more_bits:
                wide = np.frombuffer(memoryview(plane), "<u2").reshape(-1, line_bytes // 2)[rows, columns]
                found.append((wide >> more_bits).astype(np.uint8).ravel())
            else:
                found.append(
                    np.frombuffer(memoryview(plane), np.uint8).reshape(-1, line_bytes)[rows, columns].ravel()
                )
        return found[0] if len(found) == 1 else np.concatenate(found)


def _different(one: ImageArray, other: ImageArray) -> BoolArray:
    return np.asarray(cv2.absdiff(one, other).reshape(-1) > _CHANGED)


def _around(values: FloatArray) -> FloatArray:
    """The median of the values around each, without its own and its neighbour's; NaN do not count, 0 without any."""
    return _median_of_windows(values, _AROUND, without=(_AROUND, _AROUND + 1))


def _next_to(values: FloatArray) -> FloatArray:
    """The median of the two values before and the two after each."""
    return _median_of_windows(values, 2, without=(2,))


def _median_of_windows(values: FloatArray, reach: int, without: tuple[int, ...]) -> FloatArray:
    padded = np.pad(values, reach, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    found = np.zeros(len(values))
    for begin in range(0, len(values), _BLOCK):
        block = windows[begin : begin + _BLOCK].copy()
        block[:, list(without)] = np.nan
        block.sort(axis=1)  # NaN last
        known = (~np.isnan(block)).sum(axis=1)
        middle = np.take_along_axis(block, np.maximum(known - 1, 0)[:, None] // 2, axis=1)[:, 0]
        found[begin : begin + _BLOCK] = np.where(known > 0, middle, 0.0)
    return found
