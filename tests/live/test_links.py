"""Live links: what receivers rebuild, what is said of missing estimates, and bad addresses."""

import io
import json
import socket
import sys
import threading
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import Pipe

import numpy as np
import pytest
import torch

import recon
from recon import cli
from recon.core import rotations as so3
from recon.core.skeleton import JOINTS, joint_index
from recon.core.units import to_z_up
from recon.formats.observations import PositionsFile, save_observation
from recon.live.links import LiveLink, VmcLink
from recon.live.tracking import LiveEstimate
from tests.filmed import bundled, walk
from tests.live.conftest import FPS, stream
from tests.live.receivers import demo_estimates, rebuilt, receive_json, receive_vmc

RECEIVERS = {VmcLink: receive_vmc, LiveLink: receive_json}


@pytest.fixture(params=[VmcLink, LiveLink])
def kind(request) -> type:
    if request.param is VmcLink:
        pytest.importorskip("pythonosc")
    return request.param


@contextmanager
def received(kind: type):
    """A link to a receiver in a thread; what it got is in the list when the block ends."""
    mine, theirs = Pipe()
    thread = threading.Thread(target=RECEIVERS[kind], args=(theirs,))
    thread.start()
    found: list = []
    with kind(str(mine.recv())) as link:
        yield link, found
    mine.send("end")
    found += mine.recv()
    thread.join()


def test_receivers_rebuild_every_pose(kind):
    estimates = [replace(one, time=k / 30) for k, one in enumerate(demo_estimates()[:40])]
    with received(kind) as (link, found):
        for one in estimates:
            link.send(one)
    assert [seconds for seconds, *_ in found] == pytest.approx([one.time for one in estimates])
    for (_, _, pose), one in zip(found, estimates, strict=True):
        assert np.abs(rebuilt(kind, pose) - one.joints.numpy()).max() < 1e-4


def t_pose(**turned: torch.Tensor) -> LiveEstimate:
    """The body at rest, upright, facing -y, with some joints turned."""
    body = bundled()
    rotations = torch.eye(3).repeat(22, 1, 1)
    rotations[0] = torch.from_numpy(to_z_up("y")).float()
    for joint, rotation in turned.items():
        rotations[joint_index(joint)] = rotation
    motion = walk(1)
    zero, shape = torch.zeros(1, 3), torch.zeros_like(motion.shape)
    motion = replace(motion, translation=zero, rotations=rotations[None], shape=shape)
    joints = body.pose(motion).joints[0]
    seen = torch.ones(22, dtype=torch.bool)
    return LiveEstimate(1.5, zero[0], rotations, joints, shape, seen, None)


def test_the_axes_are_theirs(kind):
    """Unity: y up, facing z, the left is -x. Unreal: z up, facing y, the left is +x; cm."""
    forward = so3.exp(torch.tensor([0.0, -torch.pi / 2, 0.0]))
    with received(kind) as (link, found):
        link.send(t_pose())
        link.send(t_pose(left_shoulder=forward))
    names = {VmcLink: ("Hips", "LeftUpperArm", "LeftHand", "LeftLowerArm"),
             LiveLink: ("pelvis", "upperarm_l", "hand_l", "lowerarm_l")}[kind]  # fmt: skip
    (_, _, rest), (_, _, pointing) = found
    turns = np.array([row[3:] for row in rest.values()])
    assert np.abs(turns - np.sign(turns[:, 3:]) * [0, 0, 0, 1]).max() < 1e-6
    left = -1 if kind is VmcLink else 1
    metre = 1 if kind is VmcLink else 100
    assert left * rest[names[2]][0] > 0.2 * metre  # along the arm
    # a quarter turn about up carries the arm forward
    up, ahead = (1, 2) if kind is VmcLink else (2, 1)
    x, y, z, w = pointing[names[1]][3:]
    assert abs((x, y, z)[up]) == pytest.approx(0.5**0.5, abs=1e-5)
    assert pointing[names[2]] == pytest.approx(rest[names[2]], abs=1e-4 * metre)
    places = [np.array(row) for row in ((x, y, z), pointing[names[3]][:3])]
    turned = places[1] + 2 * np.cross(places[0], np.cross(places[0], places[1]) + w * places[1])
    assert turned[ahead] > 0.2 * metre


def test_times_of_gaps_are_kept(kind, seen):
    times = [k / FPS for k in range(30) if k not in (17, 18)]
    with received(kind) as (link, found):
        live = stream(lag=3)
        estimates = [live.push(seen[round(t * FPS)], t) for t in times]
        for one in (*estimates, *live.finish()):
            link.send(one)
    assert [one[0] for one in found] == pytest.approx([k / FPS for k in range(30)], abs=1e-6)


def packets_of(kind: type, *sent: LiveEstimate | None) -> list[bytes]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(0.2)
        with kind(str(server.getsockname()[1])) as link:
            for one in sent:
                link.send(one)
        packets = []
        try:
            while True:
                packets.append(server.recv(1 << 16))
        except TimeoutError:
            return packets


