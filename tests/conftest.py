"""What all tests share: the command, and benchmarks importable behind whatever is installed."""

import os
import sys
from pathlib import Path

# Tests run in as many processes as there are processors. NumPy reads this when it is imported.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import pytest

from handlaser_gtsam.cli import main

sys.path.append(str(Path(__file__).parents[1]))


@pytest.fixture
def handlaser(monkeypatch, capsys):
    """Run the command in this process; return exit code, stdout and stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["handlaser", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            main()
        captured = capsys.readouterr()
        return caught.value.code or 0, captured.out, captured.err

    return run
