"""What pyproject.toml claims, for the gate: `claims.py others`, `oldest` or `lowest`.

others    the paths of the oldest and the newest Python that is claimed and found on this machine,
          without the version that runs this file
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


def others() -> list[str]:
    """Return the paths of the oldest and the newest Python besides this one."""
    found = pythons()
    return [found[m] for m in sorted({min(found), max(found)} - {sys.version_info.minor})]


print("\n".join({"others": others, "oldest": oldest, "lowest": lowest}[sys.argv[1]]()))
