"""Checks deploy/kubernetes.yaml by its schemas, and runs the Slurm job of docs/cluster.md."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import hullcast
from hullcast._serve import find_binary

kubernetes_validate = pytest.importorskip("kubernetes_validate")
yaml = pytest.importorskip("yaml")

FILE = Path(__file__).resolve().parents[3] / "deploy/kubernetes.yaml"
MANIFESTS = list(yaml.safe_load_all(FILE.read_text()))
KINDS = {manifest["kind"]: manifest for manifest in MANIFESTS}


@pytest.mark.parametrize("version", ["1.31", "1.37"])
def test_every_manifest_is_of_its_schema(version: str):
    """Catches a misspelt or misplaced field, which Kubernetes drops without a message."""
    for manifest in MANIFESTS:
        kubernetes_validate.validate(manifest, version, strict=True)
    misspelt = KINDS["PodDisruptionBudget"] | {"spec": {"maxUnavailabel": 1}}
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(misspelt, version, strict=True)
    assert len(MANIFESTS) == len(KINDS) == 4


def test_the_parts_fit_together():
    """Catches a port, label or name that one manifest refers to and another does not define."""
    deployment, service = KINDS["Deployment"], KINDS["Service"]
    pod = deployment["spec"]["template"]
    labels = pod["metadata"]["labels"]
    selectors = [deployment["spec"]["selector"]["matchLabels"], service["spec"]["selector"]]
    selectors.append(KINDS["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"])
    assert selectors == [labels] * 3
    (container,) = pod["spec"]["containers"]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    probes = [container[f"{kind}Probe"]["httpGet"] for kind in ("startup", "readiness", "liveness")]
    assert {probe["port"] for probe in probes} <= ports.keys()
    assert service["spec"]["ports"][0]["targetPort"] in ports
    assert service["spec"]["clusterIP"] == "None"
    environment = {entry["name"]: entry.get("value") for entry in container["env"]}
    assert environment["HULLCAST_LISTEN"].endswith(f":{ports['grpc']}")
    assert environment["HULLCAST_ADMIN_LISTEN"].endswith(f":{ports['admin']}")
    target = KINDS["HorizontalPodAutoscaler"]["spec"]["scaleTargetRef"]
    assert (target["kind"], target["name"]) == ("Deployment", deployment["metadata"]["name"])
    ends = float(environment["HULLCAST_GRACE_SECONDS"]) + float(
        environment["HULLCAST_DRAIN_SECONDS"]
    )
    ends += container["lifecycle"]["preStop"]["sleep"]["seconds"]
    assert pod["spec"]["terminationGracePeriodSeconds"] > ends


def test_the_server_knows_every_setting():
    """Catches a variable that the server ignores because its name is wrong."""
    (container,) = KINDS["Deployment"]["spec"]["template"]["spec"]["containers"]
    environment = {
        entry["name"]: entry.get("value", "4")
        for entry in container["env"]
        if entry["name"].startswith("HULLCAST_")
    }
    command = [find_binary(), *container["args"], "--print-config"]
    printed = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert len(environment) == 9
    for name, value in environment.items():
        key = name.removeprefix("HULLCAST_").lower()
        (line,) = [text for text in printed.stdout.splitlines() if text.startswith(f"{key} = ")]
        assert value in line, line


SIMULATE = """
import os, sys, hullcast
with hullcast.connect(os.environ["HULLCAST_TARGET"]) as client:
    hulls = client.register([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]])
    print("registered", hulls[0].id.hex())
"""


def test_the_slurm_job_runs(tmp_path: Path):
    """Runs the page's script with one node.

    Catches a job that is refused, that never finds its server, or that leaves its server running.
    """
    page = (FILE.parents[1] / "docs/cluster.md").read_text()
    (script,) = re.findall(r"```bash\n(#!/bin/bash\n#SBATCH.*?)```", page, re.DOTALL)
    commands = tmp_path / "bin"
    commands.mkdir()
    (commands / "hullcast").symlink_to(Path(find_binary()).resolve())
    (commands / "srun").write_text('#!/bin/sh\nexec "$@"\n')
    (commands / "srun").chmod(0o755)
    (tmp_path / "simulate.py").write_text(SIMULATE)
    (tmp_path / "job").write_text(script)
    environment = os.environ | {
        "PATH": f"{commands}:{Path(sys.executable).parent}:{os.environ['PATH']}",
        "SLURM_SUBMIT_DIR": str(tmp_path),
        "PYTHONPATH": str(Path(hullcast.__file__).parents[1]),
        "TMPDIR": str(tmp_path),
    }
    environment.pop("HULLCAST_LISTEN", None)
    done = subprocess.run(
        ["bash", "job"], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60
    )
    expected = hullcast.hull_id([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]).hex()
    assert f"registered {expected}" in done.stdout, done.stderr
    (blob,) = (tmp_path / "hulls").glob("*/*")
    assert blob.name == expected
    (scratch,) = tmp_path.glob("tmp.*")
    assert not hullcast_runs(scratch / "hullcast")


def hullcast_runs(socket: Path) -> bool:
    """Whether a process that was started with this socket is still running."""
    lines = [p.read_bytes() for p in Path("/proc").glob("[0-9]*/cmdline") if p.exists()]
    return any(f"unix:{socket}".encode() in line for line in lines)
