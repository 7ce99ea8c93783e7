"""Packets in, one row for every frame out, in presentation order; nothing is lost unsaid.

How frames are accounted for
    Each packet of the video stream is one frame, and carries its running number through the decoder (FFmpeg's
    "opaque"), so that a picture is matched to its packet whatever the codec's delay or reordering. A packet
    that gives no picture is a frame that could not be decoded: it keeps its row and its time. Packets that
    are not to be shown (before the start of an edit list; VP8's hidden references) are no frames.

What is kept of a damaged frame
    FFmpeg conceals errors: it hands out a picture patched from its neighbours. A picture that the decoder
    marks corrupt, or whose packet the file marks so, is not used: that frame is undecodable. A picture during
    whose decoding FFmpeg logged an error, and frames that are decoded without error but build on a frame that is
    missing or not sound (up to the next key frame), are given out marked `damaged`. What no decoder notices is
    looked for in the pictures: `picture_check.py`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import cast

import av
from av.container import InputContainer

from .avi_index import ChunkSlots
from .decoder_log import complaints
from .errors import reason

# A decoder reorders at most 16 frames (H.264, HEVC): a packet so much older than a decoded one will not come.
_MAX_REORDER = 16
# FFmpeg reads so many bytes at most to probe a file.
_PROBED_BYTES = 5_000_000
# An elementary stream has no zeroes between its frames: so many are the rest of one that is gone.
_LONGEST_REPORT = 60
"""Characters of a report of FFmpeg that are shown; a warning of ours says what follows from it."""
_ZEROES = bytes(64)
_NUMBERS = re.compile(r"(0x)?[0-9a-f]*\d[0-9a-f]*")
# When no picture comes at all, stop waiting for packets older than this.
_MAX_PENDING = 256


@dataclass(frozen=True)
class Row:
    """A frame at its place; `stamp` in units of the stream's time base, None where the file has no times.

    Attributes
    ----------
    stamp : int or None
        Presentation time in units of the stream's time base, None where the file has no times.
    picture : VideoFrame or None
        The decoded frame, None if it could not be decoded.
    damaged : bool
        FFmpeg reported an error in this frame, or it was decoded from a frame that is missing or not sound.
    key : bool
        Whether the file marks the frame as a key frame.
    size_bytes : int
        Of its packet.
    position : int
        Of its packet in the file, bytes; -1 where that is not known.
    """

    stamp: int | None
    picture: av.VideoFrame | None
    damaged: bool = False
    key: bool = True
    size_bytes: int = 0
    position: int = -1


@dataclass(frozen=True)
class _Packet:
    number: int  # among the packets to be shown, in decoding order
    stamp: int | None
    group: int  # which key frame it follows
    leading: bool  # shown before its group's key frame, so it may also build on the group before
    key: bool = False
    size: int = 0  # bytes
    position: int = -1  # in the file, bytes


def packets_of(container: InputContainer, stream: av.VideoStream) -> Iterator[av.Packet]:
    """The packets of a stream, as PyAV reads them."""
    return container.demux(stream)


class Decoding:
    """One pass through an open video (see `container.open_video`).

    Attributes
    ----------
    n_hidden : int
        Packets so far that are not to be shown.
    problems : list of str
        Why frames are missing, a line each; complete once `rows` is exhausted.
    last_duration : int
        Of the frame that is shown last, in units of the stream's time base; 0 where the file does not say.

    Parameters
    ----------
    container, stream : InputContainer, VideoStream
        As `container.open_video` gives them.
    picture_wh : tuple of (int, int)
        Size of the frames as stored, px; others count as undecodable.
    has_times : bool
        Whether the file holds presentation times; FFmpeg invents some where it does not.
    slots : ChunkSlots or None
        The index of an AVI.
    is_cut : bool
        Whether the last packet is known to be incomplete.
    heard_at_opening : sequence of str
        What FFmpeg said of damage while it probed the file, whose beginning it then kept.
    """

    def __init__(
        self,
        container: InputContainer,
        stream: av.VideoStream,
        picture_wh: tuple[int, int],
        *,
        has_times: bool = True,
        slots: ChunkSlots | None = None,
        is_cut: bool = False,
        heard_at_opening: Sequence[str] = (),
    ) -> None:
        self.n_hidden = 0
        self.last_duration = 0
        self.problems: list[str] = []
        self._container, self._stream, self._picture_wh = container, stream, picture_wh
        # AVI has a slot for each packet and no presentation times: the n-th picture shown belongs to the
        # n-th slot. (FFmpeg invents times for H.264 in AVI, out of order.)
        self._slots: list[int | None] | None = [] if container.format.name == "avi" else None
        self._has_times = has_times
        self._index, self._is_cut = slots, is_cut
        self._last_slot: tuple[int, int] | None = None  # of the index, and FFmpeg's count
        # Threads log on their own: only what is decoded in this thread can be matched to its packet.
        self._hears_decoder = stream.codec_context.thread_count == 1
        self._reorder = _MAX_REORDER if stream.codec_context.has_b_frames else 0
        self._pending: dict[int, _Packet] = {}  # by number: neither decoded nor given up
        self._marked_corrupt: set[int] = set()
        self._complained: set[int] = set()  # numbers of packets during whose decoding FFmpeg logged an error
        self._heard: dict[str, int] = {}  # what FFmpeg logged while reading -> how often
        # Where FFmpeg counts frames instead of reading their times, a lost one shifts all that follow.
        self._counts_times = not has_times or container.format.name in ("avi", "mxf")
        self._uncertain_from = sys.maxsize  # number of the first packet whose time may be wrong
        self._damaged_bytes = 0  # packets that begin before this position may be damaged
        for message in heard_at_opening:
            self._heard[message] = 1
            self._damaged_bytes = _PROBED_BYTES
        self._number = self._group = -1
        self._last_stamp: int | None = None
        self._waiting: list[tuple[_Packet, av.VideoFrame | None]] = []  # settled, in presentation order
        self._damage: dict[int, int] = {}  # group -> number of its first frame that could not be decoded
        self._n_late = self._n_resized = 0

    def rows(self) -> Iterator[Row]:
        """Decode to the end."""
        for index, row in enumerate(self._settled_rows()):
            yield row if self._slots is None else replace(row, stamp=self._slots[index])
        for message, count in self._heard.items():
            times = f" ({count} times)" if count > 1 else ""
            short = message if len(message) <= _LONGEST_REPORT else f"{message[: _LONGEST_REPORT - 3]}..."
            self.problems.append(f"FFmpeg reports while reading: {short}{times}")
        if self._n_late:
            self.problems.append(f"{self._n_late} frames came out of order, too late: counted as undecodable")
        if self._n_resized:
            width, height = self._picture_wh
            self.problems.append(
                f"{self._n_resized} frames are not {width} x {height} like the first: counted as undecodable"
            )

    def _settled_rows(self) -> Iterator[Row]:
        # One packet behind: only what comes after a packet shows whether it is whole.
        last: av.Packet | None = None
        for packet in self._packets():
            if last is not None:
                self._decode(last)
                yield from self._release()
            last = packet
        if last is not None:
            if self._is_cut:
                self._complained.add(self._number)
            self._decode(last)
            yield from self._release()
        self._decode(None)
        if self._index is not None and self._number >= 0:
            for slot in self._index.lost_at_end():
                self._add_lost(slot)
        self._give_up(lambda packet: True)
        yield from self._release()

    def _packets(self) -> Iterator[av.Packet]:
        """The stream's packets, those to be shown numbered and noted as pending."""
        key_stamp: int | None = None
        packets = packets_of(self._container, self._stream)
        while True:
            try:
                with av.logging.Capture() as logs:
                    packet = next(packets)
            except (StopIteration, IndexError):
                # IndexError: PyAV (18) at the end of a file in which streams appear that its header does not list.
                self._hear_reader(logs)
                return
            except av.FFmpegError as error:
                self.problems.append(f"reading stopped after {self._number + 1} frames ({reason(error)})")
                return
            self._hear_reader(logs)
            stamp = packet.pts if packet.pts is not None else packet.dts
            if packet.size == 0 and stamp is None:
                continue  # PyAV's sign for the end
            if packet.is_discard or self._is_invisible(packet):
                self.n_hidden += 1
            else:
                self._find_slot(packet)
                self._number += 1
                if packet.is_keyframe or self._group < 0:
                    self._group, key_stamp = self._group + 1, stamp
                leading = stamp is not None and key_stamp is not None and stamp < key_stamp
                self._pending[self._number] = _Packet(
                    self._number,
                    stamp,
                    self._group,
                    leading,
                    packet.is_keyframe,
                    packet.size,
                    _position(packet),
                )
                if stamp is not None and (self._last_stamp is None or stamp >= self._last_stamp):
                    self._last_stamp, self.last_duration = stamp, packet.duration or 0
                if packet.is_corrupt:
                    self._marked_corrupt.add(self._number)
                if max(0, _position(packet)) < self._damaged_bytes:
                    self._complained.add(self._number)
                if not self._has_times and memoryview(packet)[-len(_ZEROES) :] == _ZEROES:
                    self._lose_track()
                packet.opaque = self._number
            yield packet

    def _hear_reader(self, logs: list[tuple[int, str, str]]) -> None:
        """Note errors while reading: packets may be lost here, on which the rest of the group builds."""
        if not logs:
            return
        # The reader's own words; what a parser of the codec says, the decoder says again.
        readers = ("", self._container.format.name)
        for message in complaints([log for log in logs if log[1] in readers]):
            # Positions and numbers make every message a new one.
            kind = _NUMBERS.sub("...", message)
            self._heard[kind] = self._heard.get(kind, 0) + 1
            self._lose_track()

    def _lose_track(self) -> None:
        """The packet read last may not be whole, and others may be lost behind it."""
        self._mark_group(self._number - 1)
        if self._counts_times:
            self._uncertain_from = min(self._uncertain_from, self._number + 1)

    def _mark_group(self, number: int) -> None:
        """Mark what follows this number in the group being read."""
        if self._group >= 0:
            self._damage[self._group] = min(self._damage.get(self._group, number), number)

    def _find_slot(self, packet: av.Packet) -> None:
        """The slot of an AVI's packet, after rows for the packets that its index has and the file has lost."""
        if self._slots is None:
            return
        slot = packet.dts
        if self._index is not None and packet.pos is not None:
            lost, known = self._index.lost_before(packet.pos, packet.size)
            if self._index.is_uncertain:
                self._uncertain_from = 0
            if known is not None:
                for lost_slot in lost if self._number >= 0 else ():
                    self._add_lost(lost_slot)
                slot = known
                if packet.dts is not None:
                    self._last_slot = known, packet.dts
            elif packet.dts is not None and self._last_slot is not None:
                slot = packet.dts + self._last_slot[0] - self._last_slot[1]
        self._slots.append(slot)

    def _add_lost(self, slot: int) -> None:
        """A row for a packet that is not in the file any more."""
        assert self._slots is not None
        self._number += 1
        self._slots.append(slot)
        self._pending[self._number] = _Packet(self._number, None, max(self._group, 0), leading=False)
        self._mark_group(self._number)

    def _is_invisible(self, packet: av.Packet) -> bool:
        # RFC 6386 section 9.1: bit 4 of a VP8 frame's first byte is "show_frame".
        return (
            self._stream.codec_context.name == "vp8" and packet.size > 0 and not memoryview(packet)[0] & 0x10
        )

    def _decode(self, packet: av.Packet | None) -> None:
        if packet is not None and packet.size == 0:
            return
        pictures: list[av.VideoFrame] = []
        # Where it fails, the packet's number stays pending and is given up in time.
        with av.logging.Capture() as logs, suppress(av.FFmpegError):
            pictures = self._stream.codec_context.decode(packet)
        if logs and self._hears_decoder and packet is not None and complaints(logs):
            number = cast(int | None, packet.opaque)
            if number is None:  # not shown, but others may build on it
                self._mark_group(self._number - 1)
            else:
                self._complained.add(number)
        for picture in pictures:
            if picture.opaque is None:
                continue  # made up by the decoder for a missing reference, or not to be shown
            number = cast(int, picture.opaque)
            packet_of = self._pending.get(number)
            if packet_of is None:
                self._n_late += 1
                continue
            self._give_up_before(packet_of)
            sound = not picture.is_corrupt and number not in self._marked_corrupt
            if sound and (picture.width, picture.height) != self._picture_wh:
                self._n_resized += 1
                sound = False
            self._settle(packet_of, picture if sound else None)
        if packet is None and complaints(logs):
            self._mark_group(self._number - 1)
        if len(self._pending) > _MAX_PENDING:
            oldest = next(iter(self._pending))
            self._give_up(lambda pending: pending.number == oldest)

    def _give_up_before(self, shown: _Packet) -> None:
        """Give up the packets that should have been shown before this one."""
        stamp = self._time_of(shown)
        if stamp is None:
            self._give_up(lambda packet: packet.number < shown.number - self._reorder)
        else:
            self._give_up(lambda packet: packet.stamp is not None and packet.stamp < stamp)

    def _time_of(self, packet: _Packet) -> int | None:
        """When the packet's picture is shown, None where the file does not tell."""
        return packet.stamp if self._slots is None and self._has_times else None

    def _give_up(self, is_lost: Callable[[_Packet], bool]) -> None:
        lost = [packet for packet in self._pending.values() if is_lost(packet)]
        for packet in sorted(
            lost, key=lambda packet: packet.number if packet.stamp is None else packet.stamp
        ):
            self._settle(packet, None)

    def _settle(self, packet: _Packet, picture: av.VideoFrame | None) -> None:
        del self._pending[packet.number]
        self._marked_corrupt.discard(packet.number)
        if picture is not None and packet.number in self._complained:
            self._damage[packet.group] = min(self._damage.get(packet.group, packet.number), packet.number)
        place = len(self._waiting)
        if picture is None:
            if self._counts_times and self._slots is None:
                self._uncertain_from = min(self._uncertain_from, packet.number + 1)
            self._damage[packet.group] = min(self._damage.get(packet.group, packet.number), packet.number)
            if self._time_of(packet) is None:  # its place is then known to within the reordering
                later = (i for i, (other, _) in enumerate(self._waiting) if other.number > packet.number)
                place = next(later, place)
        self._waiting.insert(place, (packet, picture))

    def _release(self) -> Iterator[Row]:
        """Rows of which it is known whether all frames before them (in decoding order) are sound.

        A B-frame comes out before a frame that it builds on, so it waits for that one.
        """
        unknown = next(iter(self._pending), None)
        while self._waiting:
            packet, picture = self._waiting[0]
            if picture is not None and unknown is not None and unknown < packet.number:
                return
            del self._waiting[0]
            complained = packet.number in self._complained
            self._complained.discard(packet.number)
            yield Row(
                packet.stamp if self._has_times else None,
                picture,
                damaged=picture is not None
                and (complained or self._builds_on_damage(packet) or packet.number >= self._uncertain_from),
                key=packet.key,
                size_bytes=packet.size,
                position=packet.position,
            )

    def _builds_on_damage(self, packet: _Packet) -> bool:
        in_group = self._damage.get(packet.group, packet.number) < packet.number
        return in_group or (packet.leading and packet.group - 1 in self._damage)


def _position(packet: av.Packet) -> int:
    return -1 if packet.pos is None else packet.pos