def test_vmc_says_that_nobody_is_tracked():
    packet_of = pytest.importorskip("pythonosc.osc_packet").OscPacket
    estimate = t_pose()
    hidden = replace(estimate, observed=torch.zeros(22, dtype=torch.bool))
    states, bones = [], 0
    for packet in packets_of(VmcLink, estimate, hidden, None):
        assert len(packet) < 1_400
        for one in packet_of(packet).messages:
            bones += one.message.address == "/VMC/Ext/Bone/Pos"
            if one.message.address == "/VMC/Ext/OK":
                states.append(one.message.params)
            if one.message.address == "/VMC/Ext/Root/Pos":
                assert one.message.params == ["root", 0, 0, 0, 0, 0, 0, 1]
    assert states == [[1, 3, 0, 1], [1, 3, 0, 0], [1, 3, 0, 0]]
    assert bones == 44


def test_live_link_sends_what_the_plugin_reads():
    (packet,) = packets_of(LiveLink, None, t_pose())
    told = json.loads(packet.decode("ascii"))
    assert list(told) == ["recon"]
    bones = told["recon"]
    assert [bone["Parent"] for bone in bones[:4]] == [-1, 0, 1, 1]
    assert bones[0]["Name"] == "root"
    assert bones[0]["Time"] == 1.5
    for number, bone in enumerate(bones):
        assert bone["Parent"] < number
        assert (len(bone["Location"]), len(bone["Rotation"]), len(bone["Scale"])) == (3, 4, 3)


def test_a_receiver_that_begins_later_is_sent_to(kind):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    told: list[str] = []
    with (
        kind(f"127.0.0.1:{port}", complain=told.append) as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server,
    ):
        for _ in range(3):
            link.send(t_pose())
        server.bind(("127.0.0.1", port))
        server.settimeout(2)
        link.send(t_pose())
        assert server.recv(1 << 16)
    assert told == [f"127.0.0.1:{port}: nobody listens there yet; packets are sent all the same"]


def test_a_packet_that_is_too_large_is_told_once():
    told: list[str] = []
    with LiveLink("127.0.0.1:9", complain=told.append) as link:
        for _ in range(2):
            link._send_packet(bytes(70_000))
    assert len(told) == 1
    assert "a packet (70,000 bytes) was not sent" in told[0]


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("", "expected HOST:PORT"),
        ("127.0.0.1", "expected HOST:PORT"),
        ("127.0.0.1:0", "port from 1 to 65535"),
        ("127.0.0.1:70000", "port from 1 to 65535"),
        ("70000", "port from 1 to 65535"),
        ("127.0.0.1:osc", "expected HOST:PORT"),
        ("udp://127.0.0.1:5", "expected HOST:PORT"),
        ("::1:5", "expected HOST:PORT"),
        ("me@127.0.0.1:5", "expected HOST:PORT"),
        ("nobody.invalid:5", "no host is called 'nobody.invalid'"),
        (f"{'ü' * 300}:5", "no host is called"),
        ("255.255.255.255:5", "nothing can be sent there"),
    ],
)
def test_bad_addresses_are_refused(kind, address, words):
    with pytest.raises(recon.ReconError, match=words):
        kind(address)


@pytest.mark.parametrize("subject", ["", " ", "ü", "a\n", "a" * 101])
def test_subjects_that_the_plugin_cannot_read_are_refused(subject):
    with pytest.raises(recon.ReconError, match="subject: expected 1 to 100 letters"):
        LiveLink(subject=subject)


def test_without_the_library_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pythonosc.osc_message_builder", None)
    with pytest.raises(recon.ReconError, match=r"motion-recon\[live\]"):
        VmcLink()


def test_the_command_sends_what_it_prints(kind, seen, tmp_path, monkeypatch, capsys):
    template = tmp_path / "seen.npz"
    visible = np.ones((len(seen), 22), bool)
    save_observation(template, PositionsFile("joints3d", seen, visible, JOINTS, FPS))
    lines = [json.dumps({"points": row.tolist(), "time": k / FPS}) for k, row in enumerate(seen)]
    text = io.TextIOWrapper(io.BytesIO("\n".join(lines[:14]).encode()))
    monkeypatch.setattr("sys.stdin", text)
    option = {VmcLink: "--vmc", LiveLink: "--live-link"}[kind]
    with received(kind) as (link, found):
        port = link._address
        assert cli.run(["stream", str(template), "--lag", "3", option, port]) == 0
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [one["time"] for one in printed] == pytest.approx(
        [k / FPS for k in range(14)], abs=1e-5
    )
    assert [one[0] for one in found] == pytest.approx([one["time"] for one in printed], abs=1e-5)
    for one, (_, _, pose) in zip(printed, found, strict=True):
        assert np.abs(rebuilt(kind, pose) - one["joints"]).max() < 1e-4
    assert cli.run(["stream", str(template), option, "nobody.invalid:5"]) == cli.BAD_INPUT
    assert "no host is called" in capsys.readouterr().err
