"""Contents of a release: one version, `python -m sigmaswarm`, completion, and files for other programs."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

import sigmaswarm
from sigmaswarm.cli.app import app
from support import quickly

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_version_is_said_once():
    assert "version" not in PROJECT["project"]
    assert PROJECT["project"]["dynamic"] == ["version"]
    source = (ROOT / PROJECT["tool"]["hatch"]["version"]["path"]).read_text()
    assert re.findall(r'^__version__ = "(.*)"$', source, re.MULTILINE) == [sigmaswarm.__version__]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == sigmaswarm.__version__  # the version that papers cite
    assert re.search(
        rf"^## {re.escape(sigmaswarm.__version__)}\b", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE
    )


def test_the_module_is_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "sigmaswarm", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == sigmaswarm.__version__


@pytest.mark.parametrize(
    "shell", quickly([("bash",), ("zsh",), ("fish",), ("powershell",)], lambda shell: shell == "bash")
)
def test_completion_is_printed_and_knows_every_command(shell: str, capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    app(["--completion", shell], result_action="return_value")
    script = capsys.readouterr().out
    assert [name for name in app if not name.startswith("-") and name not in script] == []
    assert "objective" in script
    assert list(tmp_path.iterdir()) == []  # no file is written
    if shell == "bash":
        subprocess.run(["bash", "-n"], input=script, text=True, check=True)


def test_the_hosted_gate_tries_the_pythons_that_the_package_takes():
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())["jobs"]
    stated = {c.rpartition(" ")[2] for c in PROJECT["project"]["classifiers"] if " :: Python :: 3." in c}
    assert set(jobs["wheel"]["strategy"]["matrix"]["python"]) == stated
    for job in jobs.values():
        for word in " ".join(step.get("run", "") for step in job["steps"]).split():
            if "/" in word:
                assert (ROOT / word).exists(), word
