"""What the tests of `handlaser watch` share: the command as a process, and clients on real sockets."""

import contextlib
import http.client
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from html import unescape

from helpers import GRIPPER

import handlaser_gtsam as hl

BEGUN = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the shell of the tests says
from handlaser_gtsam.cli import main
main()
"""
HOSTILE_BEAMS = (
    *("<script>alert(1)</script>", "</td><img src=x onerror=alert(1)>"),
    *("%{x} $x^2$", "&lt;b&gt;"),
)
PATIENCE = 90.0
"""Seconds until a busy machine has done anything."""


def until(condition, seconds=PATIENCE):
    """Wait until a condition holds, and return what it returned."""
    end = time.monotonic() + seconds
    while True:
        found = condition()
        if found or time.monotonic() > end:
            assert found, "it did not happen"
            return found
        time.sleep(0.02)


def write_hostile(path):
    """Write the shipped recording with beams and planes that are called like programs."""
    recording = hl.read_recording(GRIPPER / "recording.csv")
    planes = {name: f"<img src=x onerror=alert('{name}')>" for name in recording.plane_names}
    labels = tuple(planes[name] for name in recording.plane_labels)
    named = replace(recording, beam_names=HOSTILE_BEAMS, plane_labels=labels)
    hl.write_recording(path, named)


@contextlib.contextmanager
def watching(*arguments):
    """Run the command; yield the process and the port."""
    process = subprocess.Popen(
        [sys.executable, "-c", BEGUN, "watch", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        line, ends = process.stdout.readline(), process.stdout.readline()
        assert ends == "Ctrl-C ends\n"
        yield process, int(re.search(r"http://\S+:(\d+)/", line)[1])
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE)


def answer(port, path="/", method="GET", **headers):
    """Ask once; return status, headers in lower case, and text."""
    asked = {name.replace("_", "-"): value for name, value in headers.items()}
    asking = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    asking.putrequest(method, path, skip_host="Host" in asked)
    for name, value in asked.items():
        asking.putheader(name, value)
    asking.endheaders()
    found = asking.getresponse()
    told = {name.lower(): value for name, value in found.getheaders()}
    text = "" if told.get("content-type", "").startswith("text/event") else found.read().decode()
    asking.close()
    return found.status, told, text


class Sent:
    """What a page was sent: messages by topic, read as a browser would."""

    def __init__(self, messages):
        self._messages = messages

    def json(self, topic):
        return json.loads(self._messages.get(topic, "null"))

    @property
    def opening(self):
        return (self.json("state") or {}).get("opening")

    def html(self, section):
        return (self.json(f"section:{section}") or {}).get("html", "")

    def words(self, section):
        """The text of a section."""
        return " ".join(unescape(re.sub(r"<[^>]*>", " ", self.html(section))).split())

    def counted(self, term):
        """A number of the first section; -1 where it is not there yet."""
        shown = re.search(rf"<dt>{term}</dt><dd>(\d+)</dd>", self.html("verdict"))
        return -1 if shown is None else int(shown[1])

    def rows(self, section, table):
        """The cells of a table, row by row."""
        own = self.html(section).partition(f'id="table-{table}"')[2].partition("</figure>")[0]
        body = own.partition("<tbody>")[2]
        return [
            [unescape(cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", row)]
            for row in re.findall(r"<tr>(.*?)</tr>", body, re.DOTALL)
        ]

    def figure(self, name):
        return (self.json(f"figure:{name}") or {}).get("figure")


class Client:
    """Looks on: keeps the newest event of every topic, and how many there were."""

    def __init__(self, port, buffer=None, begin=True):
        self.newest, self.count, self.open = {}, {}, True
        self._socket = socket.socket()
        if buffer:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        self._socket.connect(("127.0.0.1", port))
        self._socket.sendall(f"GET /events HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        self._thread = threading.Thread(target=self._read, daemon=True)
        if begin:
            self.begin()

    def begin(self):
        """Begin to read."""
        self._thread.start()

    def close(self):
        """Vanish."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        if self._thread.ident is not None:
            self._thread.join()

    @property
    def state(self):
        return json.loads(self.newest.get("state", "{}"))

    @property
    def status(self):
        return json.loads(self.newest.get("status", "{}"))

    def counted(self, term):
        """A number of what is shown."""
        return self.sent.counted(term)

    @property
    def sent(self):
        return Sent(dict(self.newest))

    def _read(self):
        with contextlib.suppress(OSError, ValueError, http.client.HTTPException):
            self._follow(http.client.HTTPResponse(self._socket))
        self.open = False

    def _follow(self, response):
        with response:
            response.begin()
            kind, data = "", []
            while line := response.readline():
                name, _, value = line.decode().rstrip("\n").partition(":")
                if name == "event":
                    kind = value.strip()
                elif name == "data":
                    data.append(value.removeprefix(" "))
                elif not name and kind:
                    text = "\n".join(data)
                    about = kind in ("section", "figure")
                    topic = f"{kind}:{json.loads(text)['name']}" if about else kind
                    self.newest[topic] = text
                    self.count[topic] = self.count.get(topic, 0) + 1
                    kind, data = "", []
