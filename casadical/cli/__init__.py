"""The command line: casadical COMMAND PROBLEM_DIR.

Exit codes: 0 done; 2 bad input; 3 the solver found no optimum; 4 worse than before; 5 no longer valid;
70 a bug in casadical.
"""

import sys
import traceback
from io import TextIOWrapper

from casadical.cli.root import app as app
from casadical.cli.terminal import BAD_INPUT, NO_CONVERGENCE, OUR_BUG, refusal
from casadical.core.basics import ConvergenceError, InputError, shown
from casadical.core.subprocesses import one_thread


def main() -> None:
    """Run the command line; a user's mistake ends in a message and an exit code, never in a traceback."""
    one_thread()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # letters that the terminal's encoding has not are shown by their codes
            stream.reconfigure(errors="backslashreplace")
    try:
        app()
    except InputError as error:
        refusal(error)
        sys.exit(BAD_INPUT)
    except ConvergenceError as error:
        refusal(f"no optimum found, nothing was written: {error}")
        sys.exit(NO_CONVERGENCE)
    except KeyboardInterrupt:
        refusal("interrupted, nothing was written")
        sys.exit(130)
    except OSError as error:
        place = "" if error.filename is None else f"{shown(error.filename)}: "
        refusal(f"{place}{error.strerror or error}")
        sys.exit(BAD_INPUT)
    except MemoryError:
        refusal("there is not enough memory for this; give fewer poses or a smaller number")
        sys.exit(BAD_INPUT)
    except Exception:
        traceback.print_exc()
        refusal("this is a bug in casadical; please report it with the lines above")
        sys.exit(OUR_BUG)
