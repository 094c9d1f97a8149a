"""The page that follows a recording: who may ask, who looks on, and what the file may do meanwhile.

Clients are sockets with a parser of their own. Skipped without the extra `watch`.
"""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from helpers import GRIPPER, simulated

import handlaser_gtsam as hl
from handlaser_gtsam.files.recording_csv import write_recording
from handlaser_gtsam.validation.scenes import Layout

pytest.importorskip("starlette", reason="needs the extra watch")
pytest.importorskip("uvicorn", reason="needs the extra watch")

from watching import HOSTILE_BEAMS, Client, Sent, answer, until, watching, write_hostile

from handlaser_gtsam.files.report.page import SECTIONS
from handlaser_gtsam.files.watch.follower import Follower
from handlaser_gtsam.files.watch.server import Guard, Hub, PageServer, listening
from handlaser_gtsam.files.watch.watched import Watched
from handlaser_gtsam.files.watch.worker import Calibrator

LINES = (GRIPPER / "recording.csv").read_text().splitlines(keepends=True)
RIG = (GRIPPER / "rig.toml").read_text()
KIB = 1024
MIB = KIB * KIB


def resident(pid):
    """Bytes of memory of a process."""
    text = Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+) kB", text)[1]) * KIB


linux = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")


@pytest.fixture
def look_on():
    """Make clients, all of which vanish at the end."""
    made = []

    def look(*arguments, **more):
        made.append(Client(*arguments, **more))
        return made[-1]

    yield look
    for one in made:
        one.close()


# --- hundreds of stations ----------------------------------------------------------------------------


@pytest.mark.slow
@linux
def test_everybody_ends_at_the_same_state_after_hundreds_of_stations(tmp_path, look_on):
    """Five look on, one of which stops reading at once; lines arrive in pieces."""
    recording, _ = simulated(layout=Layout(beams=2, planes=8, stations=50))
    write_recording(tmp_path / "all.csv", recording)
    (tmp_path / "rig.toml").write_text(RIG.replace("[0, 30]", "[0, 60]"))
    header, *rows = (tmp_path / "all.csv").read_text().splitlines(keepends=True)
    assert len(rows) == 400
    path = tmp_path / "recording.csv"
    path.write_text(header)
    with watching(tmp_path, "--port", 0) as (process, port):
        live = [look_on(port) for _ in range(4)]
        stopped = look_on(port, buffer=4 * KIB, begin=False)
        until(lambda: all(one.status.get("phase") == "waiting" for one in live))
        before = resident(process.pid)
        with path.open("a") as file:
            for number, row in enumerate(rows):
                for piece in (row[:40], row[40:]):
                    file.write(piece)
                    file.flush()
                    time.sleep(0.002 if number % 10 else 0.05)
        until(lambda: all(one.counted("stations") == 400 for one in live))
        until(lambda: all(one.status["phase"] == "current" for one in live))
        assert resident(process.pid) - before < 40 * MIB
        assert len({(one.newest["state"], one.newest["status"]) for one in live}) == 1
        stopped.begin()  # it was hung up on, or hears what is newest
        until(lambda: not stopped.open or stopped.counted("stations") == 400)
        if stopped.open:
            assert stopped.newest["state"] == live[0].newest["state"]
            assert stopped.count["state"] <= min(one.count["state"] for one in live)
        late = look_on(port)
        until(lambda: "state" in late.newest and "status" in late.newest)
        assert late.newest["state"] == live[0].newest["state"]
        assert late.status == live[0].status
        shown = live[0].sent
    rig = hl.read_rig(tmp_path / "rig.toml")
    read = hl.read_recording(path, rig.sensor)
    expected = hl.calibrate(read, rig.noise, hl.CalibrationOptions(sensor=rig.sensor))
    assert shown.opening == "Usable"
    for row, beam in zip(shown.rows("mounts", "beams"), expected.beams.values(), strict=True):
        for cell, value in zip(row[1:4], beam.location.tolist(), strict=True):
            text = cell.replace("\N{MINUS SIGN}", "-")
            unit = 10.0 ** -len(text.partition(".")[2])  # of the last digit that is shown
            assert abs(float(text) - 1e3 * value) <= 0.51 * unit


