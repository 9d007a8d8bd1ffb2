"""The command line: casadical COMMAND PROBLEM_DIR.

Exit codes: 0 done; 2 bad input; 3 the solver found no optimum; 4 worse than before; 5 no longer
valid; 70 a bug in casadical; 130 interrupted.
"""

import sys
import traceback
from io import TextIOWrapper

from casadical.cli.root import app as app
from casadical.cli.terminal import EXIT_BAD_INPUT, EXIT_BUG, EXIT_NO_CONVERGENCE, refusal
from casadical.core.basics import ConvergenceError, InputError, shown
from casadical.core.subprocesses import one_thread


def main() -> None:
    """Run the command line; user errors end in a message and an exit code, never in a traceback."""
    one_thread()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # characters that the encoding lacks are escaped
            stream.reconfigure(errors="backslashreplace")
    why: object
    try:
        app()
        return
    except InputError as error:
        code, why = EXIT_BAD_INPUT, error
    except ConvergenceError as error:
        code, why = EXIT_NO_CONVERGENCE, f"no optimum found, nothing was written: {error}"
    except KeyboardInterrupt:
        code, why = 130, "interrupted, nothing was written"
    except OSError as error:
        place = "" if error.filename is None else f"{shown(error.filename)}: "
        code, why = EXIT_BAD_INPUT, f"{place}{error.strerror or error}"
    except MemoryError:
        code, why = (
            EXIT_BAD_INPUT,
            "there is not enough memory for this; give fewer poses or a smaller number",
        )
    except Exception:
        traceback.print_exc()
        code, why = EXIT_BUG, "this is a bug in casadical; please report it with the lines above"
    refusal(why)
    sys.exit(code)
