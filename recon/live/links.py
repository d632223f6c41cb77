"""Live links: estimates of a stream as UDP packets, VMC for Unity and JSON for Unreal's Live Link.

Both coordinate systems are left-handed, so positions p and rotations R are mirrored: p' = W p of
points in the world and R' = B R B of rotations to a parent, where W maps our world (z up) and B
the axes of our rest pose (a T pose, y up, facing z). The root's rotation is W R B.
"""

import errno
import json
import socket
import warnings
from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import torch
from jaxtyping import Float

from recon.core import rotations as so3
from recon.core.bone_names import joint_names_in
from recon.core.errors import ReconError, optional_module
from recon.core.skeleton import FAMILIES, JOINTS, PARENTS
from recon.live.tracking import LiveEstimate

_BUNDLE_BYTES = 1_200
"""Bytes of messages in an OSC bundle, so that it is not cut into fragments on its way."""
_LONGEST_SUBJECT = 100


@dataclass(frozen=True)
class _ProgramAxes:
    """The coordinate axes of another program, of its world and of its rest pose."""

    world: Float[np.ndarray, "3 3"]
    """Matrix from the axes of our world to the program's, without scale."""
    body: Float[np.ndarray, "3 3"]
    """Matrix from the axes of our rest pose to the program's; a reflection, its own inverse."""

    def bones(
        self, estimate: LiveEstimate
    ) -> tuple[Float[np.ndarray, "22 3"], Float[np.ndarray, "22 4"]]:
        """Return each bone's position (m) and quaternion (x, y, z, w) in its parent's frame."""
        local = estimate.rotations.double().numpy()
        joints = estimate.joints.double().numpy()
        turned = local.copy()
        for children, parent in FAMILIES:
            turned[children] = turned[parent] @ local[children]
        ways = joints[1:] - joints[_PARENTS]
        offsets = (ways[:, None] @ turned[_PARENTS])[:, 0] @ self.body
        offsets = np.concatenate((joints[:1] @ self.world.T, offsets))
        theirs = self.body @ local @ self.body
        theirs[0] = self.world @ local[0] @ self.body
        return offsets, so3.to_quaternion(torch.from_numpy(theirs)).numpy()


_PARENTS = np.array(PARENTS[1:])
_UNITY = _ProgramAxes(
    np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), np.diag([-1.0, 1.0, 1.0])
)
"""y up, the rest pose faces z."""
_UNREAL = _ProgramAxes(
    np.diag([1.0, -1.0, 1.0]), np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
)
"""z up, the rest pose faces y."""


class Link(AbstractContextManager[Any]):
    """Base class that sends estimates by UDP and reports each cause of lost packets once."""

    def __init__(self, address: str, complain: Callable[[str], Any]) -> None:
        host, port = _host_and_port(address)
        self._address, self._complain, self._reported = address, complain, set[int | None]()
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:
            raise ReconError(
                f"{address:.80}: no host is called {host!r:.80} ({error!s:.80})"
            ) from error
        # prefer IPv4, by which most receivers on `localhost` listen
        family, kind, protocol, _, place = min(found, key=lambda one: one[0] != socket.AF_INET)
        self._socket = socket.socket(family, kind, protocol)
        try:
            self._socket.connect(place)
        except OSError as error:
            self._socket.close()
            raise ReconError(f"{address}: nothing can be sent there ({error})") from error

    @abstractmethod
    def send(self, estimate: LiveEstimate | None) -> None:
        """Send an estimate and its `earlier` ones; None says that there is no estimate yet."""

    def close(self) -> None:
        """Close the socket; nothing can be sent afterwards."""
        self._socket.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send_packet(self, packet: bytes) -> None:
        try:
            try:
                self._socket.send(packet)
            except ConnectionRefusedError as error:
                # the error is about the previous packet; this one was not sent
                self._complain_once(
                    error, "nobody listens there yet; packets are sent all the same"
                )
                self._socket.send(packet)
        except ConnectionRefusedError:
            return
        except OSError as error:
            size = f" ({len(packet):,} bytes)" if error.errno == errno.EMSGSIZE else ""
            self._complain_once(error, f"a packet{size} was not sent: {error}")

    def _complain_once(self, error: OSError, message: str) -> None:
        if error.errno not in self._reported:
            self._reported.add(error.errno)
            self._complain(f"{self._address}: {message}")