# --- who looks on ------------------------------------------------------------------------------------


@contextlib.contextmanager
def serving():
    with PageServer("127.0.0.1", listening("127.0.0.1", 0)) as found:
        found.port = int(found.url.rstrip("/").rpartition(":")[2])
        yield found


@pytest.fixture
def server():
    with serving() as found:
        yield found


@pytest.fixture(scope="module")
def asked():
    """A server that publishes nothing and is only asked: ending one takes half a second."""
    with serving() as found:
        yield found


@pytest.mark.slow
@linux
def test_who_stops_reading_costs_little_and_holds_up_nobody(server, look_on):
    """Two thousand states of 200 kB would be 400 MB for each of three that do not read."""
    stopped = [look_on(server.port, buffer=4 * KIB, begin=False) for _ in range(3)]
    live = [look_on(server.port) for _ in range(2)]
    until(lambda: server.clients == 5)
    text = "x" * 200 * KIB
    before = resident(os.getpid())
    for number in range(2000):
        server.publish({"state": json.dumps([number, text])})
        if number % 20 == 0:
            time.sleep(0.01)
    until(lambda: all(one.state[:1] == [1999] for one in live if "state" in one.newest))
    # One state in the making, and two on their way, for each of five; and what Python keeps of it.
    assert resident(os.getpid()) - before < 60 * MIB
    for one in stopped:
        one.begin()
    until(lambda: all("state" in one.newest and one.state[0] == 1999 for one in stopped))
    assert all(one.count["state"] < 100 for one in stopped)


def test_a_status_follows_the_state_that_it_speaks_of():
    hub = Hub()
    hub.publish({"status": "[2]"})
    hub.publish({"state": "[1]"})
    told = hub.unheard(0)
    assert told.index(b"event: state\n") < told.index(b"event: status\n")


def test_who_vanishes_is_forgotten(server, look_on):
    clients = [look_on(server.port) for _ in range(10)]
    until(lambda: server.clients == 10)
    for one in clients[1:]:
        one.close()
    until(lambda: server.clients == 1)
    server.publish({"state": "[7]"})
    until(lambda: clients[0].state == [7])


def test_who_comes_back_hears_only_what_is_new(server, look_on):
    server.publish({"state": "[1]"})
    first = look_on(server.port)
    until(lambda: "state" in first.newest)
    (known,) = re.findall(r"id: ([\w.]+)", server._hub.unheard(0).decode())
    asking = socket.create_connection(("127.0.0.1", server.port))
    host = f"Host: 127.0.0.1:{server.port}"
    asking.sendall(f"GET /events HTTP/1.1\r\n{host}\r\nLast-Event-ID: {known}\r\n\r\n".encode())
    until(lambda: server.clients == 2)
    server.publish({"status": "[2]"})
    heard = b""
    while b"event: status" not in heard:
        heard += asking.recv(4096)
    assert b"event: hello" in heard
    assert b"event: state" not in heard
    asking.close()


def test_a_mark_of_another_server_says_nothing():
    """After a restart a page hears all, however many publications it knows of the server before."""
    before, now = Hub(), Hub()
    for _ in range(3):
        before.publish({"state": "[1]"})
    now.publish({"state": "[2]"})
    (mark,) = re.findall(r"id: ([\w.]+)", before.unheard(0).decode())
    assert before.known_to(mark) == 1  # the text was the same ever since
    assert now.known_to(mark) == now.known_to("") == now.known_to("nothing.x") == 0


def test_the_same_text_is_not_sent_again():
    hub = Hub()
    hub.publish({"section:a": "1", "section:b": "1"})
    hub.publish({"section:a": "1", "section:b": "2"})
    assert hub.unheard(1) == b"event: section\ndata: 2\n\n"


def test_too_many_are_refused(server, look_on):
    clients = [look_on(server.port) for _ in range(63)]
    until(lambda: server.clients == len(clients))
    assert answer(server.port, "/events")[0] == 503
    server.publish({"state": "[7]"})
    until(lambda: clients[0].state == [7])


