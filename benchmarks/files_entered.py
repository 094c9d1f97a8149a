"""How many files, functions and types one `handlaser calibrate` enters: what a reader has to open.

python -m benchmarks.files_entered
python -m benchmarks.files_entered --list
"""

import argparse
import dataclasses
import sys
import tempfile
from collections import Counter
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import FrameType

from handlaser_gtsam.cli import main as command

ROOT = Path(__file__).resolve().parents[1]
GRIPPER = ROOT / "examples" / "gripper"


def main() -> None:
    """Trace the command on the shipped recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--list", action="store_true", help="the files, with the functions entered")
    listed = parser.parse_args().list
    functions: set[tuple[str, str, int]] = set()
    types: set[type] = set()

    def enter(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        inside = "handlaser_gtsam/" in code.co_filename or "/factors/" in code.co_filename
        if event == "call" and inside and code.co_flags & CO_OPTIMIZED:
            functions.add((code.co_filename, code.co_qualname, code.co_firstlineno))
            owner = frame.f_locals.get("self")
            if dataclasses.is_dataclass(owner):
                types.add(type(owner))

    with tempfile.TemporaryDirectory() as folder:
        sys.argv = ["handlaser", "calibrate", str(GRIPPER / "recording.csv")]
        sys.argv += ["--rig", str(GRIPPER / "rig.toml"), "--out", f"{folder}/out.json", "--quiet"]
        sys.setprofile(enter)
        try:
            command()
        except SystemExit as end:
            if end.code:
                raise
        finally:
            sys.setprofile(None)
    files = Counter(file for file, _, _ in functions)
    if listed:
        for file, count in sorted(files.items()):
            print(f"{count:4d}  {Path(file).relative_to(ROOT)}")
    print(f"{len(files)} files, {len(functions)} functions, methods of {len(types)} dataclasses")


if __name__ == "__main__":
    main()
