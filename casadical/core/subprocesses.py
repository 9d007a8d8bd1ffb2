"""Other programs with a time limit: compilers, and the trial of what they made, in a process that may crash.

And one thread for linear algebra: the matrices are small, and threads that wait for each other take most of the time.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress

COMPILE_SECONDS, TRIAL_SECONDS = 300.0, 60.0


def finished(command: Sequence[str], seconds: float) -> subprocess.CompletedProcess[str] | None:
    """A program run to its end without input; None where it cannot be started, or was stopped with all it started."""
    try:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            errors="replace", start_new_session=True,
        )  # fmt: skip
    except OSError:
        return None
    try:
        out, error = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        return None
    finally:
        if process.returncode is None:
            with suppress(OSError, AttributeError):
                os.killpg(process.pid, signal.SIGKILL)
            process.kill()
            process.communicate()
    return subprocess.CompletedProcess(command, process.returncode, out, error)


def tried(code: str, *arguments: str) -> str | None:
    """What a line of Python prints in a process of its own, with the standard library alone; None where it fails."""
    done = finished([sys.executable, "-I", "-S", "-c", code, *arguments], TRIAL_SECONDS)
    return done.stdout if done is not None and done.returncode == 0 else None


# numpy's library reads them once, when it is loaded.
_NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread() -> None:
    """Let linear algebra use one thread, unless the environment says how many; to be called before numpy is loaded."""
    if not any(name in os.environ for name in _NAMES):
        os.environ.update(dict.fromkeys(_NAMES, "1"))