# --- who may ask -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_who_does_not_read_for_long_is_hung_up_on(server, monkeypatch, look_on):
    monkeypatch.setattr("handlaser_gtsam.files.watch.server.READ_TIMEOUT_S", 0.3)
    stopped, live = look_on(server.port, buffer=4096, begin=False), look_on(server.port)
    until(lambda: server.clients == 2)
    for number in range(30):
        server.publish({"state": json.dumps([number, "x" * 400_000])})
        time.sleep(0.05)
    until(lambda: server.clients == 1)
    until(lambda: live.state[0] == 29)
    assert live.open
    stopped.begin()
    until(lambda: not stopped.open)


@pytest.mark.parametrize("path", ["/", "/events", "/nothing"])
@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:{port}"},
        {"Host": "127.0.0.1.evil.example:{port}"},
        {"Host": "localhost.:{port}"},
        {"Host": "localhost"},
        {"Host": "127.0.0.1:1"},
        {"Host": "192.168.0.7:{port}"},
        {"Host": "user@127.0.0.1:{port}"},
        {"Host": "127.0.0.1:{port}@evil.example"},
        {"Host": ""},
        {"Origin": "http://evil.example"},
        {"Origin": "http://localhost:3000"},
        {"Origin": "https://127.0.0.1:{port}"},
        {"Origin": "http://127.0.0.1:{port}.evil.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"},
        {"Sec_Fetch_Site": "same-site", "Sec_Fetch_Mode": "cors"},
    ],
    ids=str,
)
def test_a_foreign_host_or_origin_is_refused(asked, headers, path):
    told = {name: value.format(port=asked.port) for name, value in headers.items()}
    status, answered, text = answer(asked.port, path, **told)
    assert status == 403
    assert text.startswith("refused: ")
    assert text.count("\n") == 1
    assert "access-control-allow-origin" not in answered


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Host": "localhost:{port}", "Origin": "http://localhost:{port}"},
        {"Host": "LOCALHOST:{port}"},
        {"Host": "[::1]:{port}"},
        {"Origin": "http://127.0.0.1:{port}", "Sec_Fetch_Site": "same-origin"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate"},
    ],
    ids=str,
)
def test_the_page_itself_is_answered_and_nobody_else_may_read_it(asked, headers):
    told = {name: value.format(port=asked.port) for name, value in headers.items()}
    status, answered, text = answer(asked.port, "/", **told)
    assert status == 200
    assert text.startswith("<!doctype html>")
    assert "access-control-allow-origin" not in answered
    assert answered["x-content-type-options"] == "nosniff"
    policy = dict(part.split(" ", 1) for part in answered["content-security-policy"].split("; "))
    assert policy["default-src"] == "'none'"
    assert policy["connect-src"] == "'self'"
    assert "unsafe" not in policy["script-src"]
    assert "http" not in answered["content-security-policy"]


def test_a_host_that_stands_twice_or_not_at_all_is_refused(asked):
    right = f"Host: 127.0.0.1:{asked.port}\r\n"
    for version, hosts in (("1.1", right + "Host: evil.example\r\n"), ("1.1", ""), ("1.0", "")):
        with socket.create_connection(("127.0.0.1", asked.port)) as asking:
            asking.sendall(f"GET / HTTP/{version}\r\n{hosts}\r\n".encode())
            assert re.match(rb"HTTP/1\.\d 40[03]", asking.recv(100))


def test_there_is_nothing_else_to_ask_for(asked):
    assert answer(asked.port, "/", "POST", Content_Length="0")[0] == 405
    assert answer(asked.port, "/events", "DELETE")[0] == 405
    assert answer(asked.port, "/../../etc/passwd")[0] == 404
    assert answer(asked.port, "/events", "HEAD")[0] == 200
    until(lambda: asked.clients == 0)


def test_names_of_a_server_for_others():
    with listening("0.0.0.0", 0) as bound:
        guard, port = Guard(None, "0.0.0.0", bound, ""), bound.getsockname()[1]
    for host in ("192.168.0.7", "[fe80::1]", "localhost", socket.gethostname()):
        assert guard.allows(f"{host}:{port}"), host
    for host in ("evil.example", "192.168.0.7.evil.example", "1e3", "0x7f.1"):
        assert not guard.allows(f"{host}:{port}"), host


# --- what the file may do ----------------------------------------------------------------------------


