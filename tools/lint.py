# SPDX-License-Identifier: GPL-3.0-or-later
"""Check style with ruff, types with mypy and layers with import-linter; exit 1 when one complains.

The repository root is the package ``tactile_clay`` whatever the clone's folder is called, which
mypy cannot know. So it is shown a folder ``build/types/tactile_clay`` with links to the parts.
"""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CHECK_IMPORTS = "from importlinter.cli import lint_imports_command as check; check()"
PARTS = ("__init__.py", "clay_addon", "haptics", "solver", "tests")


def link_package() -> Path:
    """Make the folder of links.

    Returns:
        The folder that stands for the package, relative to the root.
    """
    package = ROOT / "build" / "types" / "tactile_clay"
    package.mkdir(parents=True, exist_ok=True)
    for part in PARTS:
        link = package / part
        target = os.path.relpath(ROOT / part, package)
        link.unlink(missing_ok=True)
        link.symlink_to(target)
    return package.relative_to(ROOT)


def run(name: str, arguments: list[str]) -> bool:
    """Run one checker and show what it says, with the links' paths shortened.

    Returns:
        Whether it was content.
    """
    result = subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    print(f"{name}: {'ok' if result.returncode == 0 else 'FAILED'}")
    if result.returncode != 0:
        print(result.stdout.replace("build/types/tactile_clay/", "").rstrip())
    return result.returncode == 0


def main() -> int:
    """Run all checks, also after one has failed.

    Returns:
        The exit code.
    """
    package = link_package()
    checks = {
        "ruff check": ["-m", "ruff", "check", "--quiet", "."],
        "ruff format": ["-m", "ruff", "format", "--check", "--quiet", "."],
        "mypy": ["-m", "mypy", str(package), "tools"],
        "imports": ["-c", CHECK_IMPORTS, "--no-cache"],
    }
    contents = [run(name, arguments) for name, arguments in checks.items()]
    return 0 if all(contents) else 1


if __name__ == "__main__":
    sys.exit(main())
