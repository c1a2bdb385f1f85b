# SPDX-License-Identifier: GPL-3.0-or-later
"""Check style with ruff, types with mypy and layers with import-linter; exit 1 if any check fails.

The repository root is the package ``tactile_clay``, whatever the name of its folder. For mypy, the
script makes a folder ``build/types/tactile_clay`` with links to the parts of the package.
"""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CHECK_IMPORTS = "from importlinter.cli import lint_imports_command as check; check()"
PARTS = ("__init__.py", "clay_addon", "haptics", "solver", "tests")


def link_package() -> Path:
    """Make the folder with links to the parts of the package.

    Returns:
        The folder, relative to the root.
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
    """Run one check, and print its output with shortened paths if it fails.

    Returns:
        Whether the check passed.
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
    """Run all checks, even if one fails.

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
    passed = [run(name, arguments) for name, arguments in checks.items()]
    return 0 if all(passed) else 1


if __name__ == "__main__":
    sys.exit(main())
