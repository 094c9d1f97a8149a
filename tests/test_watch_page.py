"""The page on watching runs as it is written."""

import re
import shlex
import signal
import subprocess
import sys

import pytest
from helpers import ROOT

pytest.importorskip("starlette", reason="needs the extra watch")
pytest.importorskip("uvicorn", reason="needs the extra watch")

from watching import BEGUN, Client, until

PAGE = (ROOT / "docs" / "watch.md").read_text()
COMMANDS = "".join(re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)).splitlines()


@pytest.mark.slow
@pytest.mark.parametrize("line", COMMANDS)
def test_commands_of_the_page(line):
    """Each serves the state of the shipped recording until Ctrl-C."""
    name, verb, *words = shlex.split(line)
    assert (name, verb) == ("handlaser", "watch")
    process = subprocess.Popen(
        [sys.executable, "-c", BEGUN, verb, *words],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    said = process.stdout.readline()
    port = int(re.fullmatch(r"watching \S+ at http://127\.0\.0\.1:(\d+)/\n", said)[1])
    client = Client(port)
    try:
        until(lambda: client.counted("stations") == 44)
        assert client.sent.opening == "Usable"
    finally:
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
        client.close()
    assert (process.returncode, err) == (130, "handlaser: stopped by Ctrl-C\n")


def test_the_numbers_of_the_page_are_those_of_the_program():
    from handlaser_gtsam.files.watch import server, watched

    assert f"port {server.PORT}, or any" in PAGE
    assert f"above {watched.LARGEST_FILE // 1_000_000} MB is refused" in PAGE
