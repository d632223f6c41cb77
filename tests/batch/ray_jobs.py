"""As a program: a batch on a Ray cluster of two nodes, one of which may be killed in the middle.

python -m tests.batch.ray_jobs sums MANIFEST OUT [--kill-after CLIPS]
python -m tests.batch.ray_jobs command MANIFEST OUT [options of recon batch]
"""

import sys
from pathlib import Path

from recon.batch.batch import fit_all
from recon.batch.ray_cluster import ray_cluster
from recon.batch.worklog import read_manifest
from recon.cli import run
from recon.fitting.settings import FitSettings
from tests.batch.batch_jobs import sum_one


def sums(manifest: Path, out: Path, kill_after: int | None) -> None:
    """Write sums, on two nodes of one processor each."""
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    # before there is another node: whoever joins is a part of one, and dies with it
    ray.init(address=cluster.address, logging_level="ERROR", log_to_driver=False)
    second = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    with ray_cluster(cluster.address) as (cpus, run_there):
        assert cpus == 2
        clips = read_manifest(manifest)
        records = fit_all(
            clips, out, FitSettings(), cpus, out / "log.jsonl", sum_one, run=run_there
        )  # fmt: skip
        for count, record in enumerate(records, 1):
            said(f"{record['id']} {record['status']} {record.get('error', '')}")
            if count == kill_after:
                cluster.remove_node(second, allow_graceful=False)
                said("killed a node")
        said(f"nodes alive: {sum(node['Alive'] for node in ray.nodes())}")
    ray.shutdown()
    cluster.shutdown()


def said(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    kind, manifest, out, *rest = sys.argv[1:]
    if kind == "command":
        sys.exit(run(["batch", manifest, "--out", out, "--prior", "pose", *rest]))
    sums(Path(manifest), Path(out), int(rest[1]) if rest else None)