class VmcLink(Link):
    """Sends estimates by the VMC protocol, as programs for avatars in Unity receive it.

    An estimate is `/VMC/Ext/OK`, `/VMC/Ext/T` with its time, `/VMC/Ext/Root/Pos`, which stays at
    the origin, and `/VMC/Ext/Bone/Pos` for 22 of Unity's HumanBodyBones, in bundles (OSC) that fit
    into one UDP packet. OK says that nothing is tracked if no joint was observed or there is no
    estimate.
    """

    def __init__(
        self, address: str = "127.0.0.1:39539", complain: Callable[[str], Any] = warnings.warn
    ) -> None:
        """Open a UDP socket that sends to programs for avatars by VMC.

        Args:
            address: HOST:PORT; a PORT alone is one of this machine.
            complain: called once with each reason for which packets are not delivered.

        Raises:
            ReconError: when the address is not valid, or python-osc is not installed.
        """
        builder = optional_module(
            "pythonosc.osc_message_builder", "python-osc", "sending VMC", "live"
        ).OscMessageBuilder

        def message_head(address: str, *values: str | int | float) -> bytes:
            """Return the bytes of an OSC message without its floats, 4 bytes each at the end."""
            message = builder(f"/VMC/Ext/{address}")
            for value in values:
                message.add_arg(value)
            floats = sum(isinstance(value, float) for value in values)
            return message.build().dgram[: -4 * floats or None]

        super().__init__(address, complain)
        self._tracked = [message_head("OK", 1, 3, 0, found) for found in (0, 1)]
        self._time = message_head("T", 0.0)
        pose = [0.0] * 7
        self._root = message_head("Root/Pos", "root", *pose) + _packed_floats([*pose[1:], 1.0])
        # VRM names these bones as Unity does, except for the capital first letter
        vrm = joint_names_in(JOINTS, "vrm")
        self._bones = [message_head("Bone/Pos", bone[0].upper() + bone[1:], *pose) for bone in vrm]

    def send(self, estimate: LiveEstimate | None) -> None:
        """Send an estimate and its `earlier` ones; None says that there is no estimate yet."""
        if estimate is None:
            self._send_bundles(self._tracked[:1])
            return
        for one in estimate.every:
            rows = np.concatenate(_UNITY.bones(one), 1)
            bones = [
                bone + _packed_floats(row) for bone, row in zip(self._bones, rows, strict=True)
            ]
            tracked = self._tracked[int(one.observed.any())]
            self._send_bundles(
                [tracked, self._time + _packed_floats([one.time]), self._root, *bones]
            )

    def _send_bundles(self, messages: Sequence[bytes]) -> None:
        """Send messages in as few bundles as possible; a bundle fits into one packet."""
        bundle = head = b"#bundle\0" + bytes(7) + b"\1"
        for message in messages:
            if len(bundle) + len(message) > _BUNDLE_BYTES:
                self._send_packet(bundle)
                bundle = head
            bundle += len(message).to_bytes(4, "big") + message
        self._send_packet(bundle)


def _packed_floats(values: Sequence[float] | np.ndarray) -> bytes:
    return np.array(values, dtype=">f4").tobytes()


class LiveLink(Link):
    """Sends estimates in the JSON of Unreal's plugin "JSON Live Link".

    A packet is one estimate: an object with the subject, a list of bones, each with Name, Parent
    (its number), Location (cm), Rotation (x, y, z, w) and Scale, relative to the parent. The names
    are those of the UE5 mannequin; the first is `root` at the origin. `root` also has Time, the
    estimate's time in seconds, which the plugin ignores.
    """

    def __init__(
        self,
        address: str = "127.0.0.1:54321",
        subject: str = "recon",
        complain: Callable[[str], Any] = warnings.warn,
    ) -> None:
        """Open a UDP socket that sends to Unreal's Live Link.

        Args:
            address: HOST:PORT; a PORT alone is one of this machine.
            subject: name that Unreal lists.
            complain: called once with each reason for which packets are not delivered.

        Raises:
            ReconError: when the address is not valid, or the subject no name.
        """
        if not (subject.isascii() and subject.isprintable() and subject.strip()) or (
            len(subject) > _LONGEST_SUBJECT
        ):
            raise ReconError(
                f"subject: expected 1 to {_LONGEST_SUBJECT} letters of ASCII, which is what the "
                f"plugin reads, got {subject!r:.60}"
            )
        self._subject = subject
        self._names = joint_names_in(JOINTS, "unreal")
        super().__init__(address, complain)

    def send(self, estimate: LiveEstimate | None) -> None:
        """Send an estimate and its `earlier` ones; None sends nothing."""
        for one in () if estimate is None else estimate.every:
            offsets, turns = _UNREAL.bones(one)
            bones = [
                _bone_record("root", -1, [0.0] * 3, [0.0, 0.0, 0.0, 1.0]) | {"Time": one.time}
            ]
            rows = zip(
                self._names, PARENTS, (100 * offsets).round(5).tolist(), turns.round(8).tolist(),
                strict=True,
            )  # fmt: skip
            bones += [
                _bone_record(name, parent + 1, place, turn) for name, parent, place, turn in rows
            ]
            packet = json.dumps({self._subject: bones}, separators=(",", ":"))
            self._send_packet(packet.encode("ascii"))


def _bone_record(
    name: str, parent: int, location: list[float], turn: list[float]
) -> dict[str, Any]:
    return {
        "Name": name, "Parent": parent, "Location": location, "Rotation": turn,
        "Scale": [1.0, 1.0, 1.0],
    }  # fmt: skip


def _host_and_port(address: str) -> tuple[str, int]:
    """Split an address, HOST:PORT, [IPv6]:PORT or PORT on this machine, into host and port.

    Raises:
        ReconError: when the address has none of these forms.
    """
    text = f"127.0.0.1:{address}" if address.isdecimal() else address
    try:
        parts = urlsplit(f"//{text}")
        host, port = parts.hostname, parts.port
        plain = parts.netloc == text and "@" not in text
    except ValueError:  # the port is not a number from 0 to 65535
        host = port = plain = None
    if not (host and port and plain):
        raise ReconError(
            "expected HOST:PORT with a port from 1 to 65535, such as 127.0.0.1:39539, or a PORT "
            f"of this machine, got {address!r:.80}"
        )
    return host, port
