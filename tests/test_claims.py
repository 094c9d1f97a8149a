"""What pyproject.toml claims is what the gate runs: Pythons and lowest versions."""

import re
import subprocess
import sys
import tomllib

from helpers import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def claims(what: str) -> list[str]:
    command = [sys.executable, ROOT / ".ci" / "claims.py", what]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


def test_every_requirement_has_a_lowest_version():
    required = PROJECT["dependencies"] + PROJECT["optional-dependencies"]["test"]
    names = [re.match(r"[\w-]+", requirement)[0] for requirement in required]
    lowest = claims("lowest")
    assert [pin.split("==")[0] for pin in lowest] == names
    assert all(re.fullmatch(r"[\w-]+==\d+(\.\d+)+", pin) for pin in lowest)


def test_the_python_that_runs_this_is_claimed():
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    claimed = [re.fullmatch(r".* :: (3\.\d+)", line) for line in PROJECT["classifiers"]]
    versions = [match[1] for match in claimed if match]
    assert version in versions
    first, last = (int(version.split(".")[1]) for version in (versions[0], versions[-1]))
    assert PROJECT["requires-python"] == f">=3.{first},<3.{last + 1}"
    assert len(versions) == last - first + 1


def test_other_pythons_are_not_the_one_that_runs_this():
    others = claims("others")
    found = [
        subprocess.run([path, "-V"], capture_output=True, text=True, check=True).stdout
        for path in others
    ]
    own = f"Python {sys.version_info.major}.{sys.version_info.minor}."
    assert len(others) <= 2
    assert not any(version.startswith(own) for version in found)