class Shown:
    """Follows the files of a folder without a server, and keeps what is published."""

    def __init__(self, folder, **more):
        self.newest, self.states, self._lock = {}, 0, threading.Lock()
        self.path, self.rig = folder / "recording.csv", folder / "rig.toml"
        self.follower = Follower(Watched(self.path, self.rig, **more), self._published)
        self._thread = threading.Thread(target=self.follower.run)
        self._thread.start()

    def _published(self, messages):
        assert not any("\n" in text for text in messages.values())
        with self._lock:
            self.states += "state" in messages
            self.newest = self.newest | messages

    def forget(self):
        """Keep nothing but the status of what was published."""
        with self._lock:
            self.newest = {"status": self.newest["status"]}

    @property
    def sent(self):
        return Sent(self.newest)

    def is_at(self, phase, stations=None):
        """Wait until a state of so many stations is shown, and what the status says; return it."""

        def reached():
            status, counted = self.sent.json("status") or {}, self.sent.counted("stations")
            counted = None if counted < 0 else counted
            return status.get("phase") == phase and counted == stations and status

        return until(reached)

    def end(self):
        self.follower.stop()
        self._thread.join()


@pytest.fixture(scope="module")
def follower_of_all(tmp_path_factory):
    """One follower for all tests of files: to start the process that calibrates takes seconds."""
    found = Shown(tmp_path_factory.mktemp("watched"))
    yield found
    found.end()


@pytest.fixture
def shown(follower_of_all):
    """A follower that waits for a recording beside a rig file, whatever it has shown before."""
    follower_of_all.path.unlink(missing_ok=True)
    follower_of_all.rig.write_text(RIG)
    until(lambda: (follower_of_all.sent.json("status") or {}).get("phase") == "waiting")
    follower_of_all.forget()
    return follower_of_all


@pytest.mark.slow
def test_a_recording_that_comes_grows_goes_and_comes_again(shown):
    assert shown.is_at("waiting")["note"] == "waiting for recording.csv, which is not there"
    shown.path.touch()
    until(lambda: shown.is_at("waiting")["note"] == "waiting for the first station")
    shown.path.write_text(LINES[0].rstrip("\n"))
    time.sleep(2.0)  # a header that has rested is no fault either
    assert shown.is_at("waiting")["note"] == "waiting for the first station"
    shown.path.write_text("".join(LINES[:4]))
    shown.is_at("current", 3)
    assert shown.sent.opening == "Not usable, undetermined"
    assert "Turn the hand" in shown.sent.words("next")
    assert shown.sent.figure("by-count") is None
    with shown.path.open("a") as file:
        file.write("".join(LINES[4:20]) + LINES[20][:30])
        file.flush()
        # On a busy machine the file may have rested by the time it is calibrated.
        notes = "line 21 is not whole yet", "not used: "
        until(lambda: shown.is_at("current", 19)["note"].startswith(notes))
        assert shown.sent.opening == "Usable"
        assert len(shown.sent.rows("next", "next")) == 3
        assert shown.sent.figure("by-count")["data"]
        until(lambda: shown.is_at("current", 19)["note"].startswith("not used: "))
        file.write(LINES[20][30:])
    assert shown.is_at("current", 20)["note"] == ""
    shown.path.unlink()
    assert shown.is_at("waiting", 20)["note"] == "waiting for recording.csv, which is not there"
    shown.path.write_text("".join(LINES[:16]))
    shown.is_at("current", 15)


