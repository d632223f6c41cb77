"""Live links on loopback: packets lost, latency added, and poses that receivers rebuild.

    python -m benchmarks.live_links --minutes 10

Estimates of the demo's motion are sent at a rate by VMC and by JSON Live Link, as a stream would;
nothing is fitted. A second process receives, VMC by python-osc's server. Latency is the time from
the call that sends an estimate until its last packet is there; work is the processor's time in
that call. Poses are rebuilt from what came,
in Unity's and Unreal's axes, and compared with the joints of the estimates.
"""

import argparse
import json
import multiprocessing
import socket
import time
from collections.abc import Callable
from importlib import import_module, resources
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

import recon
from recon.core.bone_names import renamed
from recon.core.skeleton import JOINTS, PARENTS
from recon.live.links import LiveLink, VmcLink
from recon.live.tracking import LiveEstimate

Pose = dict[str, list[float]]
"""Position and quaternion (x, y, z, w) of every bone to its parent, by name."""
_KEPT = 10
"""Every how many poses one is kept and compared: all of ten minutes fill the memory."""
FROM_UNITY = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
FROM_UNREAL = np.diag([1.0, -1.0, 1.0]) / 100
TREES: dict[type, tuple[str, ...]] = {
    VmcLink: tuple(bone[0].upper() + bone[1:] for bone in renamed(JOINTS, "vrm")),
    LiveLink: renamed(JOINTS, "unreal"),
}


def main() -> None:
    """Measure and print, both links at once."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--rates", nargs="+", type=float, default=[30.0, 60.0])
    given = parser.parse_args()
    for fps in given.rates:
        measure(fps, round(60 * given.minutes * fps))


def measure(fps: float, count: int) -> None:
    """Send so many estimates at a rate; print what came of them."""
    estimates = demo_estimates()
    sent, worked = ({VmcLink: np.zeros(count), LiveLink: np.zeros(count)} for _ in range(2))
    context = multiprocessing.get_context("spawn")
    receivers, links, told = [], [], []
    for kind, receive in ((VmcLink, receive_vmc), (LiveLink, receive_json)):
        mine, theirs = context.Pipe()
        process = context.Process(target=receive, args=(theirs, _KEPT), daemon=True)
        process.start()
        receivers.append((kind, mine, process))
        links.append(kind(f"127.0.0.1:{mine.recv()}", complain=told.append))
    began = time.monotonic()
    for k in range(count):
        time.sleep(max(0.0, began + k / fps - time.monotonic()))
        one = at_time(estimates[k % len(estimates)], k / fps)
        for link in links:
            sent[type(link)][k] = time.monotonic()
            before = time.thread_time()
            link.send(one)
            worked[type(link)][k] = time.thread_time() - before
    for link in links:
        link.close()
    for kind, mine, process in receivers:
        mine.send("end")
        found: list[tuple[float, float, Pose]] = mine.recv()
        process.join()
        frames = {round(seconds * fps): (arrived, pose) for seconds, arrived, pose in found}
        late = 1000 * np.array([frames[k][0] - sent[kind][k] for k in sorted(frames)])
        worst = max(
            float(np.abs(rebuilt(kind, pose) - estimates[k % len(estimates)].joints.numpy()).max())
            for k, (_, pose) in frames.items()
            if pose
        )
        p50, p95, p99 = np.percentile(late, (50, 95, 99))
        print(
            f"{kind.__name__} {fps:g} Hz: {len(frames)} of {count} came; latency {p50:.2f} ms, "
            f"p95 {p95:.2f}, p99 {p99:.2f}, most {late.max():.1f}; "
            f"work p95 {1000 * np.percentile(worked[kind], 95):.2f} ms; joints within "
            f"{1000 * worst:.4f} mm; told: {told}",
            flush=True,
        )


def demo_estimates() -> list[LiveEstimate]:
    """The demo's motion as a stream would estimate it."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        motion = recon.load_motion(path).motion
    joints = recon.BodyModel.load().pose(motion).joints
    seen = torch.ones(len(JOINTS), dtype=torch.bool)
    rows = zip(motion.translation, motion.rotations, joints, strict=True)
    return [LiveEstimate(0.0, *row, motion.shape, seen, None) for row in rows]


def at_time(estimate: LiveEstimate, seconds: float) -> LiveEstimate:
    """The estimate with another time."""
    return LiveEstimate(**{**vars(estimate), "time": seconds})


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


def receive_vmc(pipe: Any, every: int = 1) -> None:
    """Receive by python-osc's server until told to end; send the time, arrival and some poses."""
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
            found.append((seconds, arrived, pose if len(found) % every == 0 else {}))

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
        until_told(pipe, server.handle_request)
    for came, packet, client in packets:
        arrived = came
        dispatcher.call_handlers_for_packet(packet, client)
    pipe.send(found)


def receive_json(pipe: Any, every: int = 1) -> None:
    """Receive JSON Live Link until told to end; send the time, arrival and some poses."""
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
            kept = pose if len(found) % every == 0 else {}
            found.append((bones[0]["Time"], arrived, kept))

        until_told(pipe, receive)
    pipe.send(found)


def until_told(pipe: Any, receive: Callable[[], None]) -> None:
    """Receive packets until word comes by the pipe, and those that are there then."""
    while not pipe.poll():
        receive()
    receive()


if __name__ == "__main__":
    main()
