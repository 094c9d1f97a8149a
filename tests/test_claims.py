"""What pyproject.toml claims is what the gate runs: Pythons and lowest versions."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

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


def test_the_oldest_and_the_newest_python_are_those_of_the_first_and_last_claim():
    """The newest is named where another one runs this; both are claimed."""
    claimed = re.findall(r"3\.(\d+)", PROJECT["requires-python"])
    minors = {}
    for what in ("oldest", "newest"):
        for path in claims(what):
            output = subprocess.run([path, "-V"], capture_output=True, text=True, check=True).stdout
            minors[what] = int(re.match(r"Python 3\.(\d+)", output)[1])
    assert int(claimed[0]) <= minors["oldest"] <= sys.version_info.minor
    assert sys.version_info.minor < minors.get("newest", 99)
    assert minors.get("newest", 0) < int(claimed[1])
    installed = Path.home().glob(".pyenv/versions/3.*/bin/python3.*")
    numbers = [int(found[1]) for path in installed if (found := re.search(r"3\.(\d+)$", path.name))]
    later = [minor for minor in numbers if sys.version_info.minor < minor < int(claimed[1])]
    assert minors.get("newest", 0) >= max(later, default=0)


def test_the_tests_where_a_version_shows_are_there():
    """A file that is gone would end the gate after minutes."""
    gate = (ROOT / ".ci" / "run").read_text()
    named = re.findall(r"^(?:PYTHONS|VERSIONS)=\(.*?\)$", gate, flags=re.DOTALL | re.MULTILINE)
    lists = "\n".join((*named, 'printf "%s\\n" "${PYTHONS[@]}" "${VERSIONS[@]}"'))
    expanded = subprocess.run(
        ["bash", "-c", lists],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert len(named) == 2
    assert len(expanded) > 20
    assert [name for name in expanded if not (ROOT / name).is_file()] == []
