"""A stream over a socket: moments as lines of JSON in, estimates as lines of JSON out.

    python examples/11_socket.py

The lines are those of `recon stream`, which reads stdin: one JSON object with `points` and `time`
per moment. Here one thread stands for the capture system and the other serves it.
"""

import json
import socket
import threading
from importlib import resources

import numpy as np

import recon
from recon.live.lines import stream_lines

FPS, MOMENTS = 30.0, 45


def serve(server: socket.socket, template: recon.Joints3D) -> None:
    """Answer one connection: every estimate is sent as soon as it is final."""
    connection, _ = server.accept()
    stream = recon.Stream(lag=5, template=template)
    with (
        connection,
        connection.makefile("r", encoding="utf-8") as moments,
        connection.makefile("w", encoding="utf-8") as estimates,
    ):
        for line in stream_lines(moments, stream, complain=print):
            estimates.write(line + "\n")
            estimates.flush()


def main() -> None:
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.window(0, MOMENTS)
    joints = recon.BodyModel.load().pose(truth).joints.numpy()
    template = recon.Joints3D(joints[:1], np.ones((1, 22), dtype=bool), range(22), FPS)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, args=(server, template))
        thread.start()
        with socket.create_connection(server.getsockname()) as client:
            for number, moment in enumerate(joints):
                line = {"time": number / FPS, "points": moment.tolist()}
                client.sendall(json.dumps(line).encode() + b"\n")
            client.shutdown(socket.SHUT_WR)
            with client.makefile(encoding="utf-8") as answers:
                for answer in answers:
                    estimate = json.loads(answer)
                    if round(estimate["time"] * FPS) % 15 == 0:
                        print(f"{estimate['time']:.2f} s: pelvis at {estimate['joints'][0]}")
        thread.join()


if __name__ == "__main__":
    main()
