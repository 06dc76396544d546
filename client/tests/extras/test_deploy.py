"""Checks deploy/kubernetes.yaml by its schemas."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

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
