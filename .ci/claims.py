"""What pyproject.toml claims, for the gate: `claims.py newest`, `oldest` or `lowest`.

newest    the path of the newest Python that is claimed and found on this machine, or nothing
          where that is the version that runs this file
oldest    the path of the oldest
lowest    a constraints file for pip: every lower bound as the version to install
"""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]


def lowest() -> list[str]:
    """Return `name==bound` for every requirement, those of the tests included."""
    requirements = PROJECT["dependencies"] + PROJECT["optional-dependencies"]["test"]
    return [re.sub(r">=([\d.]+).*", r"==\1", requirement) for requirement in requirements]


def pythons() -> dict[int, str]:
    """Return the Pythons on the path or installed by pyenv, by minor version, the oldest first."""
    first, beyond = re.findall(r"3\.(\d+)", PROJECT["requires-python"])
    found = {}
    for minor in range(int(first), int(beyond)):
        name = f"python3.{minor}"
        installed = sorted(Path.home().glob(f".pyenv/versions/3.{minor}.*/bin/{name}"))
        usable = filter(_makes_environments, (shutil.which(name), *map(str, installed)))
        path = next(usable, None)
        if path is not None:
            found[minor] = path
    return found


def _makes_environments(path: str | None) -> bool:
    """Tell whether a Python runs: the path may hold a stand-in for one that is switched off."""
    command = [path, "-c", "import ensurepip"]
    return path is not None and not subprocess.run(command, capture_output=True).returncode


def oldest() -> list[str]:
    """Return the path of the oldest Python."""
    return list(pythons().values())[:1]


def newest() -> list[str]:
    """Return the path of the newest Python, unless it runs this file."""
    found = pythons()
    return [found[minor] for minor in {max(found)} - {sys.version_info.minor}]


print("\n".join({"newest": newest, "oldest": oldest, "lowest": lowest}[sys.argv[1]]()))
