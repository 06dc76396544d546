"""Checks deploy/kubernetes.yaml, deploy/keda.yaml and the manifests of the chart by their schemas."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import trustme

import hullcast
from hullcast._serve import find_binary

kubernetes_validate = pytest.importorskip("kubernetes_validate")
jsonschema = pytest.importorskip("jsonschema")
tomllib = pytest.importorskip("tomllib")
yaml = pytest.importorskip("yaml")

ROOT = Path(__file__).resolve().parents[3]
CHART = ROOT / "deploy/chart"
SCHEMA = json.loads((CHART / "values.schema.json").read_text())
#: The schema of KEDA's resource, which `make test-deploy` takes from KEDA's Go module.
KEDA = ROOT / "out/keda.sh_scaledobjects.yaml"
CASES = ["plaintext", "secured", "trial"]
SOURCES = ["kubernetes.yaml", *CASES]
Manifest = dict[str, Any]


def helm(*arguments: str | Path, release: str = "hullcast") -> subprocess.CompletedProcess[str]:
    """Writes the manifests of the chart."""
    if not shutil.which("helm"):
        pytest.skip("no helm")
    command = ["helm", "template", release, CHART, "--namespace", "default", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@cache
def manifests(source: str) -> list[Manifest]:
    """The manifests of a file, or of the chart with one of the files in deploy/chart/ci."""
    if source.endswith(".yaml"):
        return list(yaml.safe_load_all((ROOT / "deploy" / source).read_text()))
    done = helm("--values", CHART / f"ci/{source}-values.yaml")
    assert done.returncode == 0, done.stderr
    return [manifest for manifest in yaml.safe_load_all(done.stdout) if manifest]


def kinds(source: str) -> dict[str, Manifest]:
    found = {manifest["kind"]: manifest for manifest in manifests(source)}
    assert len(found) == len(manifests(source))
    return found


def container(source: str) -> Manifest:
    (found,) = kinds(source)["Deployment"]["spec"]["template"]["spec"]["containers"]
    return found


def variables(source: str) -> dict[str, str]:
    """The environment of the server. The downward API gives the CPU limit of the container."""
    return {entry["name"]: entry.get("value", "4") for entry in container(source)["env"]}


@pytest.mark.parametrize("version", ["1.31", "1.37"])
@pytest.mark.parametrize("source", SOURCES)
def test_every_manifest_is_of_its_schema(source: str, version: str):
    """Catches a misspelt or misplaced field, which Kubernetes drops without a message."""
    for manifest in manifests(source):
        if manifest["kind"] != "ScaledObject":
            kubernetes_validate.validate(manifest, version, strict=True)
    misspelt = kinds(source)["PodDisruptionBudget"] | {"spec": {"maxUnavailabel": 1}}
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(misspelt, version, strict=True)
    expected = {"Deployment", "PodDisruptionBudget", "Service"}
    scaler = {"secured": {"ScaledObject"}, "trial": set()}.get(source, {"HorizontalPodAutoscaler"})
    configuration = set() if source == "kubernetes.yaml" else {"ConfigMap"}
    assert kinds(source).keys() == expected | scaler | configuration


def strict(schema: Any) -> Any:
    """The schema, but with every field refused that it does not name."""
    if isinstance(schema, list):
        return [strict(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    schema = {key: strict(value) for key, value in schema.items()}
    if "properties" in schema and "x-kubernetes-preserve-unknown-fields" not in schema:
        schema.setdefault("additionalProperties", False)
    return schema


@pytest.mark.parametrize("source", ["keda.yaml", "secured"])
def test_the_scaled_object_is_of_its_schema(source: str):
    """Catches a field that KEDA does not have, with which the number of replicas would never change."""
    if not KEDA.exists():
        pytest.skip("no schema of KEDA")
    (version,) = yaml.safe_load(KEDA.read_text())["spec"]["versions"]
    schema = strict(version["schema"]["openAPIV3Schema"])
    schema["properties"]["metadata"] = {"type": "object"}
    scaler = kinds(source)["ScaledObject"]
    assert scaler["apiVersion"] == f"keda.sh/{version['name']}"
    jsonschema.validate(scaler, schema)
    misspelt = json.loads(json.dumps(scaler).replace("pollingInterval", "pollInterval"))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(misspelt, schema)


@pytest.mark.parametrize("source", SOURCES)
def test_the_parts_fit_together(source: str):
    """Catches a port, label or name that one manifest refers to and another does not define."""
    deployment, service = kinds(source)["Deployment"], kinds(source)["Service"]
    pod = deployment["spec"]["template"]
    labels = pod["metadata"]["labels"]
    selectors = [deployment["spec"]["selector"]["matchLabels"], service["spec"]["selector"]]
    selectors.append(kinds(source)["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"])
    (spread,) = pod["spec"]["topologySpreadConstraints"]
    selectors.append(spread["labelSelector"]["matchLabels"])
    assert selectors == [labels] * 4
    ports = {port["name"]: port["containerPort"] for port in container(source)["ports"]}
    probes = [
        container(source)[f"{kind}Probe"]["httpGet"]
        for kind in ("startup", "readiness", "liveness")
    ]
    assert {probe["port"] for probe in probes} <= ports.keys()
    assert pod["metadata"]["annotations"]["prometheus.io/port"] == str(ports["admin"])
    assert service["spec"]["ports"][0]["targetPort"] in ports
    assert service["spec"]["clusterIP"] == "None"
    environment = variables(source)
    assert environment["HULLCAST_LISTEN"].endswith(f":{ports['grpc']}")
    assert environment["HULLCAST_ADMIN_LISTEN"].endswith(f":{ports['admin']}")
    for scaler in kinds(source).keys() & {"HorizontalPodAutoscaler", "ScaledObject"}:
        target = kinds(source)[scaler]["spec"]["scaleTargetRef"]
        assert (target["kind"], target["name"]) == ("Deployment", deployment["metadata"]["name"])
    mounted = {mount["name"] for mount in container(source).get("volumeMounts", [])}
    assert mounted == {volume["name"] for volume in pod["spec"].get("volumes", [])}


@pytest.mark.parametrize("source", SOURCES)
def test_the_server_accepts_every_setting(source: str, tmp_path: Path):
    """Catches a variable that the server ignores because its name is wrong, a key or value of the file
    that it refuses, and a pod that is killed while it drains."""
    environment = variables(source)
    arguments = container(source)["args"]
    if "ConfigMap" in kinds(source):
        text = kinds(source)["ConfigMap"]["data"]["hullcast.toml"]
        mounted = kinds(source)["Deployment"]["spec"]["template"]["spec"]["volumes"]
        secrets = [volume["name"] for volume in mounted if "secret" in volume]
        assert secrets == {"secured": ["tls", "tokens"]}.get(source, [])
        write_secrets(tmp_path)
        (tmp_path / "hullcast.toml").write_text(text.replace("/etc/hullcast", str(tmp_path)))
        arguments = [argument.replace("/etc/hullcast", str(tmp_path)) for argument in arguments]
    command = [find_binary(), *arguments, "--print-config"]
    printed = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert printed.returncode == 0, printed.stderr
    known = tomllib.loads(printed.stdout)
    own = {name: value for name, value in environment.items() if name.startswith("HULLCAST_")}
    assert len(own) == (9 if source == "kubernetes.yaml" else 4)
    for name, value in own.items():
        assert means(value, known[name.removeprefix("HULLCAST_").lower()]), name
    assert known["allow_plaintext"] == (source != "secured")
    if source == "secured":
        assert known["tls_client_ca"] == f"{tmp_path}/tls/ca.crt"
        assert known["register_tokens"] == f"{tmp_path}/tokens/register"
        assert (known["max_points_per_hull"], known["answer_seconds"]) == (100_000, 12.5)
        assert known["max_message_bytes"] == 16 << 20
        assert known["max_memory_bytes"] == "50%"
        assert known["cache_bytes"] == "25%"
    ends = known["grace_seconds"] + known["drain_seconds"]
    ends += container(source)["lifecycle"]["preStop"]["sleep"]["seconds"]
    pod = kinds(source)["Deployment"]["spec"]["template"]["spec"]
    assert pod["terminationGracePeriodSeconds"] > ends


def means(text: str, setting: Any) -> bool:
    """Whether the text of a variable is this value of a setting."""
    if isinstance(setting, list):
        return setting == [text]
    if isinstance(setting, bool):
        return text == str(setting).lower()
    return float(text) == setting if isinstance(setting, (int, float)) else text == setting


def write_secrets(folder: Path) -> None:
    """The files of the secrets in deploy/chart/ci/secured-values.yaml, as Kubernetes mounts them."""
    authority = trustme.CA()
    certificate = authority.issue_cert("hullcast")
    (folder / "tls").mkdir()
    certificate.cert_chain_pems[0].write_to_path(folder / "tls/tls.crt")
    certificate.private_key_pem.write_to_path(folder / "tls/tls.key")
    authority.cert_pem.write_to_path(folder / "tls/ca.crt")
    (folder / "tokens").mkdir()
    for name in ("query", "register"):
        (folder / "tokens" / name).write_text(f"worker: {name}-token\n")


def test_the_chart_is_the_manifests():
    """Catches a correction of deploy/kubernetes.yaml or deploy/keda.yaml that the chart lacks."""
    ours = container("kubernetes.yaml")
    for part in (
        "startupProbe",
        "readinessProbe",
        "livenessProbe",
        "lifecycle",
        "securityContext",
        "resources",
        "ports",
    ):
        assert container("plaintext")[part] == ours[part], part
    pods = [
        kinds(source)["Deployment"]["spec"]["template"]["spec"]
        for source in ("plaintext", "kubernetes.yaml")
    ]
    assert pods[0]["terminationGracePeriodSeconds"] == pods[1]["terminationGracePeriodSeconds"]
    scalers = [
        kinds(source)["HorizontalPodAutoscaler"]["spec"]
        for source in ("plaintext", "kubernetes.yaml")
    ]
    assert scalers[0] == scalers[1]
    assert kinds("secured")["ScaledObject"]["spec"] == kinds("keda.yaml")["ScaledObject"]["spec"]
    names = {entry["name"]: entry.get("value") for entry in ours["env"]}
    settings = tomllib.loads(kinds("plaintext")["ConfigMap"]["data"]["hullcast.toml"])
    for key in ("grace_seconds", "drain_seconds", "max_connection_age_seconds", "log_format"):
        assert str(settings[key]) == names[f"HULLCAST_{key.upper()}"], key


@pytest.mark.parametrize("source", ["kubernetes.yaml", "keda.yaml", "secured"])
def test_the_autoscaler_asks_for_metrics_that_exist(source: str):
    """Catches a renamed metric, after which the number of replicas would never change."""
    text = json.dumps(manifests(source))
    asked = set(re.findall(r"hullcast_queue_seconds_\w+", text)) - {"hullcast_queue_seconds_mean"}
    source_of_mean = (ROOT / "docs/cluster.md").read_text()
    assert asked or "as: hullcast_queue_seconds_mean" in source_of_mean
    known = re.findall(r'histogram\("(\w+)"', (ROOT / "src/metrics.rs").read_text())
    assert "queue_seconds" in known
    assert asked <= {"hullcast_queue_seconds_sum", "hullcast_queue_seconds_count"}


def test_the_schema_has_the_servers_settings():
    """Catches a setting that was added to the server or removed from it, and not in the schema."""
    printed = subprocess.run(
        [find_binary(), "serve", "--print-config"],
        env={},
        capture_output=True,
        text=True,
        check=True,
    )
    of_the_chart = {
        "listen", "admin_listen", "store", "compute_threads", "tls_certificate", "tls_key", "tls_client_ca",
        "allow_plaintext", "query_tokens", "register_tokens", "max_memory_bytes", "cache_bytes", "grace_seconds",
        "drain_seconds", "max_connection_age_seconds",
    }  # fmt: skip
    known = set(tomllib.loads(printed.stdout))
    assert of_the_chart < known
    assert set(SCHEMA["properties"]["settings"]["properties"]) == known - of_the_chart


def test_the_schema_has_every_value():
    """Catches a value that the schema refuses or does not describe."""
    values = yaml.safe_load((CHART / "values.yaml").read_text())
    jsonschema.validate(values, SCHEMA)
    assert SCHEMA["properties"].keys() == values.keys() | {"global"}
    for name, value in values.items():
        if SCHEMA["properties"][name].get("properties") and name != "settings":
            assert SCHEMA["properties"][name]["properties"].keys() == value.keys(), name


@pytest.mark.parametrize(
    ("assignment", "said"),
    [
        ("resources.memory=4GB", "at '/resources/memory': '4GB' does not match pattern"),
        ("resources.cpu=0.5", "at '/resources/cpu': got string, want integer"),
        ("settings.max_pairs_per_requests=1", "at '/settings': additional properties 'max_pairs_per_requests'"),
        ("settings.max_pairs_per_request=0", "at '/settings/max_pairs_per_request': minimum: got 0, want 1"),
        ("settings.max_message_bytes=16MB", "at '/settings/max_message_bytes'"),
        ("settings.store=memory://", "at '/settings': additional properties 'store'"),
        ("store.url=s3:/hulls", "at '/store/url'"),
        ("store.environment.HULLCAST_LOG=debug", "at '/store/environment/HULLCAST_LOG'"),
        ("tls.secrets=certificates", "at '/tls': additional properties 'secrets' not allowed"),
        ("autoscaling.kind=kedo", "at '/autoscaling/kind': value must be one of 'hpa', 'keda', 'none'"),
        ("budgets.memory=0", "at '/budgets/memory': minimum: got 0, want 1"),
        ("service.port=80", "at '/service/port': minimum: got 80, want 1024"),
        ("times.drainSeconds=-1", "at '/times/drainSeconds': minimum"),
        ("tls.allowPlaintext=false", "tls.secret is empty: give the name of a secret"),
        ("tls.secret=certificates", 'tls.secret is "certificates" and tls.allowPlaintext is true'),
        ("tls.clientCertificates=true", "tls.clientCertificates is true, and tls.secret is empty"),
        ("budgets.memory=60", "leave 204 MiB of resources.memory (4Gi): the process itself needs 256 MiB"),
        ("resources.memory=1Gi", "leave 153 MiB of resources.memory (1Gi): the process itself needs 256 MiB"),
        ("resources.memory=1Gi,budgets.cache=25", "is 512 MiB of resources.memory (1Gi): with the default limits the server needs 929 MiB"),
        ("autoscaling.minReplicas=31", "autoscaling.minReplicas (31) is more than autoscaling.maxReplicas (30)"),
        ("autoscaling.kind=keda", "autoscaling.kind is keda, and autoscaling.prometheus is empty"),
        ("service.adminPort=50051", "service.port and service.adminPort are both 50051"),
        ("tokens.secret=lists,tokens.query=,tokens.register=", "tokens.query and tokens.register are empty"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_refused_by_its_name(assignment: str, said: str):
    """Catches a value that is ignored, or that only a pod which never starts would show."""
    done = helm("--set", "tls.allowPlaintext=true", "--set", assignment)
    assert done.returncode != 0
    assert said in done.stderr.replace("1,024", "1024")


def test_names_and_versions():
    """Catches a release whose manifests have the names of another, and a chart of another version."""
    done = helm("--set", "tls.allowPlaintext=true", release="blue")
    assert done.returncode == 0, done.stderr
    found = [
        manifest["metadata"]["name"] for manifest in yaml.safe_load_all(done.stdout) if manifest
    ]
    assert set(found) == {"blue-hullcast"}
    assert f'image: "hullcast:{hullcast.__version__}"' in done.stdout
    chart = yaml.safe_load((CHART / "Chart.yaml").read_text())
    assert (chart["version"], chart["appVersion"]) == (hullcast.__version__,) * 2


@pytest.mark.parametrize("case", CASES)
def test_helm_finds_no_fault(case: str):
    """Catches a chart that helm itself warns of, and a case that is in no list of this file."""
    if not shutil.which("helm"):
        pytest.skip("no helm")
    assert {path.name for path in (CHART / "ci").iterdir()} == {
        f"{name}-values.yaml" for name in CASES
    }
    command = ["helm", "lint", "--strict", CHART, "--values", CHART / f"ci/{case}-values.yaml"]
    done = subprocess.run(
        command, env=os.environ, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stdout
