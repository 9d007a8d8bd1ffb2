"""Programs run with a time limit in separate processes: compilers, and trials of their output.

Also limits linear algebra to one thread: the matrices are small, and threads would mostly wait.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress

# Time limit of a compilation [s].
COMPILE_SECONDS = 300.0
# Time limit of short work in a separate process: Python code, or a compiler's version [s].
TRIAL_SECONDS = 60.0


def run_within(command: Sequence[str], seconds: float) -> subprocess.CompletedProcess[str] | None:
    """Run a program and return its exit code and output; None if it fails to start or times out.

    It has no input. When the time is over, it is killed with all processes that it started.

    command : program and arguments; seconds : time limit [s]
    """
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
        )
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
    """Return the text that Python code prints in a separate process; None where it fails.

    The code can import the standard library only.

    arguments : `sys.argv[1:]` of the code
    """
    done = run_within([sys.executable, "-I", "-S", "-c", code, *arguments], TRIAL_SECONDS)
    return done.stdout if done is not None and done.returncode == 0 else None


def one_thread() -> None:
    """Limit linear algebra to one thread, unless the environment sets the number.

    To be called before numpy is loaded.
    """
    thread_variables = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    if not any(name in os.environ for name in thread_variables):
        os.environ.update(dict.fromkeys(thread_variables, "1"))