@pytest.mark.slow
def test_what_is_wrong_is_said_and_the_last_good_state_stays(shown):
    good = "".join(LINES[:20])
    shown.path.write_text(good)
    shown.is_at("current", 19)
    kept = shown.newest["state"]
    cell = LINES[9].split(",")
    wrong = {
        "line 10, column x": good.replace(LINES[9], ",".join([*cell[:2], "<b>1</b>", *cell[3:]])),
        "line 5: found 3 fields": good.replace(LINES[4], "A,4,0.1\n"),
        "control character": good.replace(LINES[9], "\x00" * 50 + "\n"),
        "no column 'plane'": good.replace("plane", "planes", 1),
        "found no reading at all": "".join(line.rsplit(",", 1)[0] + "," * (i > 0) + "\n"
                                           if i else line for i, line in enumerate(LINES[:20])),
    }  # fmt: skip
    for words, text in wrong.items():
        shown.path.write_text(text)
        error = until(lambda words=words: words in shown.is_at("refused", 19)["error"])
        assert error
        assert str(shown.path) in shown.sent.json("status")["error"]
        assert shown.sent.json("status")["error"].isprintable()
        assert shown.newest["state"] == kept
    shown.path.write_bytes(good.encode("utf-16"))
    until(lambda: "UTF-16" in shown.is_at("refused", 19)["error"])
    shown.path.write_text(good)
    assert shown.is_at("current", 19)["error"] == ""
    assert shown.newest["state"] == kept


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ("station".encode("utf-16"), "UTF-16 text"),
        (b"\xff\xd8\x00picture", "0xff, which is not UTF-8"),
    ],
)
def test_a_file_that_is_no_text_is_refused_once_it_rests(tmp_path, data, words):
    path = tmp_path / "recording.csv"
    path.write_bytes(data)
    calibrator = Calibrator(Watched(path))
    assert calibrator.answer(settled=False).waiting
    answer = calibrator.answer(settled=True)
    assert words in answer.error
    assert str(path) in answer.error
    path.write_text(LINES[0].rstrip())
    assert calibrator.answer(settled=True).waiting


@pytest.mark.slow
def test_a_file_that_is_truncated_replaced_or_no_file_for_a_while(shown):
    shown.path.write_text("".join(LINES))
    shown.is_at("current", 44)
    with shown.path.open("r+") as file:  # in place, as a spreadsheet or a shell does
        file.truncate(len("".join(LINES[:18])))
    shown.is_at("current", 17)
    beside = shown.path.with_name("beside")
    beside.write_text("".join(LINES[:25]))
    beside.replace(shown.path)
    shown.is_at("current", 24)
    shown.path.unlink()
    shown.path.mkdir()
    until(lambda: "no regular file" in shown.is_at("refused", 24)["error"])
    shown.path.rmdir()
    os.mkfifo(shown.path)  # whoever opens it waits for ever
    time.sleep(0.5)
    shown.path.unlink()
    shown.path.write_text("".join(LINES[:15]))
    shown.is_at("current", 14)


@pytest.mark.slow
def test_a_log_in_two_files_is_followed_as_both_grow(shown):
    """Poses in millimetres here, readings there, joined by station; the rig file says so."""
    names = LINES[0].rstrip("\n").split(",")
    poses = [i for i, name in enumerate(names) if name in ("x", "y", "z") or name.startswith("q")]
    both = ["station," + ",".join(names[i] for i in poses)], ["station,plane"]
    both[1][0] += "".join(f",{name}" for name in names if name.startswith("range_"))
    for number, line in enumerate(LINES[1:], 1):
        cells = line.rstrip("\n").split(",")
        scaled = [repr(1e3 * float(cells[i])) if names[i] in "xyz" else cells[i] for i in poses]
        both[0].append(",".join([str(number), *scaled]))
        rest = [cell for name, cell in zip(names, cells, strict=True) if name.startswith("range_")]
        both[1].append(",".join([str(number), cells[names.index("plane")], *rest]))
    log = '[log]\nrotation = "xyzw"\nunits = "mm"\nreadings = "readings.csv"\n'
    shown.rig.write_text(RIG + log)
    path, readings = shown.path, shown.path.with_name("readings.csv")
    readings.unlink(missing_ok=True)
    path.write_text("\n".join(both[0][:20]) + "\n")
    until(lambda: shown.is_at("waiting")["note"] == "waiting for readings.csv, which is not there")
    readings.write_text("\n".join(both[1][:20]) + "\n")
    shown.is_at("current", 19)
    shown_then = shown.sent.rows("mounts", "beams")
    with readings.open("a") as file:  # a line that is not whole, of a station without a pose
        file.write(both[1][20][:10])
        file.flush()
        notes = re.compile("line 21 is not whole yet|not used: ")  # once it has settled
        until(lambda: notes.match(shown.is_at("current", 19)["note"]))
        file.write(both[1][20][10:] + "\n")
    with path.open("a") as file:
        file.write(both[0][20] + "\n")
    shown.is_at("current", 20)
    readings.write_text("nonsense\n")
    until(lambda: str(readings) in shown.is_at("refused", 20)["error"])
    for file, lines in ((readings, both[1]), (path, both[0])):
        file.write_text("\n".join(lines) + "\n")
    shown.is_at("current", len(LINES) - 1)
    assert shown.sent.rows("mounts", "beams") != shown_then


