"""python-can's SocketCAN interface with a receive of our own, which learns what the kernel had to drop.

python-can reads no more ancillary data than its own time stamp needs, and the drop counter would be cut off.
"""

from __future__ import annotations

import select
import socket
import struct
from typing import Any

import can
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.socketcan.socketcan import build_can_frame

_SO_RXQ_OVFL = 40  # asm-generic/socket.h: frames this socket has lost so far, with every frame after the first loss
_SO_TIMESTAMPNS = 35
_SO_RCVBUFFORCE = 33  # beyond net.core.rmem_max, for who has CAP_NET_ADMIN
_ANCILLARY = socket.CMSG_SPACE(16) + socket.CMSG_SPACE(4)
_TIMESPEC = struct.Struct("@ll")
_DROPPED = struct.Struct("@I")
_HEADER = struct.Struct("=IBB2x")  # struct can_frame and canfd_frame: id with flags, length, FD flags
_CLASSIC_BYTES, _FD_BYTES = 16, 72


class SocketCan(SocketcanBus):
    """Receives every frame with the kernel's time stamp; `dropped` counts those it lost because nobody read in time."""

    def __init__(self, channel: str, *, receive_buffer_bytes: int, **options: Any) -> None:
        """The kernel grants at most net.core.rmem_max; `receive_buffer_bytes` is then what it granted."""
        super().__init__(channel=channel, **options)
        self.dropped = 0
        self.socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        try:
            self.socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, receive_buffer_bytes)
        except PermissionError:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
        # The kernel doubles what it is asked for, to have room for its own bookkeeping (socket(7)).
        self.receive_buffer_bytes = self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, None after `timeout` seconds. Raises OSError for what the kernel says of the interface."""
        try:
            frame, ancillary, _, _ = self.socket.recvmsg(_FD_BYTES, _ANCILLARY, socket.MSG_DONTWAIT)
        except BlockingIOError:
            if not select.select([self.socket], [], [], timeout)[0]:
                return None
            frame, ancillary, _, _ = self.socket.recvmsg(_FD_BYTES, _ANCILLARY, socket.MSG_DONTWAIT)
        stamp_s = 0.0
        for _, kind, data in ancillary:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIMESPEC.unpack_from(data)
                stamp_s = seconds + nanoseconds * 1e-9
            elif kind == _SO_RXQ_OVFL:
                (self.dropped,) = _DROPPED.unpack_from(data)
        identifier, length, _ = _HEADER.unpack_from(frame)
        extended = bool(identifier & socket.CAN_EFF_FLAG)
        return can.Message(
            stamp_s,
            identifier & (socket.CAN_EFF_MASK if extended else socket.CAN_SFF_MASK),
            extended,
            bool(identifier & socket.CAN_RTR_FLAG),
            bool(identifier & socket.CAN_ERR_FLAG),
            data=frame[8 : 8 + length],
            dlc=length,
            is_fd=len(frame) != _CLASSIC_BYTES,
        )

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand a frame to the kernel; OSError at once if it has no room, as a daemon cannot wait."""
        self.socket.send(build_can_frame(msg), socket.MSG_DONTWAIT)
