"""Programs that live links send to: they rebuild the joints from what comes."""

import json
import socket
import time
from collections.abc import Callable
from importlib import import_module, resources
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

import recon
from recon.core.bone_names import joint_names_in
from recon.core.skeleton import JOINTS, PARENTS
from recon.live.links import LiveLink, VmcLink
from recon.live.tracking import LiveEstimate

Pose = dict[str, list[float]]
"""Position and quaternion (x, y, z, w) of every bone to its parent, by name."""
FROM_UNITY = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
FROM_UNREAL = np.diag([1.0, -1.0, 1.0]) / 100
TREES: dict[type, tuple[str, ...]] = {
    VmcLink: tuple(bone[0].upper() + bone[1:] for bone in joint_names_in(JOINTS, "vrm")),
    LiveLink: joint_names_in(JOINTS, "unreal"),
}


def demo_estimates() -> list[LiveEstimate]:
    """The demo's motion as a stream would estimate it."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        motion = recon.load_motion(path).motion
    joints = recon.BodyModel.load().pose(motion).joints
    seen = torch.ones(len(JOINTS), dtype=torch.bool)
    rows = zip(motion.translation, motion.rotations, joints, strict=True)
    return [LiveEstimate(0.0, *row, motion.shape, seen, None) for row in rows]


def rebuilt(kind: type, pose: Pose) -> np.ndarray:
    """Joints in our world, metres, from bones as they came: forward kinematics in their axes."""
    places, turns = [], []
    for name, parent in zip(TREES[kind], PARENTS, strict=True):
        row = np.array(pose[name])
        place, turn = row[:3], Rotation.from_quat(row[3:])
        if parent >= 0:
            place, turn = places[parent] + turns[parent].apply(place), turns[parent] * turn
        places.append(place)
        turns.append(turn)
    return np.array(places) @ (FROM_UNITY if kind is VmcLink else FROM_UNREAL).T


def receive_vmc(pipe: Any) -> None:
    """Receive by python-osc's server until told to end; send the time, arrival and pose."""
    dispatcher = import_module("pythonosc.dispatcher").Dispatcher()
    blocking: Any = import_module("pythonosc.osc_server").BlockingOSCUDPServer
    found: list[tuple[float, float, Pose]] = []
    packets: list[tuple[float, bytes, Any]] = []
    seconds, arrived, pose = 0.0, 0.0, Pose()

    def set_time(_: str, now: float) -> None:
        nonlocal seconds, pose
        seconds, pose = now, {}

    def set_bone(_: str, name: str, *values: float) -> None:
        pose[name] = list(values)
        if len(pose) == len(JOINTS):
            found.append((seconds, arrived, pose))

    class Server(blocking):
        """Keeps packets with their arrival; reading them would delay the next one."""

        def verify_request(self, request: Any, client_address: Any) -> bool:
            if super().verify_request(request, client_address):
                packets.append((time.monotonic(), request[0], client_address))
            return False

    dispatcher.map("/VMC/Ext/T", set_time)
    dispatcher.map("/VMC/Ext/Bone/Pos", set_bone)
    with Server(("127.0.0.1", 0), dispatcher) as server:
        server.timeout = 0.5
        pipe.send(server.server_address[1])
        until_told(pipe, server.handle_request, packets)
    for came, packet, client in packets:
        arrived = came
        dispatcher.call_handlers_for_packet(packet, client)
    pipe.send(found)


def receive_json(pipe: Any) -> None:
    """Receive JSON Live Link until told to end; send the time, arrival and pose."""
    found: list[tuple[float, float, Pose]] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(0.5)
        pipe.send(server.getsockname()[1])

        def receive() -> None:
            try:
                packet = server.recv(1 << 16)
            except TimeoutError:
                return
            arrived = time.monotonic()
            ((_, bones),) = json.loads(packet).items()
            pose = {bone["Name"]: bone["Location"] + bone["Rotation"] for bone in bones}
            found.append((bones[0]["Time"], arrived, pose))

        until_told(pipe, receive, found)
    pipe.send(found)


def until_told(pipe: Any, receive: Callable[[], None], received: list[Any]) -> None:
    """Receive packets into a list until word comes by the pipe, and all that are there then."""
    while not pipe.poll():
        receive()
    before = -1
    while len(received) > before:
        before = len(received)
        receive()