def test_a_bag_cannot_be_followed(refusal, tmp_path):
    (tmp_path / "metadata.yaml").touch()
    for path in (tmp_path, tmp_path / "log.mcap"):
        assert "a bag, which cannot be read while it grows" in refusal("watch", path)


@pytest.mark.slow
def test_a_change_whose_time_stamp_is_put_back_is_found(shown):
    text = "".join(LINES[:20])
    shown.path.write_text(text)
    shown.is_at("current", 19)
    time.sleep(0.2)
    stamp, before = shown.path.stat().st_mtime_ns, shown.states
    digit = text.rindex("\n") - 6
    other = text[:digit] + ("1" if text[digit] != "1" else "2") + text[digit + 1 :]
    shown.path.write_text(other)
    os.utime(shown.path, ns=(stamp, stamp))
    until(lambda: shown.states > before)


@pytest.mark.slow
def test_the_rig_file_counts_as_soon_as_it_changes(shown):
    shown.path.write_text("".join(LINES))
    shown.is_at("current", 44)
    assert 'class="verdict good"' in shown.sent.html("verdict")
    shown.rig.write_text(RIG + "[limits]\nrms_mm = 0.001\n")
    until(lambda: "outside the limits" in shown.sent.opening)
    shown.rig.write_text(RIG + "[limits]\nrms_mm = zero\n")
    assert str(shown.rig) in shown.is_at("refused", 44)["error"]
    shown.rig.unlink()  # one that lies in the folder may be missing
    shown.is_at("current", 44)
    shown.rig.write_text(RIG)
    until(lambda: shown.sent.opening == "Usable")


@pytest.mark.slow
def test_a_last_line_without_an_end_counts_once_the_file_has_rested(shown):
    shown.path.write_text("".join(LINES[:20]).rstrip("\n"))
    assert shown.is_at("current", 18)["note"] == "line 20 is not whole yet"
    assert shown.is_at("current", 19)["note"] == ""


@pytest.mark.slow
def test_the_end_of_the_process_that_calibrates_is_no_end(shown):
    shown.path.write_text("".join(LINES[:20]))
    shown.is_at("current", 19)
    until(lambda: shown.follower._asked is None)
    os.kill(shown.follower._worker.process.pid, signal.SIGKILL)
    shown.path.write_text("".join(LINES[:22]))
    shown.is_at("current", 21)  # another one took its place

    def killed():
        worker = shown.follower._worker
        if worker is not None and worker.process.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(worker.process.pid, signal.SIGKILL)
        return shown.sent.json("status")["error"]

    # One that ends amid the work is named, and the next change begins again.
    shown.path.write_text("".join(LINES[:24]))
    assert "the calibration ended with signal 9" in until(killed)
    shown.is_at("refused", 21)
    shown.path.write_text("".join(LINES[:26]))
    shown.is_at("current", 25)


@pytest.mark.slow
def test_names_are_text_wherever_they_are_shown(tmp_path):
    """In what is sent; `test_watch_browser` looks at what a browser makes of the same names."""
    write_hostile(tmp_path / "recording.csv")
    found = Shown(tmp_path, given={"range_mm": (0.0, 30.0)})
    try:
        found.is_at("current", 44)
    finally:
        found.end()
    sent = found.sent
    assert [row[0] for row in sent.rows("mounts", "beams")] == list(HOSTILE_BEAMS)
    for section in SECTIONS:  # what the page sets as HTML holds no element that a name made
        assert not re.search(r"<(script|img|b)\b", sent.html(section))
    for name in ("space-world", "by-count"):
        figure = sent.figure(name)
        shown = [{**trace, "legendgroup": ""} for trace in figure["data"]]  # that is never text
        drawn = json.dumps(shown)
        for tag in ("<script", "<img", "</td>"):
            assert tag not in drawn
    assert "&lt;script&gt;" in json.dumps(sent.figure("space-world")["data"])


