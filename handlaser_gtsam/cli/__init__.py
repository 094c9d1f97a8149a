"""The command `handlaser`: one file a verb, and what they share; heavy imports happen inside."""

import io
import os
import sys
from contextlib import suppress

from .stopping import WORDS, CtrlC, Exit

THREADS = "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"
"""Environment variables of the linear algebra under NumPy, which reads them when it is imported."""


def main() -> None:
    """Run the command line; errors made on purpose and Ctrl-C end in one line and an exit code."""
    for name in THREADS:  # on small matrices further threads take processor time and save none
        os.environ.setdefault(name, "1")
    try:
        with CtrlC() as stopping:
            try:
                code, words = _run()
            except BaseException:  # whatever becomes of the KeyboardInterrupt on its way
                if not stopping.asked:
                    raise
            if stopping.asked:
                code, words = Exit.INTERRUPTED, WORDS
            if words:
                with suppress(BrokenPipeError):  # whoever read it has gone; the exit code stays
                    print(f"handlaser: {words}", file=sys.stderr, flush=True)
            sys.exit(code)
    except KeyboardInterrupt:  # in the first or the last line of the above
        print(f"handlaser: {WORDS}", file=sys.stderr)
        sys.exit(Exit.INTERRUPTED)


def _run() -> tuple[int, str]:
    """Run a verb that comes back; return its exit code and what went wrong."""
    from ..errors import HandlaserError, InputError
    from .verbs import NAME, UsageError, app, usage_words

    if sys.stdout is None:  # closed by the caller
        sys.stdout = io.StringIO()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what its encoding cannot say is shown as escapes
            stream.reconfigure(errors="backslashreplace")
    try:
        code = app(sys.argv[1:] or ["--help"], prog_name=NAME, standalone_mode=False)
        sys.stdout.flush()
    except HandlaserError as error:
        return Exit.BAD_INPUT if isinstance(error, InputError) else Exit.UNDETERMINED, str(error)
    except UsageError as error:
        return Exit.BAD_INPUT, usage_words(error)
    except OSError as error:
        print(f"handlaser: no way to write the output ({error.strerror})", file=sys.stderr)
        os._exit(Exit.BAD_INPUT)  # a full stdout would raise again when it is flushed
    return (Exit.BAD_INPUT if code == 1 else code or 0), ""  # 1 is how completion refuses a shell
