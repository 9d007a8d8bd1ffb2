"""The version: that of the tag at which a checkout stands, or of the last one before it.

The build reads it from here, before the package can be imported; nothing else of the package is used.
"""

import subprocess
from pathlib import Path

# Of the next release: where there is no tag yet, or neither git nor an sdist's own file tells.
NEXT = "0.1.0"
ROOT = Path(__file__).parents[2]


def of_tree(root: Path = ROOT) -> str:
    """Of an unpacked sdist, or of a checkout: 1.2.0 at the tag v1.2.0, 1.2.0.post3+gabc1234 three commits later."""
    written = root / "PKG-INFO"
    if written.is_file():
        lines = written.read_text(encoding="utf-8").splitlines()
        return next(line.partition(": ")[2] for line in lines if line.startswith("Version: "))
    if not (root / ".git").exists():
        return NEXT
    command = ["git", "-c", "safe.directory=*", "describe", "--tags", "--long", "--match", "v[0-9]*"]
    try:
        said = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return NEXT
    tag, commits, commit = said.strip().removeprefix("v").rsplit("-", 2)
    return tag if commits == "0" else f"{tag}.post{commits}+{commit}"


def installed() -> str:
    """As the package was installed; of the tree where it was not."""
    from importlib.metadata import PackageNotFoundError, version  # late: it costs more than `import casadical`

    try:
        return version("casadical")
    except PackageNotFoundError:
        return of_tree()
