"""The one list of blocks and commands of the pages that no test runs as they stand, with the reasons.

`test_blocks.py` fails on a block that is neither run nor listed here, and on an entry that matches
no block.
"""

from __future__ import annotations

from blocks import Block

#: A page, a text that the block contains, and the reason.
BLOCKS = [
    ("ARCHITECTURE.md", "main -> cli", "a picture of which module uses which"),
    ("docs/budget.md", "8.3 MiB", "a sum"),
    ("docs/budget.md", "max_memory_bytes + cache_bytes", "a formula"),
    ("docs/cluster.md", "seriesQuery", "needs Kubernetes and a Prometheus adapter; the metrics in it are checked"),
    ("docs/cluster.md", "#SBATCH", "needs Slurm; test_deploy_files.py runs it with a stand-in for srun"),
    ("docs/cluster.md", "subset=3", "needs a list of running servers: test_subset.py connects to such"),
    ("docs/records.md", "message Entry", "a format: the tests of src/record read and write such files"),
    ("docs/identity.md", '"name": "tetrahedron"', "data: test_identity.py and the clients in other languages hold it"),
    ("docs/languages.md", "falsified cases noticed", "output of `make test-languages`, which has times in it"),
    ("docs/languages.md", "cd examples/go", "`make test-languages` does the same; test_blocks.py compares"),
    ("docs/workload.md", "u32 families", "a format: crates/contact/tests/workload reads such a file"),
    ("tests/golden/README.md", "hullcast.golden.v1", "a format: test_golden.py reads such a file"),
    ("docs/python/workers.md", "@ray.remote", "needs ray: test_pages_of_extras.py runs it"),
]  # fmt: skip

#: Programs that are not run. `test_commands.py` checks that the targets, files, flags, packages,
#: features and tests exist that their commands name.
PROGRAMS = {
    "make": "each target is minutes of work of its own; `.ci/run` runs test, test-languages and lint",
    "pip": "test_wheel.py and test_pages_of_extras.py install so into empty environments",
    "cargo": "compiles for minutes",
    "lab": "measures for minutes: `make tradeoff` and `make planarity`",
    "python": "measures for minutes, or writes files of the repository",
    "scripts/": "measures for minutes, or writes files of the repository",
    "apt-get": "changes the machine; scripts/check-tools and scripts/test-languages name the same packages",
    "git": "changes the clone",
    "grpcurl": "test_tools.py runs the page (`make test-tools`)",
    "ghz": "test_tools.py runs the page (`make test-tools`)",
    "helm": "needs a cluster; test_deploy.py writes and checks the manifests (`make test-deploy`)",
    "kill": "needs a process that is to be killed",
    "systemctl": "needs a system that runs systemd",
    "xacro": "a program of ROS, which is not on every machine",
}

#: Commands of hullcast that are only checked: a text in the command, and the reason.
COMMANDS = {
    "serve --playground": "needs a build with the feature playground: `make test-playground` starts it so",
}

#: Statements of client/README.md, and the package without which they are left out.
STATEMENTS = {"m.log()": "rerun"}


def reason(block: Block) -> str | None:
    """Why no test runs a block as it stands; None if a test has to."""
    for page, text, why in BLOCKS:
        if block.page == page and text in block.text:
            return why
    return None