# --- the command -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_browser_is_opened_and_ctrl_c_ends_at_once_with_one_line(
    tmp_path, monkeypatch, look_on
):
    browser, told, folder = tmp_path / "browser", tmp_path / "told", tmp_path / "cell"
    browser.write_text(f"#!/bin/sh\necho $1 >{told}\n")
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    folder.mkdir()
    (folder / "recording.csv").write_text("".join(LINES))
    with watching(folder, "--port", 0, "--open") as (process, port):
        clients = [look_on(port), look_on(port, buffer=KIB, begin=False)]
        until(lambda: told.exists() and told.read_text() == f"http://127.0.0.1:{port}/\n")
        until(lambda: clients[0].status.get("phase") == "calibrating" or clients[0].state)
        began = time.monotonic()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
        assert (process.returncode, err) == (130, "handlaser: stopped by Ctrl-C\n")
        assert time.monotonic() - began < 10.0
        until(lambda: not clients[0].open)


@pytest.mark.slow
def test_a_file_with_its_rig_and_a_host_for_others_and_no_process_stays_behind(tmp_path, look_on):
    (tmp_path / "cell.csv").write_text("".join(LINES))
    (tmp_path / "cell.toml").write_text(RIG)
    rig = ("--rig", tmp_path / "cell.toml")
    with watching(tmp_path / "cell.csv", *rig, "--host", "0.0.0.0", "--port", 0) as (process, port):
        client = look_on(port)
        until(lambda: client.counted("stations") == 44)
        assert client.status["file"] == "cell.csv"
        assert answer(port, Host=f"192.168.0.7:{port}")[0] == 200
        assert answer(port, Host=f"evil.example:{port}")[0] == 403
        children = [
            int(path.parent.name)
            for path in Path("/proc").glob("[0-9]*/stat")
            if _parent(path) == process.pid
        ]
        assert children or not Path("/proc/self/stat").exists()
        process.kill()
        until(lambda: not any(_alive(child) for child in children))
        assert "whoever reaches this computer sees the page" in process.communicate(timeout=60)[1]


def _parent(path):
    with contextlib.suppress(OSError):
        return int(path.read_text().rpartition(")")[2].split()[1])
    return None


def _alive(pid):
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def test_a_port_in_use_is_one_clear_line(handlaser, tmp_path):
    with listening("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        code, out, err = handlaser("watch", tmp_path, "--port", port)
    assert (code, out) == (2, "")
    assert err == (
        f"handlaser: found port {port} of 127.0.0.1, which is in use; "
        "expected --port with another, or 0 for any that is free\n"
    )


def test_without_a_port_another_one_is_taken(monkeypatch):
    with listening("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        monkeypatch.setattr("handlaser_gtsam.files.watch.server.PORT", port)
        with listening("127.0.0.1", None) as found:
            assert found.getsockname()[1] not in (0, port)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{folder}/none"], "found neither a folder nor a file"),
        (["{folder}/none/recording.csv"], "found neither a folder nor a file"),
        (["/dev/null"], "found neither a file nor a folder"),
        (["{folder}", "--rig", "{folder}/none.toml"], "found no such file; expected a rig file"),
        (["{folder}", "--range-sigma-mm", "-1"], "found --range-sigma-mm -1 mm"),
        (
            ["{folder}", "--host", "no.such.name.invalid"],
            "no way to listen at no.such.name.invalid",
        ),
        (["{folder}", "--host", "192.0.2.1"], "no way to listen at 192.0.2.1"),
        (["{folder}", "--at-range-mm", "nan"], "--at-range-mm"),
    ],
)
def test_what_cannot_be_watched_is_refused(refusal, tmp_path, arguments, words):
    told = [one.format(folder=tmp_path) for one in arguments]
    assert words in refusal("watch", *told, "--port", 0)


def test_without_the_extra_it_is_named(refusal, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "starlette", None)
    assert "pip install 'handlaser-gtsam[watch]'" in refusal("watch", tmp_path)


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nsys.argv = ['handlaser', 'watch', '--help']\n"
        "from handlaser_gtsam.cli import main\n"
        "try: main()\n"
        "finally: print([n for n in ('gtsam', 'starlette', 'uvicorn', 'plotly') if n in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.endswith("[]\n")
