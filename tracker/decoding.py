"""Packets in, one row for every frame out, in presentation order; nothing is lost unsaid.

How frames are accounted for
    Each packet of the video stream is one frame, and carries its running number through the decoder (FFmpeg's
    "opaque"), so that a picture is matched to its packet whatever the codec's delay or reordering. A packet
    that gives no picture is a frame that could not be decoded: it keeps its row and its time. Packets that
    are not to be shown (before the start of an edit list; VP8's hidden references) are no frames.

What is believed of a damaged frame
    FFmpeg conceals errors: it hands out a picture patched from its neighbours. A picture that the decoder
    marks corrupt, or whose packet the file marks so, is not used: that frame is undecodable. Frames that
    are decoded without error but build on such a frame (up to the next key frame) are given out marked
    `damaged`. Decoders of HEVC and VP9 do not notice flipped bits inside a packet (nor does MJPEG's
    always): nothing here can either.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import cast

import av
from av.container import InputContainer

from .errors import reason

# A decoder reorders at most 16 frames (H.264, HEVC): a packet so much older than a decoded one will not come.
_MAX_REORDER = 16
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
        Decoded without error, but from a frame that could not be decoded.
    """

    stamp: int | None
    picture: av.VideoFrame | None
    damaged: bool = False


@dataclass(frozen=True)
class _Packet:
    number: int  # among the packets to be shown, in decoding order
    stamp: int | None
    group: int  # which key frame it follows
    leading: bool  # shown before its group's key frame, so it may also build on the group before


class Decoding:
    """One pass through an open video (see `container.open_video`).

    Attributes
    ----------
    n_hidden : int
        Packets so far that are not to be shown.
    problems : list of str
        Why frames are missing, a line each; complete once `rows` is exhausted.
    """

    def __init__(
        self, container: InputContainer, stream: av.VideoStream, picture_wh: tuple[int, int]
    ) -> None:
        self.n_hidden = 0
        self.problems: list[str] = []
        self._container, self._stream, self._picture_wh = container, stream, picture_wh
        # AVI has a slot for each packet and no presentation times: the n-th picture shown belongs to the
        # n-th slot. (FFmpeg invents times for H.264 in AVI, out of order.)
        self._slots: list[int | None] | None = [] if container.format.name == "avi" else None
        self._reorder = _MAX_REORDER if stream.codec_context.has_b_frames else 0
        self._pending: dict[int, _Packet] = {}  # by number: neither decoded nor given up
        self._marked_corrupt: set[int] = set()
        self._waiting: list[tuple[_Packet, av.VideoFrame | None]] = []  # settled, in presentation order
        self._damage: dict[int, int] = {}  # group -> number of its first frame that could not be decoded
        self._n_late = self._n_resized = 0

    def rows(self) -> Iterator[Row]:
        """Decode to the end."""
        for index, row in enumerate(self._settled_rows()):
            yield row if self._slots is None else Row(self._slots[index], row.picture, row.damaged)
        if self._n_late:
            self.problems.append(f"{self._n_late} frames came out of order, too late: counted as undecodable")
        if self._n_resized:
            width, height = self._picture_wh
            self.problems.append(
                f"{self._n_resized} frames are not {width} x {height} like the first: counted as undecodable"
            )

    def _settled_rows(self) -> Iterator[Row]:
        for packet in self._packets():
            if packet.size:
                self._decode(packet)
            yield from self._release()
        self._decode(None)
        self._give_up(lambda packet: True)
        yield from self._release()

    def _packets(self) -> Iterator[av.Packet]:
        """The stream's packets, those to be shown numbered and noted as pending."""
        number = group = -1
        key_stamp: int | None = None
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets)
            except StopIteration:
                return
            except av.FFmpegError as error:
                self.problems.append(f"reading stopped after {number + 1} frames ({reason(error)})")
                return
            stamp = packet.pts if packet.pts is not None else packet.dts
            if packet.size == 0 and stamp is None:
                continue  # PyAV's sign for the end
            if packet.is_discard or self._is_invisible(packet):
                self.n_hidden += 1
            else:
                number += 1
                if packet.is_keyframe or group < 0:
                    group, key_stamp = group + 1, stamp
                leading = stamp is not None and key_stamp is not None and stamp < key_stamp
                self._pending[number] = _Packet(number, stamp, group, leading)
                if self._slots is not None:
                    self._slots.append(packet.dts)
                if packet.is_corrupt:
                    self._marked_corrupt.add(number)
                packet.opaque = number
            yield packet

    def _is_invisible(self, packet: av.Packet) -> bool:
        # RFC 6386 section 9.1: bit 4 of a VP8 frame's first byte is "show_frame".
        return (
            self._stream.codec_context.name == "vp8" and packet.size > 0 and not memoryview(packet)[0] & 0x10
        )

    def _decode(self, packet: av.Packet | None) -> None:
        try:
            pictures = self._stream.codec_context.decode(packet)
        except av.FFmpegError:
            return  # its number stays pending and is given up in time
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
        return packet.stamp if self._slots is None else None

    def _give_up(self, is_lost: Callable[[_Packet], bool]) -> None:
        lost = [packet for packet in self._pending.values() if is_lost(packet)]
        for packet in sorted(
            lost, key=lambda packet: packet.number if packet.stamp is None else packet.stamp
        ):
            self._settle(packet, None)

    def _settle(self, packet: _Packet, picture: av.VideoFrame | None) -> None:
        del self._pending[packet.number]
        self._marked_corrupt.discard(packet.number)
        place = len(self._waiting)
        if picture is None:
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
            yield Row(packet.stamp, picture, damaged=picture is not None and self._builds_on_damage(packet))

    def _builds_on_damage(self, packet: _Packet) -> bool:
        in_group = self._damage.get(packet.group, packet.number) < packet.number
        return in_group or (packet.leading and packet.group - 1 in self._damage)
